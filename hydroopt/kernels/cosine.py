"""Cosine transforms of blocks of samples in C, several rows at once."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np

from hydroopt import spectra
from hydroopt.kernels.shared_library import ADDRESS, COUNT, of_file, routine
from hydroopt.spatial.inertia import Array

SIZE, LANES = 2**13, 8
"""SIZE of cosine.c, and as many rows are transformed side by side at most."""
WORK = LANES * (SIZE + 2**7) + SIZE
"""Numbers that cosine.c needs room for."""
WHAT = "cosine.c", "the cosine transform", "NumPy computes it, more slowly"


def cosine_transform(rows: Array) -> Array:
    """Orthonormal cosine transform, type II, of rows (k, n) in place; in C of `SIZE` samples.

    >>> cosine_transform(np.ones((1, SIZE))).round(9)[0, :2].tolist()
    [90.509667992, 0.0]
    """
    if rows.shape[-1] != SIZE or rows.ndim != 2 or rows.strides[1] != rows.itemsize:
        return spectra.cosine_transform(rows)
    run = _compiled()
    if run is None:
        return spectra.cosine_transform(rows)
    work = np.empty(WORK + LANES)
    work = work[-(work.ctypes.data // work.itemsize) % LANES :]  # from a cache line on
    run(len(rows), rows.ctypes.data, rows.strides[0] // rows.itemsize, _table().ctypes.data, work.ctypes.data)
    return rows


@cache
def _compiled() -> Callable[..., None] | None:
    library = of_file(*WHAT)
    return None if library is None else routine(library, "cosine", COUNT, ADDRESS, COUNT, ADDRESS, ADDRESS)


@cache
def _table() -> Array:
    """Roots of 1 that all transforms share."""
    library = of_file(*WHAT)
    assert library is not None
    write = routine(library, "cosine_table", ADDRESS, result=COUNT)
    made = np.empty(write(None))
    write(made.ctypes.data)
    return made
