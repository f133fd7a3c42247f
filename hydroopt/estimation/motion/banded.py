"""Normal equations whose unknowns meet only their neighbours, but for a few that meet all."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve_banded, cholesky_banded

from hydroopt.spatial.inertia import Array


@dataclass(frozen=True, eq=False)
class Bordered:
    """``[A B; Bᵀ C]·[x; y] = [a; b]``: A (k, k) in lower band storage (w, k), B (k, p), C (p, p).

    >>> made = Bordered(np.array([[2.0, 2.0], [1.0, 0.0]]), np.array([[1.0], [0.0]]), np.array([[3.0]]),
    ...                 np.array([1.0, 0.0]), np.array([1.0]))
    >>> schur, right = made.reduced
    >>> y = np.linalg.solve(schur, right)
    >>> made.inner(y).round(6).tolist(), y.round(6).tolist()
    ([0.571429, -0.285714], [0.142857])
    """

    band: Array
    border: Array
    corner: Array
    right: Array
    right_corner: Array

    @cached_property
    def _factor(self) -> Array:
        return cholesky_banded(self.band, lower=True)

    @cached_property
    def _solved(self) -> tuple[Array, Array]:
        """A⁻¹·B and A⁻¹·a."""
        found = cho_solve_banded((self._factor, True), np.column_stack([self.border, self.right]))
        return found[:, :-1], found[:, -1]

    @property
    def reduced(self) -> tuple[Array, Array]:
        """Matrix (p, p) and right side (p,) of what is left for y."""
        by_border, by_right = self._solved
        return self.corner - self.border.T @ by_border, self.right_corner - self.border.T @ by_right

    def inner(self, y: Array) -> Array:
        """x (k,) that goes with y (p,)."""
        by_border, by_right = self._solved
        return by_right - by_border @ y

    def inverse_band(self, covariance: Array) -> Array:
        """The band of the covariance of x (w, k), where y has the given covariance (p, p)."""
        found = inverse_band(self._factor)
        by_border = self._solved[0]
        for offset in range(len(found)):
            size = by_border.shape[0] - offset
            found[offset, :size] += np.einsum("kp,kp->k", by_border[offset:] @ covariance, by_border[:size])
        return found


def inverse_band(factor: Array) -> Array:
    """The band of the inverse of L·Lᵀ, L in lower band storage (w, k), by Takahashi's recursion."""
    width, size = factor.shape
    found = np.zeros_like(factor)
    window = np.zeros((width - 1, width - 1))  # the inverse's block that begins after the column
    for j in range(size - 1, -1, -1):
        below = factor[1:, j] / factor[0, j]
        column = -window @ below
        own = 1.0 / factor[0, j] ** 2 - below @ column
        found[0, j], found[1:, j] = own, column
        window[1:, 1:] = window[:-1, :-1].copy()
        window[0, 0], window[0, 1:], window[1:, 0] = own, column[:-1], column[:-1]
    for offset in range(1, width):
        found[offset, size - offset:] = 0.0
    return found


def add_blocks(band: Array, blocks: Array, first: NDArray[np.intp], size: int) -> None:
    """Add blocks (m, w, w) to a matrix in lower band storage, block k from the unknown `first`[k]·`size` on; no two
    blocks begin at the same one."""
    start = first * size
    for a in range(blocks.shape[1]):
        for b in range(a + 1):
            band[a - b, start + b] += blocks[:, a, b]
