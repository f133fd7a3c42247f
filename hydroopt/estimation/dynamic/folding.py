"""Rows of a regressor folded into small triangles: of each actuator, and of bands of rows."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from hydroopt.estimation.dynamic.column_basis import ColumnBasis
from hydroopt.spatial.inertia import Array

ROWS = 1024
"""Samples whose rows are computed together."""
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

    def __len__(self) -> int:
        return len(self._rows)

    @property
    def empty(self) -> bool:
        """Whether nothing was folded."""
        return not any(map(len, self._rows))

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

    def add(self, blocks: Sequence[Array] | Triangles) -> None:
        """Add rows (·, k) of each band."""
        some = [blocks[band] for band in range(len(blocks))]
        self.fold(np.concatenate(some), np.cumsum([0, *map(len, some)]))

    def copy(self) -> Triangles:
        """The same, to which others can be added."""
        made = Triangles(0, self.columns)
        made._rows = self._rows.copy()
        return made


class ActuatorTriangles:
    """Triangles T_i with ``‖T_i·[ψ; −1]‖² = Σ (K_i·ψ − f_i)²`` over the rows of actuator i.

    `folded` are rows with the same sums of squares, in those columns of [K_i, f_i] that the `bases` keep; `samples`
    (n,) counts the rows, `forces` (n,) adds up f_i.
    """

    def __init__(self, bases: Sequence[ColumnBasis], parameters: int) -> None:
        n = len(bases)
        self.bases = bases
        self.folded = [Triangles(1, len(basis.kept) + 1) for basis in bases]
        self.samples = np.zeros(n)
        self.parameters, self.forces = parameters, np.zeros(n)

    @classmethod
    def of_rows(cls, bases: Sequence[ColumnBasis], parameters: int, rows: Sequence[Array], samples: Array,
                forces: Array) -> ActuatorTriangles:
        """Those of rows (m, ·) in the columns of [K, f] that bases keep, with `samples` (n,) and `forces` (n,)."""
        made = cls(bases, parameters)
        for folded, block in zip(made.folded, rows, strict=True):
            folded.add([block])
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
        self.folded[actuator].fold(rows[places], [0, len(places)])
        self.samples[actuator] += len(places)
        self.forces[actuator] += np.sum(rows[places, -1])

    def add(self, other: ActuatorTriangles) -> None:
        """Add the triangles of another with the same bases."""
        for one, more in zip(self.folded, other.folded, strict=True):
            one.add(more)
        self.samples += other.samples
        self.forces += other.forces

    @property
    def full(self) -> Array:
        """Triangles (n, p+1, p+1) of all columns."""
        p = self.parameters
        out = np.zeros((len(self.bases), p + 1, p + 1))
        for each, basis, folded in zip(out, self.bases, self.folded, strict=True):
            rows = triangle(folded[0] @ basis.expander)
            each[np.ix_(basis.columns[: len(rows)], basis.columns)] = rows
        return out


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
