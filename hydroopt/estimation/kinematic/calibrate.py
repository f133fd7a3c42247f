"""Solving a kinematic calibration, from one or several initial guesses."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from hydroopt.errors import ProblemError, SolverError
from hydroopt.estimation.kinematic import gauss_newton, link_by_link
from hydroopt.estimation.kinematic.calibration import Calibration
from hydroopt.estimation.kinematic.column_checks import refuse_misread
from hydroopt.estimation.kinematic.inclination_checks import refuse_misread_inclination
from hydroopt.estimation.kinematic.instrument_poses import refuse_unseen
from hydroopt.estimation.kinematic.length_scale import has_length_scale, no_length_scale
from hydroopt.estimation.kinematic.observability import linearise, observability
from hydroopt.estimation.kinematic.planned_readings import refuse_planned
from hydroopt.estimation.kinematic.problem import CalibrationProblem
from hydroopt.estimation.kinematic.residuals import loop_fit, predicted
from hydroopt.estimation.kinematic.solution import HIERARCHICAL, JOINT, METHODS
from hydroopt.estimation.kinematic.stage_result import StageResult
from hydroopt.estimation.kinematic.suspects import find_suspects
from hydroopt.estimation.kinematic.touched_datums import refuse_untouched
from hydroopt.estimation.kinematic.uniqueness import uniqueness
from hydroopt.estimation.kinematic.unsensed_angles import closed_angles, follow_unsensed, guess_unsensed
from hydroopt.parameters.parameter_set import ParameterKind
from hydroopt.spatial.inertia import Array


def calibrate(problem: CalibrationProblem, method: str = "joint", *, starts: int = 1, seed: int = 0) -> Calibration:
    """Solve a kinematic calibration.

    Args:
        problem: what to calibrate from which poses.
        method: ``joint`` or ``hierarchical``.
        starts: number of initial guesses; the first is the nominal machine, the others are drawn about it with its
            confidences.
        seed: of the other initial guesses, and of the postures that stand for the workspace.

    Raises:
        ProblemError: unknown method, or the poses cannot determine the parameters.
        SolverError: no trustworthy answer.
    """
    if starts < 1:
        raise ProblemError(f"{starts} initial guesses are too few", where="--starts", remedy="ask for one or more")
    refuse_planned(problem)
    return _calibrated(problem, method, starts=starts, seed=seed)


def _calibrated(problem: CalibrationProblem, method: str, *, starts: int, seed: int) -> Calibration:
    """The calibration of poses that were measured."""
    problem = solvable(problem, method)
    rng = np.random.default_rng(seed)
    answers: list[Optimum] = []
    failed = 0
    for k in range(starts):
        try:
            answers.append(optimum(problem, method, random_start(problem, rng) if k else problem.start))
        except SolverError as error:
            if starts == 1 or (k == starts - 1 and not answers):
                raise _with_farthest_pose(problem, error) from None
            failed += 1
    answers.sort(key=lambda answer: answer.cost)
    _, theta, q, stages = answers[0]
    linearised = linearise(problem, theta, closed_angles(problem, theta, q))
    identified = observability(problem, linearised)
    determined = int(np.sum(np.isfinite(identified.std)))
    freedom = int(linearised.rank.sum()) + len(linearised.shared_residual) - determined
    squares = float(linearised.pose_square.sum() + np.sum(linearised.shared_residual**2))
    scale = float(np.sqrt(squares / freedom)) if freedom > 0 else float("nan")
    nominal = follow_unsensed(problem, problem.start, guess_unsensed(problem, problem.start))
    fits = {"nominal": loop_fit(problem, problem.start, nominal), "train": loop_fit(problem, theta, q)}
    if problem.validation is not None:
        fits["validation"] = loop_fit(*predicted(problem, theta, problem.validation))
    return Calibration(problem, method, theta, q, identified, linearised, scale, fits,
                       find_suspects(problem, q, linearised, identified),
                       uniqueness(identified, [answer[:2] for answer in answers], failed, problem.free), seed, stages)


def without_suspects(calibration: Calibration, *, starts: int = 1) -> Calibration:
    """The calibration solved again without the poses that contradict the others; unchanged where there are none.

    Args:
        calibration: with all poses; the answer keeps it as `all_poses`.
        starts: as for `calibrate`.

    Raises:
        ProblemError, SolverError: see `calibrate`.
    """
    if not np.any(calibration.suspicious):
        return calibration
    solved = _calibrated(calibration.problem.without(calibration.suspicious), calibration.algorithm, starts=starts,
                         seed=calibration.seed)
    return replace(solved, all_poses=calibration)


def solvable(problem: CalibrationProblem, method: str) -> CalibrationProblem:
    """The problem as a method solves it.

    Raises:
        ProblemError: unknown method, or the poses cannot determine the parameters.
    """
    if method not in METHODS:
        raise ProblemError(f"'{method}' is not a method of kinematic calibration", where="--method",
                           remedy=f"use {' or '.join(METHODS)}")
    if method == HIERARCHICAL:  # which has no drift, as in the thesis
        drifts = problem.parameters.places(ParameterKind.DRIFT)
        problem = problem.fixing(**{problem.parameters.names[k]: 0.0 for k in drifts})
    if not np.any(problem.free):
        raise ProblemError("no number of the geometry states a confidence, so that nothing is calibrated",
                           where=f"machine '{problem.model.machine.name}'",
                           remedy="give a 'sigma' to the lengths, angles and pins to calibrate")
    _refuse_too_few(problem)
    if not has_length_scale(problem):
        raise no_length_scale(f"poses of {problem.poses.name}", "fix a length, state a distance between fixtures, or "
                              "read a tape, a tracker or a cylinder's length")
    refuse_unseen(problem)
    refuse_untouched(problem)
    refuse_misread_inclination(problem)
    refuse_misread(problem)
    return problem


def random_start(problem: CalibrationProblem, rng: np.random.Generator) -> Array:
    """Parameters (P,) drawn about the nominal ones with their confidences."""
    parameters = problem.parameters
    offset = rng.standard_normal(len(parameters)) * parameters.scale * problem.free
    return np.asarray(problem.start + offset)


class Optimum(NamedTuple):
    """Squared errors, parameters (P,), joint vectors (N, n), and what stages gave by the method ``hierarchical``."""

    cost: float
    theta: Array
    q: Array
    stages: tuple[StageResult, ...] = ()


def optimum(problem: CalibrationProblem, method: str, start: Array) -> Optimum:
    """The optimum that an initial guess (P,) leads to.

    The guess is moved into the bounds first.

    Raises:
        SolverError: the solver did not converge.
    """
    start = np.clip(start, problem.parameters.lower, problem.parameters.upper)
    own = guess_unsensed(problem, start)
    stages: tuple[StageResult, ...] = ()
    if method == JOINT:
        theta, q = gauss_newton.maximum_likelihood(problem, start, own)
    else:
        theta, q, stages = link_by_link.sequential_least_squares(problem, start, own)
    # a solver keeps bounds to its tolerance only; a machine must keep them to the last digit
    theta = np.clip(theta, problem.parameters.lower, problem.parameters.upper)
    return Optimum(_cost(problem, theta, q), theta, q, stages)


def _with_farthest_pose(problem: CalibrationProblem, error: SolverError) -> SolverError:
    """The error with the pose to look at first: its readings are farthest from the geometry that the file states."""
    q = closed_angles(problem, problem.start, guess_unsensed(problem, problem.start))
    linearised = linearise(problem, problem.start, np.where(problem.layout.moving, q, problem.layout.reading))
    by_scale = linearised.jacobian * np.where(problem.free, problem.parameters.scale, 0.0)
    covariance = np.eye(by_scale.shape[1]) + by_scale @ by_scale.transpose(0, 2, 1)
    distance = np.einsum("nu,nu->n", linearised.residual,
                         np.linalg.solve(covariance, linearised.residual[:, :, None])[:, :, 0])
    farthest = int(np.argmax(distance / np.maximum(linearised.rank, 1)))
    file, row = problem.poses.file[farthest] or problem.poses.name, problem.poses.row[farthest]
    return SolverError(error.what, where=f"{file}, data row {row}", remedy="this row's readings are farthest from what "
                       "the machine file states: correct them or leave the row out; else start from a better nominal "
                       "machine")


def _refuse_too_few(problem: CalibrationProblem) -> None:
    rows = int(problem.layout.present.sum() - problem.layout.moving.sum()) + len(problem.distances.length)
    unknown = int(np.sum(problem.free & (problem.known == 0)))
    if rows < unknown:
        raise ProblemError(f"{rows} equations of all poses are too few for {unknown} unknown parameters",
                           where=f"poses of {problem.poses.name}", remedy="measure more poses or fix parameters")


def _cost(problem: CalibrationProblem, theta: Array, q: Array) -> float:
    linearised = linearise(problem, theta, q)
    return float(linearised.pose_square.sum() + np.sum(linearised.shared_residual**2))
