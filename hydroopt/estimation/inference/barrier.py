"""A Gaussian with about the mean and the covariance of a truncated one, by a barrier.

Constraints that cut off most of a Gaussian move its mean and leave a small part of its spread towards the edge. The
maximum of the density times a power of the distance from each edge lies inside, and the curvature there tells the
spread. For ``exp(−λ·s)`` cut off at s = 0, the power 1 gives mean and standard deviation exactly; for ``exp(−tr ΛW)``
over positive definite matrices W of size m, the power (m + 1)/2 of their determinant does: W is Wishart with m + 1
degrees of freedom.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from hydroopt.estimation.inference.conditions import square
from hydroopt.spatial.inertia import Array

POWER = 2.5
"""Of the determinants of 4-by-4 matrices; that of single inequalities is 1."""
STEPS, DECREMENT = 60, 1e-4
"""Newton steps at most, and the squared decrement at which they end: the place is exact to 1 % of its spread."""
SMALLEST_STEP = 1e-8
"""Part of a Newton step below which rounding errors decide."""
SYMMETRIC = np.array([square(entry).ravel() for entry in np.eye(10)]).T
"""(16, 10) the entries of a matrix of its upper triangle."""

Slack = Callable[[Array], tuple[Array, Array]]


class Interior(NamedTuple):
    """Coordinates y, of about unit spread and zero mean: ``z = centre + root·y`` with perpendicular columns of
    `root` (k, k).
    """

    centre: Array
    root: Array

    def log_ratio(self, y: Array) -> Array:
        """Logarithm (c,) of the density of z (k, c), standard normal, over that of y, up to a constant."""
        width = np.sum(self.root**2, axis=0)
        return np.asarray(0.5 * (1 - width) @ y**2 - (self.centre @ self.root) @ y)


def interior(start: Array, matrices: Slack, single: Slack) -> Interior:
    """The Gaussian that stands in for a standard normal one within inequalities.

    Args:
        start: (k,) a point strictly inside.
        matrices: upper triangles (b, 10) of the matrices at z that must be positive definite, and their slopes
            (b, 10, k).
        single: functions (m,) of z that must be positive, and their slopes (m, k).
    """
    def objective(z: Array) -> float:
        (upper, _), (slack, _) = matrices(z), single(z)
        values = np.linalg.eigvalsh((upper @ SYMMETRIC.T).reshape(-1, 4, 4))
        if np.any(values <= 0) or np.any(slack <= 0):
            return np.inf
        return float(0.5 * z @ z - POWER * np.sum(np.log(values)) - np.sum(np.log(slack)))

    z, lowest = start, objective(start)
    for _ in range(STEPS):
        gradient, curvature = _derivatives(z, matrices(z), single(z))
        step = -np.linalg.solve(curvature, gradient)
        decrement, part = -float(gradient @ step), 1.0
        if decrement < DECREMENT:
            break
        while (value := objective(z + part * step)) > lowest - 1e-4 * part * decrement and part > SMALLEST_STEP:
            part /= 2
        if part <= SMALLEST_STEP:
            break
        z, lowest = z + part * step, value
    size, axes = np.linalg.eigh(_derivatives(z, matrices(z), single(z))[1])
    return Interior(z, axes / np.sqrt(size))


def _derivatives(z: Array, matrices: tuple[Array, Array], single: tuple[Array, Array]) -> tuple[Array, Array]:
    """Gradient (k,) and curvature (k, k); functions that are not linear count as such."""
    upper, slopes = matrices
    inverse = np.linalg.inv(np.linalg.cholesky((upper @ SYMMETRIC.T).reshape(-1, 4, 4)))
    onto = np.einsum("bij,bkl->bikjl", inverse, inverse).reshape(-1, 16, 16) @ SYMMETRIC  # L⁻¹·dW·L⁻ᵀ
    along = (onto @ slopes).reshape(-1, len(z))
    traces = np.tile(np.eye(4).ravel(), len(upper)) @ along
    relative = single[1] / single[0][:, None]
    return (z - POWER * traces - relative.sum(axis=0),
            np.eye(len(z)) + POWER * along.T @ along + relative.T @ relative)
