"""The joint estimator: one bounded nonlinear program over all poses, stages and parameters, for IPOPT.

Unknowns are the parameters and every pose's own angles: those sensed, as errors in units of their σ, and those moving
without a sensor. Loops close as constraints. With Gaussian errors this is maximum likelihood (maximum a posteriori with
priors). Each pose touches its own angles and the parameters only: with v = (geometry, angles, fixture) of a pose, which
is linear in the unknowns x, all derivatives are those of one small function, mapped over the poses and gathered.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from hydroopt.estimation.inference import solvers
from hydroopt.estimation.kinematic.problem import CalibrationProblem
from hydroopt.spatial.inertia import Array

HUBER = 3.0
"""Error of a pose, in units of what is expected, beyond which Huber's loss grows linearly."""
FREEDOM = 4.0
"""Degrees of freedom of Student's t."""
ANGLE_STEP = 0.01
"""Scale [rad, m] of the angles that move unsensed."""
STEEPEST = 1e4
"""Curvature of the cost, by a parameter in its unit, that the units are chosen not to exceed."""


def maximum_likelihood(problem: CalibrationProblem, start: Array, own: Array) -> tuple[Array, Array]:
    """Most probable parameters (P,) and the joint vectors (N, n) [rad, m] of all poses.

    Args:
        problem: what to solve.
        start: (P,) parameters to begin with.
        own: (N, n) angles to begin with, used where joints move unsensed.

    Raises:
        SolverError: IPOPT failed or its answer failed our check.
    """
    layout, parameters = problem.layout, problem.parameters
    count, n = layout.reading.shape
    estimated = np.flatnonzero(problem.free)
    begin = np.where(problem.free, np.clip(start, parameters.lower, parameters.upper), problem.start)
    scale = _scale(problem, begin, own)
    unknowns = _Unknowns(problem, estimated, begin, own, scale)
    x = ca.MX.sym("x", unknowns.size)
    theta = ca.DM(begin) + _scatter(estimated, scale[estimated], len(parameters)) @ x[: len(estimated)]
    shared = _shared_cost(problem, theta)
    pose = _PoseTerms(problem)
    v = ca.reshape(ca.DM(unknowns.offset) + unknowns.slope @ x, pose.size, count)
    strict = np.flatnonzero((layout.present & (problem.row_sigma == 0)).ravel())
    m, unit = layout.present.shape[1], _typical_gap(problem)
    pick = _matrix((np.arange(len(strict)), strict, np.full(len(strict), 1 / unit)), len(strict), count * m)
    rows = pick @ ca.vec(pose.rows.map(count)(v, pose.data))
    cost = ca.sum2(pose.cost.map(count)(v, pose.data)) + shared
    slopes = pose.cost_gradient.map(count)(v, pose.data)
    gradient = ca.gradient(shared, x) + unknowns.slope.T @ ca.vec(slopes)
    turn = ca.MX(_blocks(m, pose.size, count), ca.vec(pose.rows_jacobian.map(count)(v, pose.data)))
    jacobian = pick @ (turn @ unknowns.slope)
    weight, multipliers, nothing = ca.MX.sym("weight"), ca.MX.sym("multipliers", len(strict)), ca.MX.sym("p", 0)
    by_pose = ca.reshape(pick.T @ multipliers, m, count)
    bend = ca.MX(_blocks(pose.size, pose.size, count), ca.vec(pose.hessian.map(count)(v, pose.data, weight, by_pose)))
    hessian = unknowns.slope.T @ (bend @ unknowns.slope) + weight * ca.hessian(shared, x)[0]
    derivatives = {
        "grad_f": ca.Function("grad_f", [x, nothing], [cost, gradient], ["x", "p"], ["f", "grad_f_x"]),
        "jac_g": ca.Function("jac_g", [x, nothing], [rows, jacobian], ["x", "p"], ["g", "jac_g_x"]),
        "hess_lag": ca.Function("hess_lag", [x, nothing, weight, multipliers], [ca.triu(hessian)],
                                ["x", "p", "lam_f", "lam_g"], ["triu_hess_gamma_x_x"])}
    lower, upper = np.full(unknowns.size, -np.inf), np.full(unknowns.size, np.inf)
    lower[: len(estimated)] = ((parameters.lower - begin) / scale)[estimated]
    upper[: len(estimated)] = ((parameters.upper - begin) / scale)[estimated]
    zero = np.zeros(len(strict))
    answer = solvers.solve_nlp({"x": x, "f": cost, "g": rows}, np.zeros(unknowns.size), lower, upper, zero, zero,
                               f"calibration of {problem.model.machine.name}", (), derivatives)
    found = np.asarray(ca.Function("theta", [x], [theta])(answer)).ravel()
    angles = np.asarray(ca.Function("v", [x], [v])(answer)).T
    return found, angles[:, len(problem.model.parameters) : len(problem.model.parameters) + n]


class _Unknowns:
    """x = (parameters, errors of readings, unsensed angles), scaled, and v = offset + slope·x of all poses."""

    def __init__(self, problem: CalibrationProblem, estimated: NDArray[np.intp], begin: Array, own: Array,
                 scale: Array) -> None:
        layout, g = problem.layout, len(problem.model.parameters)
        count, n = layout.reading.shape
        width = g + n + 3
        erring = np.flatnonzero((layout.sensed & (problem.angle_sigma > 0)).ravel())
        moving = np.flatnonzero(layout.moving.ravel())
        self.size = len(estimated) + len(erring) + len(moving)
        places: list[tuple[Any, Any, Any]] = []  # of v on the parameters: rows, parameters, factors
        pose = np.arange(count)
        for k in range(g):
            places.append((pose * width + k, np.full(count, k), np.ones(count)))
        where, which, factor = layout.locked
        places.append((where // n * width + g + where % n, which, factor))
        held = np.flatnonzero(layout.fixture.ravel() >= 0)
        places.append((held // 3 * width + g + n + held % 3, layout.fixture.ravel()[held], np.ones(len(held))))
        row, parameter, value = (np.concatenate(part) for part in zip(*places, strict=True))
        offset = np.zeros((count, width))
        offset[:, g : g + n] = np.where(layout.moving, own, layout.reading)
        np.add.at(offset.ravel(), row, value * begin[parameter])
        self.offset = offset.ravel()
        column = np.full(len(begin), -1)
        column[estimated] = np.arange(len(estimated))
        free = column[parameter] >= 0
        sigma = np.broadcast_to(problem.angle_sigma, (count, n)).ravel()
        angles = np.concatenate([erring, moving])
        slope = (np.concatenate([row[free], angles // n * width + g + angles % n]),
                 np.concatenate([column[parameter[free]], len(estimated) + np.arange(len(angles))]),
                 np.concatenate([value[free] * scale[parameter[free]], sigma[erring],
                                 np.full(len(moving), ANGLE_STEP)]))
        self.slope = _matrix(slope, count * width, self.size)


class _PoseTerms:
    """What one pose adds to cost and constraints, as functions of its v and its data, with derivatives."""

    def __init__(self, problem: CalibrationProblem) -> None:
        layout, model = problem.layout, problem.model
        count, n = layout.reading.shape
        g, m = len(model.parameters), layout.present.shape[1]
        self.size = g + n + 3
        v, data = ca.SX.sym("v", self.size), ca.SX.sym("data", 2 * n + 2 * m + 1)
        reading, angle_weight, target, row_weight, expected = ca.vertsplit(data, [0, n, 2 * n, 2 * n + m,
                                                                                  2 * n + 2 * m, 2 * n + 2 * m + 1])
        q = v[g : g + n]
        rows = model.observed(v[:g], q, v[g + n :]) - target
        square = ca.sumsqr((q - reading) * angle_weight) + ca.sumsqr(rows * row_weight)
        cost = _loss(square, problem.loss, expected) / 2
        weight, multipliers = ca.SX.sym("weight"), ca.SX.sym("multipliers", m)
        lagrangian = weight * cost + ca.dot(multipliers, rows)
        self.rows = ca.Function("rows", [v, data], [rows])
        self.cost = ca.Function("cost", [v, data], [cost])
        self.cost_gradient = ca.Function("cost_gradient", [v, data], [ca.gradient(cost, v)])
        self.rows_jacobian = ca.Function("rows_jacobian", [v, data], [ca.densify(ca.jacobian(rows, v))])
        self.hessian = ca.Function("hessian", [v, data, weight, multipliers],
                                   [ca.densify(ca.hessian(lagrangian, v)[0])])
        known = layout.sensed & (problem.angle_sigma > 0)
        weighed = layout.present & (problem.row_sigma > 0)
        self.data = ca.DM(np.hstack([
            layout.reading, _inverse(np.broadcast_to(problem.angle_sigma, (count, n)), known), layout.target,
            _inverse(problem.row_sigma, weighed), np.maximum(layout.present.sum(axis=1, keepdims=True), 1)]).T)


def _scale(problem: CalibrationProblem, theta: Array, own: Array) -> Array:
    """Units (P,) of the parameters in which the cost is not too steep.

    With 1 m beside a reading's 1 mm, rounding errors alone would be larger than the gradient that IPOPT accepts.
    """
    weighed = problem.layout.present & (problem.row_sigma > 0)
    slope = problem.rows(theta, problem.angles(theta, own))[1] * _inverse(problem.row_sigma, weighed)[:, :, None]
    steep = np.sum(slope**2, axis=(0, 1))
    return np.asarray(1 / np.sqrt(1 / problem.parameters.scale**2 + steep / STEEPEST))


def _inverse(sigma: Array, where: NDArray[np.bool_]) -> Array:
    return np.where(where, 1 / np.where(where, sigma, 1.0), 0.0)


def _loss(square: ca.SX, loss: str, expected: ca.SX) -> ca.SX:
    """Cost of a squared error; near zero all behave as the square."""
    if loss == "huber":
        limit = HUBER**2 * expected
        return ca.if_else(square <= limit, square, 2 * ca.sqrt(limit * ca.fmax(square, limit)) - limit)
    if loss == "student_t":
        return (FREEDOM + expected) * ca.log1p(square / (FREEDOM + expected))
    return square


def _shared_cost(problem: CalibrationProblem, theta: ca.MX) -> ca.MX:
    """Priors and known distances."""
    cost = ca.sumsqr(ca.DM(problem.known) * (theta - ca.DM(problem.parameters.nominal))) / 2
    known_distances = problem.distances
    for ends, length, spread in zip(known_distances.ends, known_distances.length, known_distances.sigma, strict=True):
        apart = theta[ends[0].tolist()] - theta[ends[1].tolist()]
        cost += ((ca.norm_2(apart) - length) / spread) ** 2 / 2
    return cost


def _typical_gap(problem: CalibrationProblem) -> float:
    """How far the tip is off [m] by the errors of the angles: the unit in which loops are closed."""
    reach = sum(abs(link.joint.a) + abs(link.joint.d) for link in problem.model.links) + 0.1
    return float(max(np.max(problem.angle_sigma, initial=0.0), 1e-6) * reach)


def _blocks(rows: int, columns: int, count: int) -> ca.Sparsity:
    """Block-diagonal pattern of dense blocks, whose nonzeros stand block by block."""
    row = (np.arange(rows)[None, None, :] + rows * np.arange(count)[:, None, None]) + np.zeros((1, columns, 1), int)
    return ca.Sparsity(rows * count, columns * count, (np.arange(columns * count + 1) * rows).tolist(),
                       row.ravel().tolist())


def _matrix(triplets: tuple[Any, Any, Any], rows: int, columns: int) -> ca.DM:
    row, column, value = triplets
    if not len(row):
        return ca.DM(rows, columns)
    return ca.DM.triplet(np.asarray(row).tolist(), np.asarray(column).tolist(), ca.DM(np.asarray(value)), rows, columns)


def _scatter(where: Any, value: Array, size: int) -> ca.DM:
    return _matrix((where, np.arange(len(where)), value), size, len(where))
