"""Rows of a regressor folded into one small triangle for each actuator, by QR of blocks that fit into the cache."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray

from hydroopt import lapack
from hydroopt.estimation.dynamic.column_basis import ColumnBasis
from hydroopt.spatial.inertia import Array

ROWS, SLACK, PANEL = 1024, 512, 8
"""Rows of a block, those that wait for a QR, and columns that LAPACK's recursive QR takes at a time: three times as
fast as its plain QR."""


class ActuatorTriangles:
    """Triangles T_i with ``‖T_i·[ψ; −1]‖² = Σ (K_i·ψ − f_i)²`` over the rows of actuator i.

    `compact` are rows with the same sums of squares, in those columns of [K_i, f_i] that the `bases` keep; `samples`
    (n,) counts the rows, `sums` (n, p+1) adds them up.
    """

    def __init__(self, bases: Sequence[ColumnBasis], parameters: int) -> None:
        n = len(bases)
        self.bases = bases
        self.compact = [np.zeros((0, len(basis.kept) + 1)) for basis in bases]
        self.samples = np.zeros(n)
        self.sums = np.zeros((n, parameters + 1))

    @classmethod
    def of_rows(cls, bases: Sequence[ColumnBasis], rows: Sequence[Array], samples: Array,
                sums: Array) -> ActuatorTriangles:
        """Those of rows (m, ·) in the columns of [K, f] that bases keep, with `samples` (n,) and `sums` (n, p+1)."""
        made = cls(bases, sums.shape[1] - 1)
        made.compact = [compact(block) for block in rows]
        made.samples, made.sums = samples, sums
        return made

    def fold(self, K: Array, force: Array, used: NDArray[np.bool_]) -> None:
        """Add rows K (N, n, p) with forces (N, n) where they are `used` (N, n)."""
        for i, basis in enumerate(self.bases):
            rows = np.flatnonzero(used[:, i])
            if not len(rows):
                continue
            self.fold_rows(i, basis.rows(K, force, i)[:, rows])

    def fold_rows(self, actuator: int, rows: Array) -> None:
        """Add rows (k+1, N) of [K, f] of an actuator in the columns that its basis keeps."""
        basis = self.bases[actuator]
        self.sums[actuator, basis.columns] += rows.sum(axis=1) @ basis.expander
        self.compact[actuator] = folded_rows(self.compact[actuator], rows.T)
        self.samples[actuator] += rows.shape[1]

    def add(self, other: ActuatorTriangles) -> None:
        """Add the triangles of another with the same bases."""
        self.compact = [folded_rows(one, more) for one, more in zip(self.compact, other.compact, strict=True)]
        self.samples += other.samples
        self.sums += other.sums

    def expanded(self) -> ActuatorTriangles:
        """The same in all columns of the actuators."""
        return ActuatorTriangles.of_rows([ColumnBasis.whole(basis.own) for basis in self.bases],
                                         [block @ basis.expander for basis, block in zip(self.bases, self.compact,
                                                                                         strict=True)],
                                         self.samples, self.sums)

    @property
    def full(self) -> Array:
        """Triangles (n, p+1, p+1) of all columns."""
        p = self.sums.shape[1] - 1
        out = np.zeros((len(self.bases), p + 1, p + 1))
        for each, basis, block in zip(out, self.bases, self.compact, strict=True):
            rows = triangle(block @ basis.expander)
            each[np.ix_(basis.columns[: len(rows)], basis.columns)] = rows
        return out

    def squares(self, v: Array) -> Array:
        """Sums (n,) of the squares of rows times v (p+1,)."""
        return np.array([np.sum((block @ (basis.expander @ v[basis.columns])) ** 2)
                         for block, basis in zip(self.compact, self.bases, strict=True)])


def folded_rows(rows: Array, more: Array, most: int = SLACK) -> Array:
    """Rows with the sums of squares of both blocks (·, k): these, or a triangle where they have more than `most`."""
    k = rows.shape[1]
    for start in range(0, len(more), ROWS):
        part = more[start : start + ROWS]
        block = _room(len(rows) + len(part), k)
        block[: len(rows)], block[len(rows) :] = rows, part
        rows = _blocked_triangle(block) if len(block) > max(k, most) else block.copy()
    return rows


class _Memory(threading.local):
    """Memory of a thread: fresh memory for each block costs as much as its copy."""

    block = np.empty(0)


_memory = _Memory()


def _room(rows: int, columns: int) -> Array:
    """A block (rows, columns) in Fortran's order, in the memory of the one before."""
    if _memory.block.size < rows * columns:
        _memory.block = np.empty(rows * columns)
    return _memory.block[: rows * columns].reshape((rows, columns), order="F")


def compact(rows: Array) -> Array:
    """At most as many rows as columns, with the same sums of squares."""
    return folded_rows(rows[:0], rows, 0)


def _blocked_triangle(block: Array) -> Array:
    """R of the QR of a block (m, k) in Fortran's order with m ≥ k, which is written over."""
    k = block.shape[1]
    factored, _, info = lapack.routines.dgeqrt(min(PANEL, k), block, overwrite_a=True)
    assert info == 0
    return np.where(_upper(k), factored[:k], 0.0)


@cache
def _upper(size: int) -> NDArray[np.bool_]:
    return np.triu(np.ones((size, size), dtype=bool))


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
