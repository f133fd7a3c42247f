"""Maximum likelihood over all poses by steps on the parameters alone, every pose's own angles eliminated.

Around parameters θ and joint vectors q the whitened rows of a pose are w + J·δθ: errors of its sensed angles count in
their covariance, and what unsensed angles change is projected out (`linearise`). The equations of a step have the size
of θ, whatever the number of poses, and the angles follow from the step. Where the step vanishes, the conditions of
optimality of the program in `joint` are fulfilled, which has all unknowns side by side.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hydroopt.estimation.inference.identifiability import ROUNDING_TOLERANCE, significant
from hydroopt.estimation.kinematic import joint
from hydroopt.estimation.kinematic.observability import Linearised, linearise
from hydroopt.estimation.kinematic.pose_equations import PoseEquations
from hydroopt.estimation.kinematic.robust_loss import costs_and_weights
from hydroopt.spatial.inertia import Array

MOST = 100
"""Steps, the refused ones included."""
CONVERGED, SETTLED = 1e-6, 1e-5
"""Length of a step, in standard deviations of what the rows determine, that ends the search, and that of the angles'
step, in their standard deviations or units of `joint.ANGLE_STEP`."""
ROUNDING = 1e-12
"""Part of the cost that is rounding only."""
FARTHEST = 0.2
"""Largest change [rad, m] of an unsensed angle in one step."""
CORRECTIONS = 3
"""Steps of the angles alone, at the parameters of a trial, before it counts as refused."""
LEAST, LARGEST = 1e-6, 1e6
"""First damping after a refused step, relative to the curvature, and the one from which on there is no descent."""


class _Point(NamedTuple):
    """Parameters (P,), joint vectors (N, n), their linearised rows, the poses' weights (N,) and the cost."""

    theta: Array
    q: Array
    rows: Linearised
    weight: Array
    cost: float


def maximum_likelihood(problem: PoseEquations, start: Array, angles: Array) -> tuple[Array, Array]:
    """Most probable parameters (P,) and the joint vectors (N, n) [rad, m] of all poses.

    Poses whose steps do not converge are left to IPOPT.

    Args:
        problem: what to solve.
        start: (P,) initial parameters.
        angles: (N, n) initial angles of the joints that move unsensed.

    Raises:
        ProblemError: the errors of the loops are not stated.
        SolverError: IPOPT failed as well.
    """
    search = _Search(problem)
    at = search.start(start, angles)
    damping = 0.0
    for _ in range(MOST):
        step, length = search.step(at, damping)
        allowed = at.cost + ROUNDING * at.cost + CONVERGED**2
        trial = search.moved(at, step, allowed)
        if trial.cost <= allowed:
            if length < CONVERGED and search.settled(at, trial):
                return trial.theta, trial.q
            at, damping = trial, damping / 10 if damping > LEAST else 0.0
        else:
            damping = max(10 * damping, LEAST)
            if damping > LARGEST:
                break
    return joint.maximum_likelihood(problem, start, angles)


class _Search:
    """Linearised poses and steps of one problem."""

    def __init__(self, problem: PoseEquations) -> None:
        layout, self.problem = problem.layout, problem
        self.free = np.flatnonzero(problem.free)
        self.sigma = np.where(layout.sensed, problem.angle_sigma, 0.0)
        self.expected = np.maximum(layout.present.sum(axis=1), 1)

    def start(self, theta: Array, angles: Array) -> _Point:
        """The initial guess, moved into the bounds."""
        problem, layout = self.problem, self.problem.layout
        inside = np.clip(theta, problem.parameters.lower, problem.parameters.upper)
        return self.point(np.where(problem.free, inside, problem.start),
                          np.where(layout.moving, angles, layout.reading))

    def point(self, theta: Array, own: Array) -> _Point:
        """The poses around parameters and angles."""
        q = self.problem.angles(theta, own)
        rows = linearise(self.problem, theta, q)
        square, loss = rows.pose_square, self.problem.loss
        costs, weight = (square, np.ones(len(square))) if loss == "squares" else costs_and_weights(
            square, loss, self.expected)
        return _Point(theta, q, rows, weight, float(np.sum(costs) + np.sum(rows.shared_residual**2)))

    def step(self, at: _Point, damping: float) -> tuple[Array, float]:
        """Change (P,) of the parameters within their bounds, and its length in standard deviations."""
        free, parameters, rows = self.free, self.problem.parameters, at.rows
        change, root = np.zeros(len(parameters)), np.sqrt(at.weight)[:, None]
        jacobian = (rows.jacobian[:, :, free] * root[:, :, None]).reshape(rows.residual.size, len(free))
        shared = rows.shared[:, free]
        gradient = jacobian.T @ (rows.residual * root).ravel() + shared.T @ rows.shared_residual
        information = jacobian.T @ jacobian + shared.T @ shared
        size = np.sqrt(np.diag(information))
        size = np.where(size > 0, size, 1.0)
        values, vectors = np.linalg.eigh(information / np.outer(size, size))
        kept = significant(values, ROUNDING_TOLERANCE)
        values, vectors = values[kept], vectors[:, kept]
        curved = np.sqrt(values + damping)
        toward = vectors.T @ (gradient / size) / curved
        own = -(vectors @ (toward / curved)) / size
        lower, upper = (parameters.lower - at.theta)[free], (parameters.upper - at.theta)[free]
        if np.any((own < lower) | (own > upper)):
            from scipy.optimize import lsq_linear  # noqa: PLC0415 — it takes longer to load than most calibrations

            own = np.clip(lsq_linear((curved[:, None] * vectors.T) * size, -toward, (lower, upper), "bvls").x,
                          lower, upper)
        change[free] = own
        return change, float(np.linalg.norm(np.sqrt(values) * (vectors.T @ (size * own))))

    def moved(self, at: _Point, step: Array, allowed: float) -> _Point:
        """The point after a step, with angles that follow it; they are corrected while the cost is not allowed."""
        trial = self.point(at.theta + step, self.followed(at, step))
        for _ in range(CORRECTIONS):
            if trial.cost <= allowed:
                break
            trial = self.point(trial.theta, self.followed(trial, np.zeros(len(step))))
        return trial

    def followed(self, at: _Point, step: Array) -> Array:
        """Joint vectors (N, n) that are most probable in the linearised poses after a step of the parameters."""
        layout, rows = self.problem.layout, at.rows
        error = rows.residual + rows.jacobian @ step
        own: Array = layout.reading - self.sigma**2 * np.einsum("nuj,nu->nj", rows.by_angles, error)
        if rows.unsensed is None:
            return own
        unsensed = rows.unsensed[:, :, 0] + rows.unsensed[:, :, 1:] @ step
        moving = layout.moving
        which = np.flatnonzero(moving.any(axis=0))
        change = np.zeros(moving.shape)
        change[:, which] = np.clip(-unsensed, -FARTHEST, FARTHEST)
        return np.where(moving, at.q + change, own)

    def settled(self, before: _Point, after: _Point) -> bool:
        """Whether the angles hardly moved."""
        unit = np.where(self.problem.layout.moving, joint.ANGLE_STEP, self.sigma)
        return bool(np.all(np.abs(after.q - before.q)[unit > 0] < SETTLED * unit[unit > 0]))
