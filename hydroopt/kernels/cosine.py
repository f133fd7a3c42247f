"""Cosine transforms of blocks of samples in C, several rows at once."""

from __future__ import annotations

import ctypes
import subprocess
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np

from hydroopt import spectra
from hydroopt.kernels.compiler import compiler, notice, reason
from hydroopt.spatial.inertia import Array

SIZE, LANES = 2**13, 8
"""SIZE of cosine.c, and as many rows are transformed side by side at most."""
WORK = LANES * (SIZE + 2**7) + SIZE
"""Numbers that cosine.c needs room for."""


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
def _library() -> ctypes.CDLL | None:
    from hydroopt.kernels import native  # noqa: PLC0415 (import cost)

    by = compiler()
    if by is None or by.hangs:
        return None
    source = Path(__file__).with_suffix(".c").read_text("utf-8")
    try:
        return native.built([source.encode()], by, lambda: source)
    except (OSError, subprocess.SubprocessError) as error:
        notice(f"the cosine transform cannot be compiled ({reason(error)})", "NumPy computes it, more slowly")
        return None


@cache
def _compiled() -> Callable[..., None] | None:
    library = _library()
    if library is None:
        return None
    run: Callable[..., None] = library.cosine
    run.argtypes = [ctypes.c_long, ctypes.c_void_p, ctypes.c_long, ctypes.c_void_p, ctypes.c_void_p]  # type: ignore[attr-defined]
    run.restype = None  # type: ignore[attr-defined]
    return run


@cache
def _table() -> Array:
    """Roots of 1 that all transforms share."""
    library = _library()
    assert library is not None
    write = library.cosine_table
    write.argtypes, write.restype = [ctypes.c_void_p], ctypes.c_long
    made = np.empty(write(None))
    write(made.ctypes.data)
    return made
