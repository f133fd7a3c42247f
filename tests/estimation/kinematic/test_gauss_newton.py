"""The steps that eliminate the angles of poses end where IPOPT ends with all unknowns of `nlp` side by side."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from hydroopt.estimation.kinematic.initial_guesses import closed_angles, guess_unsensed
from hydroopt.estimation.kinematic.maximum_likelihood import maximum_likelihood
from hydroopt.estimation.kinematic.observability import linearise, observability
from hydroopt.estimation.kinematic.problem import CalibrationProblem, calibration_problem
from hydroopt.logs.poses import Poses
from hydroopt.machine.machine_file import load_machine
from hydroopt.model.closed_chain import KinematicModel
from hydroopt.simulation import postures
from studies import closed_postures
from tests.fixtures.surveyed import measured, surveyed, truth


def calibrator(priors: bool = True, wild: float = 0.0) -> CalibrationProblem:
    """Closed chains of an excavator, with locked and unsensed joints; in some poses a sensor errs by `wild`."""
    machine = load_machine("cat215b")
    model = KinematicModel(machine)
    nominal, at = model.parameters.nominal, machine.fixtures[0].position
    q = np.concatenate([closed_postures.random_postures(model, stage, 30, geometry=nominal, fixture=at, seed=k)
                        for k, stage in enumerate(machine.stages)])
    read = postures.record(model, q, [stage.name for stage in machine.stages for _ in range(30)], ["ball"] * len(q),
                           geometry=nominal, seed=1)
    channels = {name: values.copy() for name, values in read.channels.items()}
    channels["yoke.q"][::15] += wild
    poses = Poses(name="read", stage=read.stage, fixture=read.fixture, channels=channels)
    return calibration_problem(machine, poses, fixed={"ball.y": 0.0}, priors=priors)


def by_ipopt(problem: CalibrationProblem) -> tuple[np.ndarray, np.ndarray]:
    """Parameters and joint vectors by the program that a user gets, its variables in units of their own spread."""
    program, layout = problem.nlp(), problem.layout
    k = int(problem.free.sum())
    unit = np.append(problem.parameters.scale[problem.free], np.full(len(program.x0) - k, 0.01))
    y = ca.MX.sym("y", len(unit))
    f, g = ca.Function("nlp", [program.x], [program.f, program.g])(ca.DM(program.x0) + ca.DM(unit) * y)
    options = {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.tol": 1e-9}
    solver = ca.nlpsol("by_hand", "ipopt", {"x": y, "f": f, "g": g / 1e-3}, options)
    found = solver(x0=0, lbx=(program.lbx - program.x0) / unit, ubx=(program.ubx - program.x0) / unit, lbg=0, ubg=0)
    assert solver.stats()["success"]
    x = program.x0 + unit * np.asarray(found["x"]).ravel()
    theta, own = problem.start, layout.reading.ravel().copy()
    theta[problem.free] = x[:k]
    own[np.concatenate([np.flatnonzero((layout.sensed & (problem.angle_sigma > 0)).ravel()),
                        np.flatnonzero(layout.moving.ravel())])] = x[k:]
    return theta, problem.angles(theta, own.reshape(layout.reading.shape))


def survey() -> CalibrationProblem:
    machine, _ = surveyed()
    return calibration_problem(machine, measured(truth(1), seed=2))


def bounded() -> CalibrationProblem:
    """A length that may not grow as far as the poses ask."""
    problem = calibrator()
    found, _ = by_ipopt(problem)
    k = problem.parameters.index("boom.a")
    upper = problem.parameters.upper.copy()
    upper[k] = found[k] - 5e-3
    return replace(problem, parameters=replace(problem.parameters, upper=upper))


@pytest.mark.parametrize("build", [
    calibrator, pytest.param(lambda: calibrator(priors=False), id="data alone"), survey, bounded,
    pytest.param(lambda: calibrator(wild=0.03).with_loss("huber"), id="huber"),
    pytest.param(lambda: calibrator(wild=0.03).with_loss("student_t"), id="student_t",
                 marks=pytest.mark.slow)])
def test_the_answer_is_that_of_ipopt(build: Callable[[], CalibrationProblem]) -> None:
    problem = build()
    expected, angles = by_ipopt(problem)
    found, q = maximum_likelihood(problem, problem.start, guess_unsensed(problem, problem.start))
    at = linearise(problem, expected, closed_angles(problem, expected, angles))
    std = observability(problem, at).std
    known = np.isfinite(std)
    assert known.sum() > 10
    np.testing.assert_array_less(np.abs(found - expected)[problem.free][known], 1e-3 * std[known])
    read = problem.layout.sensed & (problem.angle_sigma > 0)
    np.testing.assert_array_less(np.abs(q - angles)[read], 1e-3 * np.broadcast_to(problem.angle_sigma, q.shape)[read])
