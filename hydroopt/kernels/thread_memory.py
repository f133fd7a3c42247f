"""Memory that a thread uses again: fresh memory costs as much as what is computed in it."""

from __future__ import annotations

import threading

import numpy as np

from hydroopt.spatial.inertia import Array

LINE = 8
"""Numbers in a cache line."""


class _Memory(threading.local):
    def __init__(self) -> None:
        self.held: dict[str, Array] = {}


_memory = _Memory()


def room(purpose: str, size: int) -> Array:
    """Memory (size,) of this thread for a purpose, from a cache line on; it holds anything, and the next call for the
    same purpose gives it again.

    >>> one = room("this example", 5)
    >>> one[:] = 1.0
    >>> room("this example", 3).tolist(), one.ctypes.data % 64
    ([1.0, 1.0, 1.0], 0)
    """
    held = _memory.held
    if purpose not in held or held[purpose].size < size:
        held.pop(purpose, None)
        whole = np.empty(size + LINE)
        held[purpose] = whole[-(whole.ctypes.data // whole.itemsize) % LINE :][:size]
    return held[purpose][:size]
