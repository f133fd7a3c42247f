"""Rows of a regressor folded into one small triangle for each actuator, by QR of blocks that fit into the cache."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from hydroopt.spatial.inertia import Array

ROWS, PANEL = 1024, 8
"""Rows of a block, and columns that LAPACK's recursive QR takes at a time: three times as fast as its plain QR."""


class ActuatorTriangles:
    """Triangles T_i with ``‖T_i·[ψ; −1]‖² = Σ (K_i·ψ − f_i)²`` over the rows of actuator i.

    `compact` are they in those `columns` that K_i has by the `pattern` (n, p) of K; `samples` (n,) counts the rows,
    `sums` (n, p+1) adds them up.
    """

    def __init__(self, pattern: NDArray[np.bool_]) -> None:
        n, p = pattern.shape
        self.columns = [np.append(np.flatnonzero(row), p) for row in pattern]
        self.compact = [np.zeros((len(columns), len(columns)), order="F") for columns in self.columns]
        self.samples = np.zeros(n)
        self.sums = np.zeros((n, p + 1))

    @classmethod
    def of_rows(cls, owners: Sequence[tuple[NDArray[np.intp], Array]], samples: Array,
                sums: Array) -> ActuatorTriangles:
        """Those of rows (m, ·) in some columns of [K, f] for each actuator, with `samples` (n,) and `sums` (n, p+1)."""
        made = object.__new__(cls)
        made.columns = [np.asarray(columns) for columns, _ in owners]
        made.compact = [_blocked_triangle(np.asfortranarray(np.vstack([np.zeros((len(columns),) * 2), rows])))
                        for columns, rows in owners]
        made.samples, made.sums = samples, sums
        return made

    def fold(self, K: Array, force: Array, used: NDArray[np.bool_]) -> None:
        """Add rows K (N, n, p) with forces (N, n) where they are `taken` (N, n)."""
        for i, columns in enumerate(self.columns):
            rows = np.flatnonzero(used[:, i])
            if not len(rows):
                continue
            size = len(columns)
            block = np.empty((size + len(rows), size), order="F")
            block[:size] = self.compact[i]
            block[size:, :-1] = K[rows, i][:, columns[:-1]]
            block[size:, -1] = force[rows, i]
            self.sums[i, columns] += block[size:].sum(axis=0)
            self.compact[i] = _blocked_triangle(block)
            self.samples[i] += len(rows)

    def add(self, other: ActuatorTriangles) -> None:
        """Add the triangles of another."""
        for i, block in enumerate(other.compact):
            self.compact[i] = _blocked_triangle(np.asfortranarray(np.vstack([self.compact[i], block])))
        self.samples += other.samples
        self.sums += other.sums

    def only(self, actuators: NDArray[np.bool_]) -> ActuatorTriangles:
        """The rows of some actuators (n,) only."""
        part = copy(self)
        part.compact = [block * here for block, here in zip(self.compact, actuators, strict=True)]
        part.samples, part.sums = self.samples * actuators, self.sums * actuators[:, None]
        return part

    @property
    def full(self) -> Array:
        """Triangles (n, p+1, p+1) of all columns."""
        out = np.zeros((len(self.columns), self.sums.shape[1], self.sums.shape[1]))
        for i, columns in enumerate(self.columns):
            out[i][np.ix_(columns, columns)] = self.compact[i]
        return out

    def squares(self, v: Array) -> Array:
        """Sums (n,) of the squares of rows times v (p+1,)."""
        return np.array([np.sum((block @ v[columns]) ** 2)
                         for block, columns in zip(self.compact, self.columns, strict=True)])


def _blocked_triangle(block: Array) -> Array:
    """R of the QR of a block (m, k) in Fortran's order with m ≥ k, which is written over."""
    k = block.shape[1]
    factored, _, info = lapack.dgeqrt(min(PANEL, k), block, overwrite_a=True)
    assert info == 0
    return np.asfortranarray(np.triu(factored[:k]))


def folded_rows(rows: Array, more: Array) -> Array:
    """At most as many rows as columns, with the sums of squares of both blocks (·, k): a triangle where there are more.
    """
    k = more.shape[1]
    for start in range(0, len(more), ROWS):
        rows = np.vstack([rows, more[start : start + ROWS]])
        if len(rows) > k:
            rows = _blocked_triangle(np.asfortranarray(rows))
    return rows


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
