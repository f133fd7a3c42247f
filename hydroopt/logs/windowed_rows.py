"""Rows of which only a window of neighbouring columns is not zero: splines at times in order."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydroopt.kernels import wide_windows, windows

Array = NDArray[np.float64]
FEWER = 8
"""Windows for each column of samples below which products are computed window by window, not column by column."""

COMPILED, MOST = 256, 16
"""Rows from which on, and columns of samples up to which, products are computed in C."""


@dataclass(frozen=True, eq=False)
class WindowedRows:
    """A matrix (N, m) whose row i holds `values` (N, w) from the column `first` (N,) on.

    >>> rows = WindowedRows(np.array([[1.0, 2.0], [3.0, 4.0]]), np.array([0, 1]), 3)
    >>> (rows @ np.array([1.0, 10.0, 100.0])).tolist(), rows.gathered(np.array([1.0, 10.0])).tolist()
    ([21.0, 430.0], [1.0, 32.0, 40.0])
    >>> rows.gram.tolist()
    [[1.0, 13.0, 16.0], [2.0, 12.0, 0.0]]
    """

    values: Array
    first: NDArray[Any]
    columns: int

    def __matmul__(self, coefficients: Array) -> Array:
        """Products (N, ...) with coefficients (m, ...)."""
        if (run := self._compiled(coefficients)) is not None:
            return run.product(coefficients.reshape(self.columns, -1)).reshape(-1, *coefficients.shape[1:])
        own = np.lib.stride_tricks.sliding_window_view(coefficients, self.values.shape[1], axis=0)
        return np.asarray(np.einsum("nw,n...w->n...", self.values, own[self.first]))

    def gathered(self, samples: Array) -> Array:
        """Products (m, ...) of the transpose with samples (N, ...), row by row in the order of their windows."""
        if (run := self._compiled(samples)) is not None:
            return run.gathered(samples.reshape(len(samples), -1)).reshape(-1, *samples.shape[1:])
        if samples.ndim == 2 and (found := wide_windows.gathered(self.values, self.first, self.columns,
                                                                 samples)) is not None:
            return found
        made = np.zeros((self.columns, *samples.shape[1:]))
        if samples.ndim > 1 and FEWER * made[0].size > len(self._starts):
            width, edges = self.values.shape[1], np.append(self._starts, len(samples)).tolist()
            flat, sums = (each.reshape(len(each), made[0].size) for each in (samples, made))
            turned = self.values.T
            for at, (start, end) in zip(self.first[self._starts].tolist(), pairwise(edges), strict=True):
                sums[at : at + width] += turned[:, start:end] @ flat[start:end]
            return made
        if samples.ndim > 1:
            for k in np.ndindex(samples.shape[1:]):
                made[:, *k] = self.gathered(samples[:, *k])
            return made
        sums = self._summed(self.values * samples[:, None])
        for offset, column in enumerate(sums.T):
            made[self.first[self._starts] + offset] += column  # no two windows begin at the same column
        return made

    def _compiled(self, given: Array) -> windows.Windows | None:
        """The same in C, where that pays for as many columns as are given."""
        return self._windows if len(self.values) >= COMPILED and given.size <= MOST * len(given) else None

    @cached_property
    def _windows(self) -> windows.Windows | None:
        return windows.compiled(self.values, self.first, self.columns)

    def _summed(self, products: Array) -> Array:
        """Sums (windows, k) over the rows of each window of (N, k)."""
        return np.add.reduceat(products, self._starts, axis=0) if len(self._starts) else products

    @cached_property
    def _starts(self) -> NDArray[np.intp]:
        """The first row of each window."""
        assert np.all(self.first[1:] >= self.first[:-1])
        return np.flatnonzero(np.diff(self.first, prepend=-1))

    @property
    def gram(self) -> Array:
        """The product (m, m) of the transpose with these rows, in lower band storage (w, m)."""
        if (run := self._compiled(self.values)) is not None:
            return run.gram()
        if (found := wide_windows.gram(self.values, self.first, self.columns)) is not None:
            return found
        width = self.values.shape[1]
        made, at = np.zeros((width, self.columns)), self.first[self._starts]
        turned = np.ascontiguousarray(self.values.T)
        for k in range(width):
            for below in range(width - k):
                made[below, at + k] += self._summed(turned[k] * turned[k + below])
        return made
