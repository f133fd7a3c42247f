"""What noise of angles adds to the equations of joints that swing freely, against noise that is drawn and smoothed."""

from dataclasses import replace

import numpy as np
import pytest

from hydroopt.estimation.dynamic.experiment import Experiment, experiment
from hydroopt.estimation.dynamic.identify import identify
from hydroopt.estimation.dynamic.problem import identification_problem
from hydroopt.estimation.dynamic.regressor_noise import angle_errors
from hydroopt.logs.spline import Basis, Grid
from hydroopt.machine.machine_file import load_machine
from hydroopt.model.model import Model
from hydroopt.simulation.simulate import random_trajectory, random_truth, simulate
from hydroopt.study.study import seeds


@pytest.mark.parametrize(("bandwidth", "passes"), [(2.0, 4), (5.0, 1)])
def test_errors_of_a_smoothed_motion_are_those_of_drawn_noise(bandwidth: float, passes: int) -> None:
    t, std = np.arange(10000) / 50, 1e-3
    basis = Basis(t, Grid.of(t))
    made = basis.smoothed(np.random.default_rng(0).normal(0, std, len(t)), basis.filter_of(bandwidth, passes))
    found = np.cov(made[:, 100:-100])
    (expected,) = angle_errors(np.array([std]), np.array([bandwidth]), np.array([passes]), 0.02)
    size = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(found / size, expected / size, atol=0.1)


def test_joints_without_a_stated_accuracy_or_a_bandwidth_have_no_errors() -> None:
    assert not angle_errors(np.array([np.nan, 1e-3]), np.array([2.0, np.inf]), np.array([4, 4]), 0.01).any()


@pytest.fixture(scope="module")
def crane() -> tuple[Model, Experiment]:
    model = Model(load_machine("forestry_crane"))
    return model, experiment(model, simulate(model, random_trajectory(model, duration=20, rate=50, seed=1), seed=1))


def test_the_expectation_is_that_of_drawn_noise(crane: tuple[Model, Experiment]) -> None:
    model, made = crane
    bands, rng = made.bands(), np.random.default_rng(1)
    motion, K = made.motion, made.equations()[0][0]
    errors = angle_errors(np.array([model.machine.sensor(f"{joint}.q").std for joint in model.machine.joints]),
                          motion.bandwidth, motion.passes, 0.02)
    drawn = np.zeros_like(bands.noise)
    for _ in range(40):
        away = np.stack([rng.multivariate_normal(np.zeros(3), one, len(motion.t)) for one in errors], axis=2)
        q, qd, qdd = np.stack([motion.q, motion.qd, motion.qdd]) + np.moveaxis(away, 1, 0)
        off = replace(made, motion=replace(motion, q=q, qd=qd, qdd=qdd)).equations()[0][0] - K
        for n, k in enumerate(bands.noisy):
            rows = off[made.inside & made.known[:, k], k]
            drawn[n] += rows.T @ rows / 40
    psi = model.parameters.nominal
    assert [model.machine.balances[k].joint for k in bands.noisy] == ["swing", "sway"]
    for found, expected in zip(bands.noise, drawn, strict=True):
        assert psi @ found @ psi == pytest.approx(psi @ expected @ psi, rel=0.1)
        assert np.trace(found) == pytest.approx(np.trace(expected), rel=0.1)


def test_machines_whose_joints_are_all_driven_have_none() -> None:
    model = Model(load_machine("wheel_loader"))
    made = experiment(model, simulate(model, random_trajectory(model, duration=5, rate=50, seed=1), seed=1))
    assert made.bands().noise.shape[0] == 0


@pytest.mark.slow
def test_a_swinging_load_does_not_vanish() -> None:
    """One of 32 drawn cranes (`studies/machine_kinds`): without a force at its joints the residuals of a weightless
    grapple are the smallest, and their weight had grown until nothing else counted."""
    model = Model(load_machine("forestry_crane"))
    of_truth, of_motion, of_noise, of_sampling = seeds(8033538764449424, 4)
    truth = random_truth(model, of_truth)
    log = simulate(model, random_trajectory(model, duration=33.28, rate=50.0, seed=of_motion), truth, seed=of_noise)
    found = identify(identification_problem(model, [log]), seed=of_sampling)
    low, high = found.ci95[np.isfinite(found.ci95[:, 0])].T
    inside = (low <= truth[np.isfinite(found.ci95[:, 0])]) & (truth[np.isfinite(found.ci95[:, 0])] <= high)
    assert found.status == "ok"
    assert np.mean(inside) > 0.9
    mass = model.parameters.names.index("rotator.m")
    assert abs(found.value[mass] - truth[mass]) < 3 * found.std[mass] < 0.2 * truth[mass]
