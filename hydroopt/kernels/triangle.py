"""The triangle of a QR of many rows in C: one pass over them, in the first cache, without a copy of all."""

from __future__ import annotations

import ctypes
import subprocess
import threading
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hydroopt.kernels.compiler import compiler, notice, reason
from hydroopt.spatial.inertia import Array

PANEL, ROWS, LANES = 4, 128, 8
"""Of triangle.c: columns reflected together, rows at a time, and numbers in a register at most."""


class _Memory(threading.local):
    """Memory of a thread: fresh memory for each block would cost as much as its copy."""

    work = np.empty(0)


_memory = _Memory()


def triangle_of(*blocks: Array, places: NDArray[np.intp] | None = None) -> Array:
    """R (k, k) of a QR of the blocks (m, k) stacked, of the last of them the rows at `places` alone if stated. Where
    there are fewer rows than columns, the last rows of R are zero.

    >>> triangle_of(np.array([[3.0]]), np.array([[4.0], [7.0]]), places=np.array([0]))
    array([[-5.]])
    """
    k = blocks[0].shape[1]
    run, width = _compiled(), -(-k // PANEL) * PANEL
    if run is None:
        last = blocks[-1] if places is None else blocks[-1][places]
        return np.asarray(np.linalg.qr(np.vstack([*blocks[:-1], last, np.zeros((k, k))]), mode="r"))
    if _memory.work.size < width * ROWS + LANES:
        _memory.work = np.empty(width * ROWS + LANES)
    work = _memory.work[-(_memory.work.ctypes.data // 8) % LANES :]  # from a cache line on
    made = np.zeros((width, width))
    some = None if places is None else np.ascontiguousarray(places, dtype=ctypes.c_long)
    for block in blocks:
        rows, at = (len(block), None) if some is None or block is not blocks[-1] else (len(some), some.ctypes.data)
        down, across = (step // block.itemsize for step in block.strides)
        run(width, made.ctypes.data, rows, at, k, block.ctypes.data, down, across, work.ctypes.data)
    return made[:k, :k]


@cache
def _compiled() -> Callable[..., None] | None:
    from hydroopt.kernels import native  # noqa: PLC0415 (import cost)

    by = compiler()
    if by is None or by.hangs:
        return None
    source = Path(__file__).with_suffix(".c").read_text("utf-8")
    try:
        run: Callable[..., None] = native.built([source.encode()], by, lambda: source).triangle
    except (OSError, subprocess.SubprocessError) as error:
        notice(f"the QR of many rows cannot be compiled ({reason(error)})", "LAPACK computes it, more slowly")
        return None
    run.argtypes = [*[ctypes.c_long, ctypes.c_void_p] * 3,  # type: ignore[attr-defined]
                    ctypes.c_long, ctypes.c_long, ctypes.c_void_p]
    run.restype = None  # type: ignore[attr-defined]
    return run
