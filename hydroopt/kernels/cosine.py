"""Cosine transforms of blocks of samples in C, several rows at once."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
from numpy.typing import NDArray

from hydroopt import spectra
from hydroopt.kernels.shared_library import ADDRESS, COUNT, of_file, routine
from hydroopt.kernels.thread_memory import room
from hydroopt.spatial.inertia import Array

SIZE, LANES = 2**13, 8
"""SIZE of cosine.c, and as many rows are transformed side by side at most."""
WORK = LANES * (SIZE + 2**7) + SIZE
"""Numbers that cosine.c needs room for."""
WHAT = "cosine.c", "the cosine transform", "NumPy computes it, more slowly"


def cosine_transform(rows: Array, taken: NDArray[np.bool_] | None = None) -> Array:
    """Orthonormal cosine transform, type II, of rows (k, n) in place, of which samples that are not `taken` (n,) count
    as 0; in C of `SIZE` samples.

    >>> cosine_transform(np.ones((1, SIZE))).round(9)[0, :2].tolist()
    [90.509667992, 0.0]
    """
    run = _compiled() if rows.shape[1] == SIZE and rows.strides[1] == rows.itemsize else None
    if run is None:
        if taken is not None:
            rows[:, np.flatnonzero(~taken)] = 0.0
        return spectra.cosine_transform(rows)
    some = None if taken is None else np.ascontiguousarray(taken, dtype=bool)
    run(len(rows), rows.ctypes.data, rows.strides[0] // rows.itemsize, None if some is None else some.ctypes.data,
        _table().ctypes.data, room("transforms", WORK).ctypes.data)
    return rows


@cache
def _compiled() -> Callable[..., None] | None:
    library = of_file(*WHAT)
    return None if library is None else routine(library, "cosine", COUNT, ADDRESS, COUNT, *[ADDRESS] * 3)


@cache
def _table() -> Array:
    """Roots of 1 that all transforms share."""
    library = of_file(*WHAT)
    assert library is not None
    write = routine(library, "cosine_table", ADDRESS, result=COUNT)
    made = np.empty(write(None))
    write(made.ctypes.data)
    return made
