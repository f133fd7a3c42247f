"""Motions that tell most: their functions, what they tell, and that they keep every limit."""

from __future__ import annotations

import numpy as np
import pytest

from fixtures.tiers import tiered
from hydroopt import Model, load_machine
from hydroopt.errors import ProblemError
from hydroopt.excitation.criteria import CRITERIA, SLOW, Information, design_parameters
from hydroopt.excitation.motion.basis import Basis, Fourier, Spline
from hydroopt.excitation.motion.design import design
from hydroopt.excitation.motion.problem import ExcitationProblem
from hydroopt.limits.limits import Limits
from hydroopt.limits.reserves import Reserves
from hydroopt.logs.forces_from_pressures import force_noise
from hydroopt.machine.environment import Pump
from hydroopt.machine.links import Box
from hydroopt.machine.machine import Machine
from hydroopt.simulation.simulate import random_trajectory

BASES = (Fourier(6.0, 3, repeats=2, blend=1.5), Spline(8.0, 6))


@pytest.fixture(scope="module")
def model() -> Model:
    return Model(load_machine("cat215b"))


@pytest.mark.parametrize("basis", BASES, ids=["fourier", "spline"])
def test_functions_are_each_others_derivatives_and_rest_at_both_ends(basis: Basis) -> None:
    step = 1e-4
    t = np.arange(0, basis.duration, step)
    rows = basis.rows(t)
    assert rows.position.shape == (len(t), len(basis.names))
    for lower, upper in ((rows.position, rows.speed), (rows.speed, rows.acceleration)):
        slope = (lower[2:] - lower[:-2]) / (2 * step)
        assert np.max(np.abs(slope - upper[1:-1])) < 1e-3 * max(1.0, np.max(np.abs(upper)))
    ends = basis.rows(np.array([0.0, basis.duration]))
    assert np.max(np.abs(ends.speed)) < 1e-12
    assert np.max(np.abs(ends.acceleration)) < 1e-9


@pytest.mark.parametrize("criterion", CRITERIA)
@pytest.mark.parametrize("asked", [{}, {"bayesian": True}, {"focus": ["stick"]}], ids=["all", "bayesian", "focus"])
def test_derivatives_of_criteria_are_those_of_finite_differences(model: Model, criterion: str, asked: dict) -> None:
    if criterion == "condition" and "focus" in asked:
        with pytest.raises(ProblemError, match="takes no focus"):
            Information(model, design_parameters(model, force_noise(model), **asked), criterion)
        return
    information = Information(model, design_parameters(model, force_noise(model), **asked), criterion)
    motion = random_trajectory(model, duration=20, rate=6, seed=3)
    states = np.hstack([motion.q, motion.qd, motion.qdd])
    direction = np.random.default_rng(0).standard_normal(states.shape)

    def value(part: float) -> float:
        return information.value(*np.hsplit(states + part * direction, 3), 8.0)

    slope = np.sum(information.value_and_slope(*np.hsplit(states, 3), 8.0)[1] * direction)
    steps = [(value(h) - value(-h)) / (2 * h) for h in (1e-4, 1e-5)]
    assert slope == pytest.approx(steps[1], rel=1e-3, abs=1e-6 + 3 * abs(steps[0] - steps[1]))


def test_criteria_are_those_of_the_covariance(model: Model) -> None:
    asked = design_parameters(model, force_noise(model), bayesian=True)
    motion = random_trajectory(model, duration=20, rate=6, seed=3)
    of = {name: Information(model, asked, name) for name in CRITERIA}
    factor = of["D"].factor(motion.q, motion.qd, motion.qdd, 1.0)
    covariance = np.linalg.inv(factor.T @ factor)
    eigenvalues = np.linalg.eigvalsh(covariance)
    np.testing.assert_allclose(of["D"].of(factor)[0], np.mean(np.log(eigenvalues)), rtol=1e-6)
    np.testing.assert_allclose(of["A"].of(factor)[0], np.log(np.mean(np.diag(covariance))), rtol=1e-6)
    np.testing.assert_allclose(of["E"].of(factor)[0], np.log(eigenvalues[-1]), rtol=1e-6)
    np.testing.assert_allclose(of["condition"].of(factor)[0], np.log(eigenvalues[-1] / eigenvalues[0]) / 2, rtol=1e-6)


def test_smooth_signs_tell_no_more_than_signs(model: Model) -> None:
    """Frictions of a cylinder, of its pins and of the joint that it drives: all signs are smoothed alike."""
    asked = design_parameters(model, force_noise(model))
    own = [k for k, name in enumerate(asked.names) if name in (
        "boom.tau_coulomb", "boom_cylinder.f_coulomb", "boom_cylinder.n_barrel", "boom_cylinder.n_rod")]
    assert len(own) == 4
    information, motion = Information(model, asked, "D"), random_trajectory(model, duration=20, rate=20, seed=3)
    exact, smooth = (model.over(each, motion.q, motion.qd, motion.qdd)[0][:, 1][:, own]
                     for each in (information.regressor, information.smooth))
    speed = motion.qd[:, 1]
    moves = (np.abs(speed) > 1e-3) & np.all(np.abs(exact) > 0.05 * np.max(np.abs(exact), axis=0), axis=1)
    assert np.mean(moves) > 0.5
    np.testing.assert_allclose(
        (smooth / exact)[moves], np.repeat((np.abs(speed) / np.hypot(speed, SLOW))[moves, None], 4, axis=1), rtol=1e-2)


def test_limits_are_what_their_names_say(model: Model) -> None:
    """Against sums by hand: pump flow, strokes, and the moment that holds a resting machine on its tracks."""
    limits, motion = Limits(model, Reserves.none()), random_trajectory(model, duration=10, rate=5, seed=1)
    states = motion.q, motion.qd, motion.qdd
    values = limits.values(*states) * limits.scale
    names = [row.name for row in limits.rows]
    lengths, speeds = (part[:, :, 0] for part in model.over(model.cylinder_kinematics, *states)[:2])
    machine = model.machine
    flow = abs(motion.qd[:, 0]) * machine.motors[0].torque_per_pressure * machine.motors[0].gear
    for k, cylinder in enumerate(machine.cylinders):
        head, rod = cylinder.areas
        flow = flow + np.where(speeds[:, k] > 0, head, -rod) * speeds[:, k]
        np.testing.assert_allclose(values[:, names.index(f"{cylinder.name} stroke")], lengths[:, k], rtol=1e-12)
    pumped = [k for k, name in enumerate(names) if name == "pump flow"]
    np.testing.assert_allclose(np.max(values[:, pumped], axis=1), flow, rtol=1e-9)
    still = limits.values(motion.q, 0 * motion.q, 0 * motion.q)
    tipping = [k for k, name in enumerate(names) if name.startswith("tipping")]
    both = still[:, tipping[0]] + still[:, tipping[2]]  # opposite edges: weight times their distance
    weight = machine.footprint.mass + sum(model.parameters.nominal[k] for k, name in enumerate(model.parameters.names)
                                          if name.endswith(".m"))
    np.testing.assert_allclose(both * limits.rows[tipping[0]].scale, 2.4 * 9.81 * weight, rtol=1e-9)


@pytest.mark.parametrize("seed", tiered(range(4), lambda seed: seed == 0))
def test_no_motion_breaks_a_limit(model: Model, seed: int) -> None:
    rng = np.random.default_rng(seed)
    machine = model.machine.model_copy(update={"pump": Pump(max_flow=float(rng.uniform(5e-4, 5e-3)))})
    narrow = Model(machine)
    basis = (Fourier(5.0, 2, blend=1.0), Spline(5.0, 4))[seed % 2]
    program = ExcitationProblem(Information(narrow, design_parameters(narrow, force_noise(narrow)), "D"),
                                Limits(narrow),
                      basis, 20.0, {"swing": 0.2} if seed == 3 else None)
    found = design(program, starts=1, seed=seed, search_seconds=3.0)
    assert all(use.room >= 0 for use in found.limits)
    path = found.trajectory
    speed = narrow.over(narrow.cylinder_kinematics, path.q, path.qd, path.qdd)[1][:, :, 0]
    motor = machine.motors[0]
    flow = abs(path.qd[:, 0]) * motor.torque_per_pressure * motor.gear + sum(
        np.where(speed[:, k] > 0, c.areas[0], -c.areas[1]) * speed[:, k] for k, c in enumerate(machine.cylinders))
    assert np.max(flow) <= machine.pump.max_flow * (1 + 1e-9)
    assert np.max(np.abs(path.qd)) > 0.01  # it does move
    if seed == 3:
        assert np.all(path.q[:, 0] == 0.2)


def test_what_no_posture_keeps_is_named(model: Model) -> None:
    def limited(machine: Machine) -> ExcitationProblem:
        own = Model(machine)
        information = Information(own, design_parameters(own, force_noise(own)), "D")
        return ExcitationProblem(information, Limits(own), BASES[1], 20.0)

    nowhere = Box(lower=(20.0, -1.0, -1.0), upper=(21.0, 1.0, 1.0))
    with pytest.raises(ProblemError, match="workspace along x cannot be kept in any posture"):
        design(limited(model.machine.model_copy(update={"workspace": nowhere})), starts=1, search_seconds=1.0)
    with pytest.raises(ProblemError, match="bandwidth"):
        ExcitationProblem(Information(model, design_parameters(model, force_noise(model)), "D"), Limits(model),
                          Fourier(5.0, 20), 20.0)
