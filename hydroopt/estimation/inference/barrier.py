"""A Gaussian with about the mean and the covariance of a truncated one, by a barrier.

Constraints that cut off most of a Gaussian move its mean and leave a small part of its spread towards the edge. The
maximum of the density times a power of the distance from each edge lies inside, and the curvature there tells the
spread. For ``exp(−λ·s)`` cut off at s = 0, the power 1 gives mean and standard deviation exactly; for ``exp(−tr ΛW)``
over positive definite matrices W of size m, the power (m + 1)/2 of their determinant does: W is Wishart with m + 1
degrees of freedom. With the density ``exp(−tr ΛW)·det(W)^κ/2`` of a log-det distance W has κ more degrees of freedom,
and the same power is exact again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np

from hydroopt.estimation.inference.conditions import SYMMETRIC
from hydroopt.spatial.inertia import Array

POWER = 2.5
"""Of the determinants of 4-by-4 matrices; that of single inequalities is 1."""
STEPS, DECREMENT = 60, 1e-4
"""Newton steps at most, and the squared decrement at which they end: the place is exact to 1 % of its spread."""
SMALLEST_STEP = 1e-8
"""Part of a Newton step below which rounding errors decide."""

Slack = Callable[[Array], tuple[Array, Array]]


class Matrices(NamedTuple):
    """Matrices at z (k,): their upper triangles (b, 10), the slopes of these (b, 10, k), and the weights κ (b,) of
    their log-det distances.
    """

    upper: Array
    slopes: Array
    weights: Array

    @property
    def square(self) -> Array:
        """The matrices (b, 4, 4)."""
        return np.asarray((self.upper @ SYMMETRIC.T).reshape(-1, 4, 4))


class Interior(NamedTuple):
    """Coordinates y, of about unit spread and zero mean: ``z = centre + root·y`` with perpendicular columns of
    `root` (k, k).
    """

    centre: Array
    root: Array

    def places(self, y: Array) -> Array:
        """z (k, c) at coordinates y (k, c)."""
        return np.asarray(self.centre[:, None] + self.root @ y)

    def coordinates(self, z: Array) -> Array:
        """y (k, c) of places z (k, c)."""
        return np.asarray(self.root.T @ (z - self.centre[:, None]) / np.sum(self.root**2, axis=0)[:, None])

    def moved(self, origin: Array, width: Array) -> Interior:
        """In coordinates x with ``y = origin + width·x``."""
        return Interior(self.centre + self.root @ origin, self.root * width)

    @property
    def ratio(self) -> tuple[Array, Array]:
        """Coefficients (k,) of each coordinate's square and of itself in the logarithm of the density of z, standard
        normal, over that of y."""
        return 0.5 * (1 - np.sum(self.root**2, axis=0)), -(self.centre @ self.root)


def interior(starts: Iterable[Array], root: Array, right: Array, matrices: Callable[[Array], Matrices],
             single: Slack) -> Interior | None:
    """The Gaussian that stands in for ``exp(−½‖root·z − right‖²)``, times log-det distances, within inequalities; None
    without a start.

    Args:
        starts: points (k,) strictly inside, of which the first counts from which Newton's steps come to their end, or
            else the last.
        root: (m, k) and right (m,).
        matrices: those at z that must be positive definite.
        single: functions (m,) of z that must be positive, and their slopes (m, k).
    """
    def objective(z: Array) -> float:
        bodies, (slack, _), residual = matrices(z), single(z), root @ z - right
        values = np.linalg.eigvalsh(bodies.square)
        if np.any(values <= 0) or np.any(slack <= 0):
            return np.inf
        power = POWER + bodies.weights / 2
        return float(0.5 * residual @ residual + bodies.weights @ values.sum(axis=1) / 2
                     - power @ np.log(values).sum(axis=1) - np.sum(np.log(slack)))

    def derivatives(z: Array) -> tuple[Array, Array]:
        gradient, curvature = _derivatives(matrices(z), single(z))
        return gradient + root.T @ (root @ z - right), curvature + root.T @ root

    def ended(z: Array) -> tuple[Array, bool]:
        lowest = objective(z)
        for _ in range(STEPS):
            gradient, curvature = derivatives(z)
            try:
                step = -np.linalg.solve(curvature, gradient)
            except np.linalg.LinAlgError:  # where data and priors lie apart by more digits than numbers have
                break
            decrement, part = -float(gradient @ step), 1.0
            if decrement < DECREMENT:
                return z, True
            while (value := objective(z + part * step)) > lowest - 1e-4 * part * decrement and part > SMALLEST_STEP:
                part /= 2
            if part <= SMALLEST_STEP:
                break
            z, lowest = z + part * step, value
        return z, False

    z, done = None, False
    for start in starts:
        z, done = ended(start)
        if done:
            break
    if z is None:
        return None
    size, axes = np.linalg.eigh(derivatives(z)[1])
    # barriers only add to the Gaussian's curvature: what is below it is rounding beside a barrier that is almost met
    return Interior(z, axes / np.sqrt(np.maximum(size, np.linalg.svd(root, compute_uv=False)[-1] ** 2)))


def _derivatives(bodies: Matrices, single: tuple[Array, Array]) -> tuple[Array, Array]:
    """Gradient (k,) and curvature (k, k) of distances and barriers; functions that are not linear count as such."""
    inverse = np.linalg.inv(np.linalg.cholesky(bodies.square))
    onto = np.einsum("bij,bkl->bikjl", inverse, inverse).reshape(-1, 16, 16) @ SYMMETRIC  # L⁻¹·dW·L⁻ᵀ
    along = onto @ bodies.slopes
    trace, power = np.eye(4).ravel(), POWER + bodies.weights / 2
    relative = single[1] / single[0][:, None]
    gradient = bodies.weights / 2 @ (trace @ SYMMETRIC @ bodies.slopes) - power @ (trace @ along)
    rows = (np.sqrt(power)[:, None, None] * along).reshape(-1, along.shape[2])
    return gradient - relative.sum(axis=0), rows.T @ rows + relative.T @ relative
