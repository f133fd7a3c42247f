"""Intervals contain gains of force readings that the machine file calls uncertain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import hydroopt as ho
from hydroopt.estimation.dynamic.folding import split, triangle
from hydroopt.estimation.dynamic.weighted_residuals import with_uncertain_gains
from hydroopt.simulation.simulate import random_truth


def machine_with(name: str, gain: float | None) -> ho.Model:
    machine = ho.load_machine(name)
    return ho.Model(machine.model_copy(update={"faults": machine.faults.model_copy(update={"gain": gain})}))


def misread(model: ho.Model, seed: int, gain: float) -> tuple[ho.Log, np.ndarray]:
    """A log of a drawn machine whose forces are each read too large, and its parameters."""
    psi = random_truth(model, seed)
    motion = ho.random_trajectory(model, duration=30.0, rate=50.0, seed=seed)
    log = ho.simulate(model, motion, psi, noise=True, seed=seed)
    rng, channels = np.random.default_rng([seed, 7]), {name: np.array(values) for name, values in log.channels.items()}
    for actuator in model.machine.actuators:
        size = 1 + gain * rng.standard_normal()
        for channel in actuator.effort_factors:
            channels[channel] = channels[channel] * size
    return replace(log, channels=channels), psi


def test_information_is_that_of_residuals_with_a_common_unknown_gain() -> None:
    """Against the covariance I + σ²·s·sᵀ of each actuator's rows, inverted as it stands."""
    model = machine_with("patu655_lift", 0.03)
    log, _ = misread(model, 1, 0.03)
    exact = ho.solve(ho.identification_problem(machine_with("patu655_lift", None), [log]), "wls").weighted_residuals
    psi, expected = exact.problem.parameters.nominal, 0.0
    made = with_uncertain_gains(replace(exact, problem=ho.identification_problem(model, [log])), psi)
    for own in exact.triangles:
        force = own[:, :-1] @ psi
        expected = expected + own.T @ np.linalg.inv(np.eye(len(own)) + 0.03**2 * np.outer(force, force)) @ own
    rows = np.column_stack([made.R, made.r])
    np.testing.assert_allclose(rows.T @ rows, np.asarray(expected)[:, :] - made.rest * np.eye(len(expected))[-1:].T
                               * np.eye(len(expected))[-1:], rtol=1e-9, atol=1e-6)
    np.testing.assert_array_equal(made.triangles, exact.triangles)
    assert made.gain == 0.03
    assert with_uncertain_gains(exact, psi) is exact
    assert np.all(np.isfinite(split(triangle(*made.triangles))[0]))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "gain"), [("cat215b", 0.02), ("cat215b", 0.05), ("wheel_loader", 0.02)])
def test_intervals_hold_where_gains_are_off_as_stated(name: str, gain: float) -> None:
    stated, base = [], []
    model = machine_with(name, gain)
    for seed in range(200, 230):
        log, psi = misread(model, seed, gain)
        found = ho.solve(ho.identification_problem(model, [log]))
        stated += [low <= psi[k] <= high for k, (low, high) in enumerate(found.ci95) if np.isfinite(low)]
        base += [*(np.abs(found.base_value - found.identifiability.grouping @ psi) <= 1.96 * found.base_std)]
    assert np.mean(stated) > 0.92
    assert np.mean(base) > 0.91
