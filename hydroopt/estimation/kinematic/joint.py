"""The joint estimator: one bounded nonlinear program over all poses, stages and parameters, for IPOPT.

Unknowns are the parameters and every pose's own angles: those sensed, as errors in units of their σ, and those moving
without a sensor. Loops close as constraints. With Gaussian errors this is maximum likelihood (maximum a posteriori with
priors). Each pose touches its own angles and the parameters only: with v = (geometry, angles, place) of a pose, which
is linear in the unknowns x, all derivatives are those of one small function, mapped over the poses and gathered.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from hydroopt.estimation.inference import ipopt
from hydroopt.estimation.inference.program import NonlinearProgram
from hydroopt.estimation.kinematic.pose_equations import PoseEquations
from hydroopt.estimation.kinematic.robust_loss import robust_loss
from hydroopt.estimation.kinematic.unsensed_angles import guess_unsensed
from hydroopt.spatial.inertia import Array

ANGLE_STEP = 0.01
"""Scale [rad, m] of the angles that move unsensed."""
STEEPEST = 1e4
"""Curvature of the cost, by a parameter in its unit, that the units are chosen not to exceed."""


def maximum_likelihood(problem: PoseEquations, start: Array, angles: Array) -> tuple[Array, Array]:
    """Most probable parameters (P,) and the joint vectors (N, n) [rad, m] of all poses.

    Args:
        problem: what to solve.
        start: (P,) initial parameters.
        angles: (N, n) initial angles of the joints that move unsensed.

    Raises:
        SolverError: IPOPT failed or its answer failed our check.
    """
    layout, parameters = problem.layout, problem.parameters
    initial = np.where(problem.free, np.clip(start, parameters.lower, parameters.upper), problem.start)
    program = _JointProgram(problem, _Units(
        initial, _scale(problem, initial, angles), np.where(layout.moving, angles, layout.reading),
        np.where(layout.moving, ANGLE_STEP, problem.angle_sigma)), _typical_gap(problem))
    lower, upper = program.bounds
    zero = np.zeros(program.g.numel())
    answer = ipopt.solve_nlp({"x": program.x, "f": program.f, "g": program.g}, np.zeros(len(lower)), lower, upper,
                               zero, zero, f"calibration of {problem.model.machine.name}", (), program.derivatives())
    found = np.asarray(ca.Function("theta", [program.x], [program.theta])(answer)).ravel()
    v = np.asarray(ca.Function("v", [program.x], [program.v])(answer)).T
    first, n = len(problem.model.parameters), layout.reading.shape[1]
    return found, v[:, first : first + n]


def nonlinear_program(problem: PoseEquations) -> NonlinearProgram:
    """The program that `maximum_likelihood` solves, with all variables in SI: parameters, then angles of the poses."""
    layout, parameters, model = problem.layout, problem.parameters, problem.model
    start = np.clip(problem.start, parameters.lower, parameters.upper)
    angles = np.where(layout.moving, guess_unsensed(problem, start), layout.reading)
    variable = layout.moving | (layout.sensed & (problem.angle_sigma > 0))
    program = _JointProgram(problem, _Units(np.where(problem.free, 0.0, problem.start), np.ones(len(parameters)),
                                            np.where(variable, 0.0, angles), np.ones(angles.shape)), 1.0)
    poses, joints = np.divmod(program.angles, angles.shape[1])
    units = problem.model.machine.channel_units
    gaps = len(program.strict)
    estimated = program.estimated
    lower, upper = program.bounds
    return NonlinearProgram(
        x=program.x, f=program.f, g=program.g, p=ca.MX.sym("p", 0),
        x_names=(*(parameters.names[k] for k in estimated),
                 *(f"pose {pose + 1}: {model.joints[k]}.q" for pose, k in zip(poses, joints, strict=True))),
        x_units=(*(parameters.units[k] for k in estimated), *(units[f"{model.joints[k]}.q"] for k in joints)),
        x0=np.concatenate([start[estimated], angles.ravel()[program.angles]]), lbx=lower, ubx=upper,
        g_names=tuple(f"pose {k // layout.present.shape[1] + 1}: loop closure" for k in program.strict),
        g_units=("m",) * gaps, lbg=np.zeros(gaps), ubg=np.zeros(gaps), objective=tuple(problem.objective))


class _Units(NamedTuple):
    """Variables as x = (parameter − theta) / theta_unit, and likewise of the angles: (P,), (P,), (N, n), (N, n)."""

    theta: Array
    theta_unit: Array
    angles: Array
    angle_unit: Array


class _JointProgram:
    """The nonlinear program in chosen units; the loops' gaps are divided by `gap_unit` [m].

    x has the parameters at `estimated`, then the angles at the flat positions `angles` in (N, n): those that are read
    with errors, and those that move unsensed. `strict` are the flat positions in (N, m) of the rows g that must vanish.
    """

    def __init__(self, problem: PoseEquations, units: _Units, gap_unit: float) -> None:
        layout, self.problem, self.units = problem.layout, problem, units
        count, self.rows = layout.present.shape
        self.estimated = np.flatnonzero(problem.free)
        self.angles = np.concatenate([np.flatnonzero((layout.sensed & (problem.angle_sigma > 0)).ravel()),
                                      np.flatnonzero(layout.moving.ravel())])
        offset, self.slope = self._pose_variables()
        self.x = ca.MX.sym("x", len(self.estimated) + len(self.angles))
        self.theta = ca.DM(units.theta) + _scatter(
            self.estimated, units.theta_unit[self.estimated], len(problem.parameters)) @ self.x[: len(self.estimated)]
        self.shared = _shared_cost(problem, self.theta)
        self.pose = _PoseTerms(problem)
        self.v = ca.reshape(ca.DM(offset) + self.slope @ self.x, self.pose.size, count)
        self.strict = np.flatnonzero((layout.present & (problem.row_sigma == 0)).ravel())
        self.pick = _matrix((np.arange(len(self.strict)), self.strict, np.full(len(self.strict), 1 / gap_unit)),
                            len(self.strict), count * self.rows)
        self.g = self.pick @ ca.vec(self.pose.rows.map(count)(self.v, self.pose.data))
        self.f = ca.sum2(self.pose.cost.map(count)(self.v, self.pose.data)) + self.shared

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper bounds of x; angles have none."""
        parameters, some, units = self.problem.parameters, self.estimated, self.units
        free = np.full(len(self.angles), np.inf)
        return (np.concatenate([((parameters.lower - units.theta) / units.theta_unit)[some], -free]),
                np.concatenate([((parameters.upper - units.theta) / units.theta_unit)[some], free]))

    def derivatives(self) -> dict[str, ca.Function]:
        """Gradient, Jacobian and Hessian as `nlpsol` takes them, gathered from those of one pose."""
        pose, v, x, slope = self.pose, self.v, self.x, self.slope
        count, m = v.shape[1], self.rows
        slopes = pose.cost_gradient.map(count)(v, pose.data)
        gradient = ca.gradient(self.shared, x) + slope.T @ ca.vec(slopes)
        turn = ca.MX(_blocks(m, pose.size, count), ca.vec(pose.rows_jacobian.map(count)(v, pose.data)))
        jacobian = self.pick @ (turn @ slope)
        weight, multipliers = ca.MX.sym("weight"), ca.MX.sym("multipliers", len(self.strict))
        nothing = ca.MX.sym("p", 0)
        by_pose = ca.reshape(self.pick.T @ multipliers, m, count)
        bend = ca.MX(_blocks(pose.size, pose.size, count),
                     ca.vec(pose.hessian.map(count)(v, pose.data, weight, by_pose)))
        hessian = slope.T @ (bend @ slope) + weight * ca.hessian(self.shared, x)[0]
        return {
            "grad_f": ca.Function("grad_f", [x, nothing], [self.f, gradient], ["x", "p"], ["f", "grad_f_x"]),
            "jac_g": ca.Function("jac_g", [x, nothing], [self.g, jacobian], ["x", "p"], ["g", "jac_g_x"]),
            "hess_lag": ca.Function("hess_lag", [x, nothing, weight, multipliers], [ca.triu(hessian)],
                                    ["x", "p", "lam_f", "lam_g"], ["triu_hess_gamma_x_x"])}

    def _pose_variables(self) -> tuple[Array, ca.DM]:
        """Offset and slope of v = offset + slope·x: geometry, angles and place of all poses, one after another."""
        problem, units, layout, g = self.problem, self.units, self.problem.layout, len(self.problem.model.parameters)
        count, n = layout.reading.shape
        k = layout.place.shape[1]
        width = g + n + k
        places: list[tuple[Any, Any, Any]] = []  # of v on the parameters: rows, parameters, factors
        pose = np.arange(count)
        for i in range(g):
            places.append((pose * width + i, np.full(count, i), np.ones(count)))
        where, which, factor = layout.locked
        places.append((where // n * width + g + where % n, which, factor))
        held = np.flatnonzero(layout.place.ravel() >= 0)
        places.append((held // k * width + g + n + held % k, layout.place.ravel()[held], np.ones(len(held))))
        row, parameter, value = (np.concatenate(part) for part in zip(*places, strict=True))
        offset = np.zeros((count, width))
        offset[:, g : g + n] = units.angles
        offset[:, g + n :] = layout.given
        np.add.at(offset.ravel(), row, value * units.theta[parameter])
        column = np.full(len(problem.parameters), -1)
        column[self.estimated] = np.arange(len(self.estimated))
        free, angles = column[parameter] >= 0, self.angles
        slope = (np.concatenate([row[free], angles // n * width + g + angles % n]),
                 np.concatenate([column[parameter[free]], len(self.estimated) + np.arange(len(angles))]),
                 np.concatenate([value[free] * units.theta_unit[parameter[free]], units.angle_unit.ravel()[angles]]))
        return offset.ravel(), _matrix(slope, count * width, len(self.estimated) + len(angles))


class _PoseTerms:
    """What one pose adds to cost and constraints, as functions of its v and its data, with derivatives."""

    def __init__(self, problem: PoseEquations) -> None:
        layout, model = problem.layout, problem.model
        count, n = layout.reading.shape
        g, m = len(model.parameters), layout.present.shape[1]
        self.size = g + n + model.place_size
        v, data = ca.SX.sym("v", self.size), ca.SX.sym("data", 2 * n + 2 * m + 1)
        reading, angle_weight, target, row_weight, expected = ca.vertsplit(data, [0, n, 2 * n, 2 * n + m,
                                                                                  2 * n + 2 * m, 2 * n + 2 * m + 1])
        q = v[g : g + n]
        rows = model.observed(v[:g], q, v[g + n :]) - target
        square = ca.sumsqr((q - reading) * angle_weight) + ca.sumsqr(rows * row_weight)
        cost = robust_loss(square, problem.loss, expected) / 2
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


def _scale(problem: PoseEquations, theta: Array, angles: Array) -> Array:
    """Units (P,) of the parameters in which the cost is not too steep.

    With 1 m beside a reading's 1 mm, rounding errors alone would be larger than the gradient that IPOPT accepts.
    """
    weighed = problem.layout.present & (problem.row_sigma > 0)
    slope = problem.rows(theta, problem.angles(theta, angles))[1] * _inverse(problem.row_sigma, weighed)[:, :, None]
    steep = np.sum(slope**2, axis=(0, 1))
    return np.asarray(1 / np.sqrt(1 / problem.parameters.scale**2 + steep / STEEPEST))


def _inverse(sigma: Array, where: NDArray[np.bool_]) -> Array:
    return np.where(where, 1 / np.where(where, sigma, 1.0), 0.0)


def _shared_cost(problem: PoseEquations, theta: ca.MX) -> ca.MX:
    """Priors and known distances."""
    cost = ca.sumsqr(ca.DM(problem.known) * (theta - ca.DM(problem.parameters.nominal))) / 2
    known_distances = problem.distances
    for ends, length, spread in zip(known_distances.ends, known_distances.length, known_distances.sigma, strict=True):
        apart = theta[ends[0].tolist()] - theta[ends[1].tolist()]
        cost += ((ca.norm_2(apart) - length) / spread) ** 2 / 2
    return cost


def _typical_gap(problem: PoseEquations) -> float:
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
