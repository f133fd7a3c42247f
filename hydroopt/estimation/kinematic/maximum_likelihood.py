"""Maximum likelihood over all poses, stages and parameters, with the angles of every pose eliminated.

Unknowns are the parameters and every pose's own angles: those sensed, as errors in units of their σ, and those moving
without a sensor. Loops close as constraints. With Gaussian errors this is maximum likelihood (maximum a posteriori with
priors). Around parameters θ and joint vectors q the whitened rows of a pose are w + J·δθ: errors of its sensed angles
count in their covariance, and what unsensed angles change is projected out (`linearise`). A step's equations have the
size of θ, whatever the number of poses, and the angles follow from the step.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import SolverError
from hydroopt.estimation.inference.gauss_newton import Step, bounded_step, minimise
from hydroopt.estimation.inference.identifiability import INFORMATION_TOLERANCE
from hydroopt.estimation.inference.program import NonlinearProgram
from hydroopt.estimation.kinematic.initial_guesses import guess_unsensed
from hydroopt.estimation.kinematic.observability import ROUNDING, Linearised, linearise
from hydroopt.estimation.kinematic.pose_equations import PoseEquations, robust_loss
from hydroopt.spatial.inertia import Array

CONVERGED, NEAR, STEPS = 1e-6, 1e-3, 500
"""Length of a step, in standard deviations of what the rows determine, that is the last one, and of one that may stay
where rounding keeps steps from it; greatest number of steps: along a combination that poses hardly tell they are short.
"""
ANGLE_STEP = 0.01
"""Scale [rad, m] of the angles that move unsensed."""
CORRECTIONS, SETTLED = 10, 1e-5
"""Steps of the angles alone at the parameters of a place, until they move by less than this part of their standard
deviations, or of `ANGLE_STEP`."""


def maximum_likelihood(problem: PoseEquations, start: Array, angles: Array) -> tuple[Array, Array]:
    """Most probable parameters (P,) and the joint vectors (N, n) [rad, m] of all poses.

    Args:
        problem: what to solve.
        start: (P,) initial parameters; they are moved into the bounds.
        angles: (N, n) initial angles of the joints that move unsensed.

    Raises:
        ProblemError: the errors of the loops are not stated.
        SolverError: the steps do not converge.
    """
    inside = np.where(problem.free, np.clip(start, problem.parameters.lower, problem.parameters.upper), problem.start)
    own = np.where(problem.layout.moving, angles, problem.layout.reading)
    found = minimise(_Place.at(problem, inside, own), tolerance=CONVERGED, steps=STEPS)
    if not found.converged and found.last.length > NEAR:
        raise SolverError("the steps towards the most probable geometry do not converge",
                          where=f"calibration of {problem.model.machine.name}",
                          remedy="correct readings and numbers of the machine file that are far off")
    last = found.place.after(found.last.change)
    return last.theta, last.q


@dataclass(frozen=True, eq=False)
class _Place:
    """Parameters (P,), joint vectors (N, n), and the linearised rows of the poses there."""

    problem: PoseEquations
    theta: Array
    q: Array
    rows: Linearised
    exact: bool = False

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
        size = np.linalg.norm(stacked[:, :-1] * parameters.scale, axis=0)
        stacked[:, :-1][:, size < ROUNDING * np.max(size, initial=0.0)] = 0.0
        lower, upper = (np.where(free, bound - self.theta, 0.0) for bound in (parameters.lower, parameters.upper))
        return bounded_step(stacked, damping, lower, upper, truncation=float(np.sqrt(INFORMATION_TOLERANCE)))

    def _moved(self, change: Array) -> _Place:
        return _Place.at(self.problem, self.theta + change, self.rows.followed(self.problem, self.q, change))

    def after(self, change: Array) -> _Place:
        there = self._moved(change)
        return there if there.cost <= self.cost else there.corrected()

    def corrected(self) -> _Place:
        layout, place, still = self.problem.layout, self, np.zeros(len(self.theta))
        unit = np.where(layout.moving, ANGLE_STEP, np.where(layout.sensed, self.problem.angle_sigma, 0.0))
        for _ in range(0 if self.exact else CORRECTIONS):
            before, place = place.q, place._moved(still)
            if np.all(np.abs(place.q - before) <= SETTLED * unit):
                break
        return self if self.exact else replace(place, exact=True)


def nonlinear_program(problem: PoseEquations) -> NonlinearProgram:
    """The program that `maximum_likelihood` solves, with all variables in SI: parameters, then angles of the poses."""
    layout, parameters, model = problem.layout, problem.parameters, problem.model
    (count, n), m, g = layout.reading.shape, layout.present.shape[1], len(model.parameters)
    start = np.clip(problem.start, parameters.lower, parameters.upper)
    angles = np.where(layout.moving, guess_unsensed(problem, start), layout.reading)
    free, read = np.flatnonzero(problem.free), layout.sensed & (problem.angle_sigma > 0)
    own = np.concatenate([np.flatnonzero(read.ravel()), np.flatnonzero(layout.moving.ravel())])
    x = ca.MX.sym("x", len(free) + len(own))
    theta, q = ca.MX(ca.DM(problem.start)), ca.MX(ca.DM(angles.ravel()))
    theta[free.tolist()], q[own.tolist()] = x[: len(free)], x[len(free) :]
    q += _matrix(*layout.locked, count * n, len(parameters)) @ theta
    held = np.flatnonzero(layout.place.ravel() >= 0)
    place = ca.DM(layout.given.ravel()) + _matrix(
        held, layout.place.ravel()[held], np.ones(len(held)), layout.place.size, len(parameters)) @ theta
    symbols = [ca.SX.sym("v", size) for size in (g, n, layout.place.shape[1], m, n, n + m, 1)]
    rows = model.observed(*symbols[:3]) - symbols[3]
    square = ca.sumsqr(ca.vertcat(symbols[1] - symbols[4], rows) * symbols[5])
    pose = ca.Function("pose", symbols, [rows, robust_loss(square, problem.loss, symbols[6]) / 2]).map(count)
    weight = np.hstack([_inverse(np.broadcast_to(problem.angle_sigma, (count, n)), read),
                        _inverse(problem.row_sigma, layout.present & (problem.row_sigma > 0))])
    left, cost = pose(ca.repmat(theta[:g], 1, count), ca.reshape(q, n, count), ca.reshape(place, -1, count),
                      layout.target.T, layout.reading.T, weight.T, layout.expected[None, :])
    shared = ca.sumsqr(ca.DM(problem.known) * (theta - ca.DM(parameters.nominal)))
    for ends, length, spread in zip(problem.distances.ends, problem.distances.length, problem.distances.sigma,
                                    strict=True):
        shared += ((ca.norm_2(theta[ends[0].tolist()] - theta[ends[1].tolist()]) - length) / spread) ** 2
    strict = np.flatnonzero((layout.present & (problem.row_sigma == 0)).ravel())
    poses, joints = np.divmod(own, n)
    units, others, closed = model.machine.channel_units, np.full(len(own), np.inf), np.zeros(len(strict))
    return NonlinearProgram(
        x=x, f=ca.sum2(cost) + shared / 2, g=ca.vec(left)[strict.tolist()], p=ca.MX.sym("p", 0),
        x_names=(*(parameters.names[k] for k in free),
                 *(f"pose {pose + 1}: {model.joints[k]}.q" for pose, k in zip(poses, joints, strict=True))),
        x_units=(*(parameters.units[k] for k in free), *(units[f"{model.joints[k]}.q"] for k in joints)),
        x0=np.append(start[free], angles.ravel()[own]),
        lbx=np.append(parameters.lower[free], -others), ubx=np.append(parameters.upper[free], others),
        g_names=tuple(f"pose {k // m + 1}: loop closure" for k in strict), g_units=("m",) * len(strict), lbg=closed,
        ubg=closed, objective=tuple(problem.objective))


def _inverse(sigma: Array, where: NDArray[np.bool_]) -> Array:
    return np.where(where, 1 / np.where(where, sigma, 1.0), 0.0)


def _matrix(row: Any, column: Any, value: Array, rows: int, columns: int) -> ca.DM:
    """A sparse matrix by its triplets."""
    if not len(row):
        return ca.DM(rows, columns)
    return ca.DM.triplet(np.asarray(row).tolist(), np.asarray(column).tolist(), ca.DM(np.asarray(value)), rows, columns)
