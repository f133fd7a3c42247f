"""Rows of a regressor folded into one small triangle for each actuator."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hydroopt.estimation.dynamic.column_basis import ColumnBasis
from hydroopt.kernels.triangle import triangle_of
from hydroopt.spatial.inertia import Array

ROWS, SLACK = 1024, 128
"""Rows of a block, and those that wait for a QR."""


class ActuatorTriangles:
    """Triangles T_i with ``‖T_i·[ψ; −1]‖² = Σ (K_i·ψ − f_i)²`` over the rows of actuator i.

    `compact` are rows with the same sums of squares, in those columns of [K_i, f_i] that the `bases` keep; `samples`
    (n,) counts the rows, `forces` (n,) adds up f_i.
    """

    def __init__(self, bases: Sequence[ColumnBasis], parameters: int) -> None:
        n = len(bases)
        self.bases = bases
        self.compact = [np.zeros((0, len(basis.kept) + 1)) for basis in bases]
        self.samples = np.zeros(n)
        self.parameters, self.forces = parameters, np.zeros(n)

    @classmethod
    def of_rows(cls, bases: Sequence[ColumnBasis], parameters: int, rows: Sequence[Array], samples: Array,
                forces: Array) -> ActuatorTriangles:
        """Those of rows (m, ·) in the columns of [K, f] that bases keep, with `samples` (n,) and `forces` (n,)."""
        made = cls(bases, parameters)
        made.compact = [compact(block) for block in rows]
        made.samples, made.forces = samples, forces
        return made

    def fold(self, K: Array, force: Array, used: NDArray[np.bool_]) -> None:
        """Add rows K (N, n, p) with forces (N, n) where they are `used` (N, n)."""
        for i, basis in enumerate(self.bases):
            rows = np.flatnonzero(used[:, i])
            if not len(rows):
                continue
            self.fold_rows(i, basis.rows(K, force, i).T, rows)

    def fold_rows(self, actuator: int, rows: Array, places: NDArray[np.intp]) -> None:
        """Add those at `places` of the rows (N, k+1) of [K, f] of an actuator in the columns that its basis keeps."""
        self.compact[actuator] = folded_rows(self.compact[actuator], rows, places=places)
        self.samples[actuator] += len(places)
        self.forces[actuator] += np.sum(rows[places, -1])

    def add(self, other: ActuatorTriangles) -> None:
        """Add the triangles of another with the same bases."""
        self.compact = [folded_rows(one, more) for one, more in zip(self.compact, other.compact, strict=True)]
        self.samples += other.samples
        self.forces += other.forces

    def expanded(self) -> ActuatorTriangles:
        """The same in all columns of the actuators."""
        return ActuatorTriangles.of_rows([ColumnBasis.whole(basis.own) for basis in self.bases], self.parameters,
                                         [block @ basis.expander for basis, block in zip(self.bases, self.compact,
                                                                                         strict=True)],
                                         self.samples, self.forces)

    @property
    def full(self) -> Array:
        """Triangles (n, p+1, p+1) of all columns."""
        p = self.parameters
        out = np.zeros((len(self.bases), p + 1, p + 1))
        for each, basis, block in zip(out, self.bases, self.compact, strict=True):
            rows = triangle(block @ basis.expander)
            each[np.ix_(basis.columns[: len(rows)], basis.columns)] = rows
        return out

    def squares(self, v: Array) -> Array:
        """Sums (n,) of the squares of rows times v (p+1,)."""
        return np.array([np.sum((block @ (basis.expander @ v[basis.columns])) ** 2)
                         for block, basis in zip(self.compact, self.bases, strict=True)])


def folded_rows(rows: Array, more: Array, most: int = SLACK, places: NDArray[np.intp] | None = None) -> Array:
    """Rows with the sums of squares of both blocks (·, k), or of `more` at `places` alone: these, or a triangle where
    they have more than `most`."""
    if len(rows) + len(more if places is None else places) <= max(rows.shape[1], most):
        return np.concatenate([rows, more if places is None else more[places]])
    return triangle_of(rows, more, places=places)


def compact(rows: Array) -> Array:
    """At most as many rows as columns, with the same sums of squares."""
    return folded_rows(rows[:0], rows, 0)


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
