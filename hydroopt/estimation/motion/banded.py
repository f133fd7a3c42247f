"""Least squares whose unknowns meet only their neighbours, but for a few that meet all: banded with a border."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve_banded, cholesky_banded, lapack
from scipy.sparse import csr_array

from hydroopt.logs.spline import windowed
from hydroopt.spatial.inertia import Array


class Rows(NamedTuple):
    """Residuals ``left − by_path·δx − by_common·δy`` of m readings in each of N samples, with errors of size one.

    `left` (N, m); `by_path` (N, m, w) by w neighbouring unknowns from the `first` (N,) on; `by_common` (N, m, p).
    """

    left: Array
    by_path: Array
    by_common: Array
    first: NDArray[np.intp]

    @classmethod
    def of_path(cls, left: Array, by_path: Array, common: int, first: NDArray[np.intp]) -> Rows:
        """Those that p `common` unknowns do not change."""
        return cls(left, by_path, np.zeros((*left.shape, common)), first)

    def matrices(self, size: int) -> tuple[csr_array, Array, Array]:
        """By k unknowns x (N·m, k) and by y (N·m, p), and residuals (N·m,)."""
        samples, m, width = self.by_path.shape
        by_path = windowed(self.by_path.reshape(-1, width), np.repeat(self.first, m), size)
        return by_path, self.by_common.reshape(samples * m, -1), self.left.ravel()


@dataclass(frozen=True, eq=False)
class Bordered:
    """``[A B; Bᵀ C]·[x; y] = [a; b]``: A (k, k) in lower band storage (w, k), B (k, p), C (p, p).

    `squares` is the sum of squared residuals at x = 0, y = 0.

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
    squares: float = 0.0

    @classmethod
    def of(cls, blocks: Iterable[Rows], size: int, width: int, common: int) -> Bordered:
        """The normal equations of rows, in `size` unknowns of which `width` neighbours meet, and `common` ones."""
        return cls(np.zeros((width, size)), np.zeros((size, common)), np.zeros((common, common)), np.zeros(size),
                   np.zeros(common)).plus(blocks)

    def plus(self, blocks: Iterable[Rows]) -> Bordered:
        """With more rows."""
        band, border, corner, right, right_corner, squares = (
            self.band.copy(), self.border, self.corner, self.right, self.right_corner, self.squares)
        size = len(right)
        for rows in blocks:
            by_path, by_common, left = rows.matrices(size)
            product = by_path.T @ by_path
            for below, diagonal in enumerate(band[: rows.by_path.shape[2]]):
                diagonal[: size - below] += product.diagonal(-below)
            border, corner = border + by_path.T @ by_common, corner + by_common.T @ by_common
            right, right_corner = right + by_path.T @ left, right_corner + by_common.T @ left
            squares += float(left @ left)
        return replace(self, band=band, border=border, corner=corner, right=right, right_corner=right_corner,
                       squares=squares)

    @cached_property
    def _factor(self) -> Array:
        return cholesky_banded(self.band, lower=True)

    def half(self, right: Array) -> Array:
        """L⁻¹·b (k, c) of right sides b, with A = L·Lᵀ: inner products of these are bᵀ·A⁻¹·b."""
        return np.asarray(lapack.dtbtrs(self._factor, right, uplo="L")[0])

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

    def projected(self, rows: Rows) -> Array:
        """Rows (N·m, p+1) of y and the right side, in which x is the most probable one for every y.

        Their sum of squares is that of `reduced`, without the rounding of a product.
        """
        by_border, by_right = self._solved
        by_path, by_common, left = rows.matrices(len(self.right))
        return np.column_stack([by_common - by_path @ by_border, left - by_path @ by_right])

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
