"""Solving a kinematic calibration, from one or several initial guesses."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hydroopt.errors import ProblemError, SolverError
from hydroopt.estimation.kinematic import link_by_link
from hydroopt.estimation.kinematic.initial_guesses import closed_angles, guess_unsensed
from hydroopt.estimation.kinematic.link_by_link import StageResult
from hydroopt.estimation.kinematic.maximum_likelihood import maximum_likelihood
from hydroopt.estimation.kinematic.observability import linearise
from hydroopt.estimation.kinematic.pose_checks import refuse_unusable
from hydroopt.estimation.kinematic.problem import CalibrationProblem
from hydroopt.estimation.kinematic.solution import HIERARCHICAL, JOINT, METHODS
from hydroopt.parameters.parameter_set import ParameterKind
from hydroopt.spatial.inertia import Array


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
    refuse_unusable(problem)
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
        theta, q = maximum_likelihood(problem, start, own)
    else:
        theta, q, stages = link_by_link.sequential_least_squares(problem, start, own)
    # a solver keeps bounds to its tolerance only; a machine must keep them to the last digit
    theta = np.clip(theta, problem.parameters.lower, problem.parameters.upper)
    return Optimum(_cost(problem, theta, q), theta, q, stages)


def with_farthest_pose(problem: CalibrationProblem, error: SolverError) -> SolverError:
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


def _cost(problem: CalibrationProblem, theta: Array, q: Array) -> float:
    linearised = linearise(problem, theta, q)
    return float(linearised.pose_square.sum() + np.sum(linearised.shared_residual**2))
