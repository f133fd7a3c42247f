"""Rows folded into triangles by QR in C: one pass over them, in the first cache, without a copy of all."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from functools import cache
from itertools import accumulate, pairwise

import numpy as np
from numpy.typing import NDArray

from hydroopt.kernels.shared_library import ADDRESS, COUNT, of_file, routine
from hydroopt.kernels.thread_memory import room
from hydroopt.spatial.inertia import Array

PANEL, ROWS = 4, 376
"""Of triangle.c: columns reflected together, and rows at a time."""
TRIANGLE = -1
"""Number of waiting rows where they are a triangle."""
Edges = Sequence[int] | NDArray[np.intp]


class Triangles:
    """Rows (·, k) of several bands with the sums of squares of all that were folded: these, or a triangle (k, k) where
    they would be more than k.

    >>> folded = Triangles(2, 1)
    >>> folded.fold(np.array([[3.0], [4.0], [7.0]]), [0, 2, 3])
    >>> [abs(folded[0]).tolist(), folded[1].tolist()]  # the signs of rows are free
    [[[5.0]], [[7.0]]]
    """

    def __init__(self, bands: int, columns: int) -> None:
        self.columns, self._width = columns, -(-columns // PANEL) * PANEL
        self._rows = np.zeros((bands, self._width, self._width))
        self._waiting = np.zeros(bands, dtype=ctypes.c_long)

    def __len__(self) -> int:
        return len(self._rows)

    @property
    def empty(self) -> bool:
        """Whether nothing was folded."""
        return not np.any(self._waiting)

    def __getitem__(self, band: int) -> Array:
        """Rows (·, k) of a band."""
        waiting = int(self._waiting[band])
        return self._rows[band, : self.columns if waiting == TRIANGLE else waiting, : self.columns]

    def fold(self, rows: Array, edges: Edges, places: NDArray[np.intp] | None = None) -> None:
        """Add rows (N, k), or those at `places` (N,) alone: those from one of the `edges` (bands + 1,) to the next one
        to each band."""
        if (run := _compiled()) is None:
            self._fold(rows if places is None else rows[places], edges)
            return
        work = room("rows", self._width * ROWS)
        ends, some = (None if x is None else np.ascontiguousarray(x, dtype=ctypes.c_long) for x in (edges, places))
        assert ends is not None
        down, across = (step // rows.itemsize for step in rows.strides)
        run(self._width, self.columns, len(self), self._rows.ctypes.data, self._waiting.ctypes.data, ends.ctypes.data,
            None if some is None else some.ctypes.data, rows.ctypes.data, down, across, work.ctypes.data)

    def _fold(self, rows: Array, edges: Edges) -> None:
        for band, (first, end) in enumerate(pairwise(edges)):
            both, k = np.concatenate([self[band], rows[first:end]]), self.columns
            if end > first and len(both) > k:
                self._rows[band, :k, :k], self._waiting[band] = np.linalg.qr(both, mode="r"), TRIANGLE
            elif end > first:
                self._rows[band, : len(both), :k], self._waiting[band] = both, len(both)

    def add(self, blocks: Sequence[Array] | Triangles) -> None:
        """Add rows (·, k) of each band."""
        some = [blocks[band] for band in range(len(blocks))]
        self.fold(np.concatenate(some), [*accumulate(map(len, some), initial=0)])

    def copy(self) -> Triangles:
        """The same, to which others can be added."""
        made = Triangles(0, self.columns)
        made._rows, made._waiting = self._rows.copy(), self._waiting.copy()
        return made


@cache
def _compiled() -> Callable[..., None] | None:
    library = of_file("triangle.c", "the QR of many rows", "LAPACK computes it, more slowly")
    return None if library is None else routine(library, "triangles", *[COUNT] * 3, *[ADDRESS] * 5, COUNT, COUNT,
                                                ADDRESS)
