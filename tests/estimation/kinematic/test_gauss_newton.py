"""The steps that eliminate the angles of poses end where IPOPT ends with all unknowns side by side."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from hydroopt.estimation.kinematic import maximum_likelihood
from hydroopt.estimation.kinematic.observability import linearise, observability
from hydroopt.estimation.kinematic.problem import CalibrationProblem, calibration_problem
from hydroopt.estimation.kinematic.unsensed_angles import closed_angles, guess_unsensed
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


def survey() -> CalibrationProblem:
    machine, _ = surveyed()
    return calibration_problem(machine, measured(truth(1), seed=2))


def bounded() -> CalibrationProblem:
    """A length that may not grow as far as the poses ask."""
    problem = calibrator()
    found, _ = maximum_likelihood.by_ipopt(problem, problem.start, guess_unsensed(problem, problem.start))
    k = problem.parameters.index("boom.a")
    upper = problem.parameters.upper.copy()
    upper[k] = found[k] - 5e-3
    return replace(problem, parameters=replace(problem.parameters, upper=upper))


@pytest.mark.parametrize("build", [
    calibrator, pytest.param(lambda: calibrator(priors=False), id="data alone"), survey, bounded,
    pytest.param(lambda: calibrator(wild=0.03).with_loss("huber"), id="huber"),
    pytest.param(lambda: calibrator(wild=0.03).with_loss("student_t"), id="student_t")])
def test_the_answer_is_that_of_ipopt(build: Callable[[], CalibrationProblem], monkeypatch: pytest.MonkeyPatch) -> None:
    problem = build()
    own = guess_unsensed(problem, problem.start)
    expected, angles = maximum_likelihood.by_ipopt(problem, problem.start, own)

    def refused(*_: object) -> None:
        raise AssertionError("the steps did not converge")

    monkeypatch.setattr(maximum_likelihood, "by_ipopt", refused)
    found, q = maximum_likelihood.maximum_likelihood(problem, problem.start, own)
    at = linearise(problem, expected, closed_angles(problem, expected, angles))
    std = observability(problem, at).std
    known = np.isfinite(std)
    assert known.sum() > 10
    np.testing.assert_array_less(np.abs(found - expected)[problem.free][known], 1e-3 * std[known])
    read = problem.layout.sensed & (problem.angle_sigma > 0)
    np.testing.assert_array_less(np.abs(q - angles)[read], 1e-3 * np.broadcast_to(problem.angle_sigma, q.shape)[read])
