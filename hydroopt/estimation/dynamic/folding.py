"""QR factors of rows that come one block after the other: small triangles, by bands of rows."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from hydroopt.spatial.inertia import Array

PANEL = 8
"""Columns that LAPACK reflects together: with as few, twice as fast as `numpy.linalg.qr` for a few dozen columns."""


class Triangles:
    """Rows (·, k) of several bands with the sums of squares of all that were folded: these, or a triangle (k, k) where
    they would be more than k.

    >>> folded = Triangles(2, 1)
    >>> folded.fold(np.array([[3.0], [4.0], [7.0]]), [0, 2, 3])
    >>> [abs(folded[0]).tolist(), folded[1].tolist()]  # the signs of rows are free
    [[[5.0]], [[7.0]]]
    """

    def __init__(self, bands: int, columns: int) -> None:
        self.columns = columns
        self._rows = [np.zeros((0, columns))] * bands

    def __getitem__(self, band: int) -> Array:
        """Rows (·, k) of a band."""
        return self._rows[band]

    def fold(self, rows: Array, edges: Sequence[int] | NDArray[np.intp]) -> None:
        """Add rows (N, k): those from one of the `edges` (bands + 1,) to the next one to each band."""
        for band, (first, end) in enumerate(pairwise(edges)):
            if end > first:
                held = len(self._rows[band])
                both = np.empty((held + end - first, self.columns), order="F")
                both[:held], both[held:] = self._rows[band], rows[first:end]
                self._rows[band] = both if len(both) <= self.columns else self._triangle(both)

    def _triangle(self, rows: Array) -> Array:
        reflected, *_ = lapack.dgeqrt(min(PANEL, self.columns), rows, overwrite_a=True)
        return np.triu(reflected[: self.columns])

    def add(self, blocks: Sequence[Array]) -> None:
        """Add rows (·, k) of each band."""
        self.fold(np.concatenate(blocks), np.cumsum([0, *map(len, blocks)]))


def triangle(*blocks: Array) -> Array:
    """R, upper triangular, of the blocks A (m, k) stacked: ``‖R·v‖ = ‖A·v‖`` for every v (k,).

    Blocks of zeros change no bit of it.

    >>> triangle(np.array([[3.0]]), np.array([[4.0]]))
    array([[-5.]])
    """
    return np.asarray(np.linalg.qr(np.vstack([block for block in blocks if np.any(block)] or blocks[:1]), mode="r"))


def split(R: Array) -> tuple[Array, Array, float]:
    """R (p, p), r (p,) and the rest of ``‖T·[ψ; −1]‖² = ‖R·ψ − r‖² + rest`` for a triangle T (·, p+1)."""
    p = R.shape[1] - 1
    return R[:p, :p], R[:p, p], float(np.sum(R[p:, p] ** 2))
