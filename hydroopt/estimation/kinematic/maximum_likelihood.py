"""Maximum likelihood over all poses, stages and parameters, with the angles of every pose eliminated.

Unknowns are the parameters and every pose's own angles: those sensed, as errors in units of their σ, and those moving
without a sensor. Loops close as constraints. With Gaussian errors this is maximum likelihood (maximum a posteriori with
priors). Around parameters θ and joint vectors q the whitened rows of a pose are w + J·δθ: errors of its sensed angles
count in their covariance, and what unsensed angles change is projected out (`linearise`). A step's equations have the
size of θ, whatever the number of poses, and the angles follow from the step. Poses whose steps do not converge are left
to IPOPT, with all unknowns side by side.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from hydroopt.estimation.inference import ipopt
from hydroopt.estimation.inference.gauss_newton import ROUNDING, Step, bounded_step, minimise
from hydroopt.estimation.inference.program import NonlinearProgram
from hydroopt.estimation.kinematic.observability import Linearised, linearise
from hydroopt.estimation.kinematic.pose_equations import PoseEquations, robust_loss
from hydroopt.estimation.kinematic.unsensed_angles import guess_unsensed
from hydroopt.spatial.inertia import Array

CONVERGED = 1e-6
"""Length of a step, in standard deviations of what the rows determine, that ends the search."""
ANGLE_STEP = 0.01
"""Scale [rad, m] of the angles that move unsensed."""
CORRECTIONS = 3
"""Steps of the angles alone, at the parameters of a trial, before it counts as refused."""
DETERMINED = 1e-6
"""Singular value of the rows with columns of unit length, relative to the largest, below which a direction stays."""
STEEPEST = 1e4
"""Curvature of the cost, by a parameter in its unit, that IPOPT's units are chosen not to exceed."""


def maximum_likelihood(problem: PoseEquations, start: Array, angles: Array) -> tuple[Array, Array]:
    """Most probable parameters (P,) and the joint vectors (N, n) [rad, m] of all poses.

    Args:
        problem: what to solve.
        start: (P,) initial parameters; they are moved into the bounds.
        angles: (N, n) initial angles of the joints that move unsensed.

    Raises:
        ProblemError: the errors of the loops are not stated.
        SolverError: IPOPT failed as well, or its answer failed our check.
    """
    inside = np.where(problem.free, np.clip(start, problem.parameters.lower, problem.parameters.upper), problem.start)
    own = np.where(problem.layout.moving, angles, problem.layout.reading)
    found = minimise(_Place.at(problem, inside, own), tolerance=CONVERGED)
    return (found.place.theta, found.place.q) if found.converged else by_ipopt(problem, start, angles)


@dataclass(frozen=True, eq=False)
class _Place:
    """Parameters (P,), joint vectors (N, n), and the linearised rows of the poses there."""

    problem: PoseEquations
    theta: Array
    q: Array
    rows: Linearised
    unsettled: float = np.inf

    @classmethod
    def at(cls, problem: PoseEquations, theta: Array, own: Array) -> _Place:
        q = problem.angles(theta, own)
        return cls(problem, theta, q, linearise(problem, theta, q))

    @cached_property
    def _losses(self) -> tuple[Array, Array]:
        """Costs (N,) of the poses' squared errors, and their derivatives (N,): weights of a reweighted least squares.
        """
        s, e = ca.SX.sym("s"), ca.SX.sym("e")
        cost = robust_loss(s, self.problem.loss, e)
        both = ca.Function("loss", [s, e], [cost, ca.gradient(cost, s)])
        found = both(self.rows.pose_square[None, :], self.problem.layout.expected[None, :])
        return np.asarray(found[0]).ravel(), np.asarray(found[1]).ravel()

    @property
    def cost(self) -> float:
        return float(np.sum(self._losses[0]) + np.sum(self.rows.shared_residual**2))

    def step(self, damping: float) -> Step:
        rows, parameters, free = self.rows, self.problem.parameters, self.problem.free
        root = np.sqrt(self._losses[1])[:, None]
        stacked = np.vstack([
            np.concatenate([rows.jacobian, rows.residual[:, :, None]], axis=2).reshape(-1, len(free) + 1)
            * np.repeat(root, rows.residual.shape[1], axis=0), np.column_stack([rows.shared, rows.shared_residual])])
        lower, upper = (np.where(free, bound - self.theta, 0.0) for bound in (parameters.lower, parameters.upper))
        return bounded_step(stacked, damping, lower, upper, truncation=DETERMINED)

    def after(self, change: Array) -> _Place:
        """The place after a step, with angles that follow it; they are corrected while the cost is larger."""
        problem, allowed = self.problem, self.cost * (1 + ROUNDING) + CONVERGED**2
        trial = _Place.at(problem, self.theta + change, self.rows.followed(problem, self.q, change))
        for _ in range(CORRECTIONS):
            if trial.cost <= allowed:
                break
            trial = _Place.at(problem, trial.theta, trial.rows.followed(problem, trial.q, np.zeros(len(change))))
        unit = np.where(problem.layout.moving, ANGLE_STEP, np.where(problem.layout.sensed, problem.angle_sigma, 0.0))
        moved = np.abs(trial.q - self.q)[unit > 0] / unit[unit > 0]
        return replace(trial, unsettled=float(np.max(moved, initial=0.0)))


def by_ipopt(problem: PoseEquations, start: Array, angles: Array) -> tuple[Array, Array]:
    """As `maximum_likelihood`, by IPOPT.

    Raises:
        SolverError: IPOPT failed or its answer failed our check.
    """
    layout, parameters = problem.layout, problem.parameters
    initial = np.where(problem.free, np.clip(start, parameters.lower, parameters.upper), problem.start)
    unit = _scale(problem, initial, angles)
    program = _stated(problem, initial, unit, np.where(layout.moving, angles, layout.reading),
                      np.where(layout.moving, ANGLE_STEP, problem.angle_sigma), _typical_gap(problem))
    free, others = np.flatnonzero(problem.free), np.full(len(program.angles), np.inf)
    lower, upper = (((bound - initial) / unit)[free] for bound in (parameters.lower, parameters.upper))
    zero = np.zeros(program.g.numel())
    answer = ipopt.solve_nlp({"x": program.x, "f": program.f, "g": program.g}, np.zeros(program.x.numel()),
                             np.append(lower, -others), np.append(upper, others), zero, zero,
                             f"calibration of {problem.model.machine.name}", ())
    theta, q = ca.Function("found", [program.x], [program.theta, program.q])(answer)
    return np.asarray(theta).ravel(), np.asarray(q).T


def nonlinear_program(problem: PoseEquations) -> NonlinearProgram:
    """The program that `maximum_likelihood` solves, with all variables in SI: parameters, then angles of the poses."""
    layout, parameters, model = problem.layout, problem.parameters, problem.model
    start = np.clip(problem.start, parameters.lower, parameters.upper)
    angles = np.where(layout.moving, guess_unsensed(problem, start), layout.reading)
    free = np.flatnonzero(problem.free)
    program = _stated(problem, np.where(problem.free, 0.0, problem.start), np.ones(len(parameters)),
                      np.where(layout.moving | (layout.sensed & (problem.angle_sigma > 0)), 0.0, angles),
                      np.ones(angles.shape), 1.0)
    poses, joints = np.divmod(program.angles, angles.shape[1])
    units = model.machine.channel_units
    gaps, others = len(program.strict), np.full(len(program.angles), np.inf)
    return NonlinearProgram(
        x=program.x, f=program.f, g=program.g, p=ca.MX.sym("p", 0),
        x_names=(*(parameters.names[k] for k in free),
                 *(f"pose {pose + 1}: {model.joints[k]}.q" for pose, k in zip(poses, joints, strict=True))),
        x_units=(*(parameters.units[k] for k in free), *(units[f"{model.joints[k]}.q"] for k in joints)),
        x0=np.append(start[free], angles.ravel()[program.angles]),
        lbx=np.append(parameters.lower[free], -others), ubx=np.append(parameters.upper[free], others),
        g_names=tuple(f"pose {k // layout.present.shape[1] + 1}: loop closure" for k in program.strict),
        g_units=("m",) * gaps, lbg=np.zeros(gaps), ubg=np.zeros(gaps), objective=tuple(problem.objective))


class _Stated(NamedTuple):
    """Half the squares f, the gaps g that must vanish, all parameters (P,) and joints (n, N) as expressions in x.

    x has the free parameters, then the angles at the flat positions `angles` in (N, n): those that are read with
    errors, and those that move unsensed. `strict` are the flat positions in (N, m) of the rows g.
    """

    x: ca.MX
    f: ca.MX
    g: ca.MX
    theta: ca.MX
    q: ca.MX
    angles: NDArray[np.intp]
    strict: NDArray[np.intp]


def _stated(problem: PoseEquations, theta: Array, theta_unit: Array, angles: Array, angle_unit: Array,
            gap_unit: float) -> _Stated:
    """The program with parameters and angles at x = 0, their units, and that of the gaps [m]."""
    layout, model = problem.layout, problem.model
    (count, n), m = layout.reading.shape, layout.present.shape[1]
    free, read = np.flatnonzero(problem.free), layout.sensed & (problem.angle_sigma > 0)
    own = np.concatenate([np.flatnonzero(read.ravel()), np.flatnonzero(layout.moving.ravel())])
    k, x = len(free), ca.MX.sym("x", len(free) + len(own))
    numbers = ca.DM(theta) + _matrix(free, np.arange(k), theta_unit[free], len(theta), k) @ x[:k]
    where, which, factor = layout.locked
    held = np.flatnonzero(layout.place.ravel() >= 0)
    q = ca.reshape(
        ca.DM(angles.ravel()) + _matrix(where, which, factor, count * n, len(theta)) @ numbers
        + _matrix(own, np.arange(len(own)), angle_unit.ravel()[own], count * n, len(own)) @ x[k:], n, count)
    place = ca.reshape(ca.DM(layout.given.ravel()) + _matrix(
        held, layout.place.ravel()[held], np.ones(len(held)), layout.place.size, len(theta)) @ numbers, -1, count)
    g_, q_, place_, target = (ca.SX.sym("v", k) for k in (len(model.parameters), n, place.shape[0], m))
    weights, reading, expected = ca.SX.sym("weights", n + m), ca.SX.sym("reading", n), ca.SX.sym("expected")
    rows = model.observed(g_, q_, place_) - target
    square = ca.sumsqr(ca.vertcat(q_ - reading, rows) * weights)
    pose = ca.Function("pose", [g_, q_, place_, target, weights, reading, expected], [
        rows, robust_loss(square, problem.loss, expected) / 2]).map(count)
    weighed = layout.present & (problem.row_sigma > 0)
    weight = np.hstack([_inverse(np.broadcast_to(problem.angle_sigma, (count, n)), read),
                        _inverse(problem.row_sigma, weighed)])
    left, cost = pose(ca.repmat(numbers[: len(model.parameters)], 1, count), q, place, layout.target.T, weight.T,
                      layout.reading.T, layout.expected[None, :])
    shared = ca.sumsqr(ca.DM(problem.known) * (numbers - ca.DM(problem.parameters.nominal)))
    for ends, length, spread in zip(problem.distances.ends, problem.distances.length, problem.distances.sigma,
                                    strict=True):
        apart = numbers[ends[0].tolist()] - numbers[ends[1].tolist()]
        shared += ((ca.norm_2(apart) - length) / spread) ** 2
    strict = np.flatnonzero((layout.present & (problem.row_sigma == 0)).ravel())
    return _Stated(x, ca.sum2(cost) + shared / 2, ca.vec(left)[strict.tolist()] / gap_unit, numbers, q, own, strict)


def _scale(problem: PoseEquations, theta: Array, angles: Array) -> Array:
    """Units (P,) of the parameters in which the cost is not too steep.

    With 1 m beside a reading's 1 mm, rounding errors alone would be larger than the gradient that IPOPT accepts.
    """
    weighed = problem.layout.present & (problem.row_sigma > 0)
    slope = problem.rows(theta, problem.angles(theta, angles))[1] * _inverse(problem.row_sigma, weighed)[:, :, None]
    steep = np.sum(slope**2, axis=(0, 1))
    return np.asarray(1 / np.sqrt(1 / problem.parameters.scale**2 + steep / STEEPEST))


def _typical_gap(problem: PoseEquations) -> float:
    """How far the tip is off [m] by the errors of the angles: the unit in which loops are closed."""
    reach = sum(abs(link.joint.a) + abs(link.joint.d) for link in problem.model.links) + 0.1
    return float(max(np.max(problem.angle_sigma, initial=0.0), 1e-6) * reach)


def _inverse(sigma: Array, where: NDArray[np.bool_]) -> Array:
    return np.where(where, 1 / np.where(where, sigma, 1.0), 0.0)


def _matrix(row: Any, column: Any, value: Array, rows: int, columns: int) -> ca.DM:
    """A sparse matrix by its triplets."""
    if not len(row):
        return ca.DM(rows, columns)
    return ca.DM.triplet(np.asarray(row).tolist(), np.asarray(column).tolist(), ca.DM(np.asarray(value)), rows, columns)
