"""Arrays that are too long for memory: each lies in a temporary file, which is mapped into memory as it is used."""

from __future__ import annotations

import mmap
import os
import tempfile
from collections.abc import Callable, Sequence
from typing import Any
from weakref import WeakSet

import numpy as np
from numpy.typing import DTypeLike, NDArray

from hydroopt.errors import LogError

MAPPED = 2**20
"""Numbers from which on an array lies in a file."""

_maps: WeakSet[mmap.mmap] = WeakSet()


def empty(shape: int | Sequence[int], dtype: DTypeLike = float) -> NDArray[Any]:
    """An array to be filled, in memory or, where it is long, in a temporary file that ends with it.

    Raises:
        LogError: there is no room for the file.

    >>> empty((3, 2)).shape, empty(2 * MAPPED, bool)[-1]
    ((3, 2), np.False_)
    """
    kind = np.dtype(dtype)
    if np.prod(shape) < MAPPED:
        return np.empty(shape, kind)
    size = int(np.prod(shape)) * kind.itemsize
    try:
        with tempfile.TemporaryFile() as file:
            if hasattr(os, "posix_fallocate"):  # writing where the disk is full ends the process
                os.posix_fallocate(file.fileno(), 0, size)
            else:
                file.truncate(size)
            made = mmap.mmap(file.fileno(), size)
    except OSError as error:
        raise LogError(f"{size / 1e9:.2g} GB of a long log do not fit ({error.strerror})", where=tempfile.gettempdir(),
                       remedy="make room there, or let TMPDIR name another folder") from None
    _maps.add(made)
    return np.ndarray(shape, kind, made)


def by_pieces(size: int, part: Callable[[slice], NDArray[Any]], kind: DTypeLike = float) -> NDArray[Any]:
    """An array (N,) that cannot be written to, of which so much is made at a time as lies in memory.

    >>> by_pieces(4, lambda span: np.arange(span.start, span.stop), int).tolist()
    [0, 1, 2, 3]
    """
    made = empty(size, kind)
    for start in range(0, size, MAPPED // 8):
        span = slice(start, min(start + MAPPED // 8, size))
        made[span] = part(span)
        release()
    made.setflags(write=False)
    return made


def stored(x: NDArray[Any]) -> NDArray[Any]:
    """An array (N,) itself, or where it is long a copy in a file, which cannot be written to."""
    return x if x.size < MAPPED or isinstance(x.base, mmap.mmap) else by_pieces(x.size, x.__getitem__, x.dtype)


def at(x: NDArray[Any], places: NDArray[Any]) -> NDArray[Any]:
    """Some elements of an array, of which no more stays in memory."""
    found: NDArray[Any] = x[places]
    release()
    return found


def extremes(x: NDArray[Any]) -> tuple[float, float]:
    """The smallest and the largest number of an array (N,); inf and -inf where it holds none."""
    found = float(np.fmin.reduce(x, initial=np.inf)), float(np.fmax.reduce(x, initial=-np.inf))
    release()
    return found


def release() -> None:
    """Give back the memory of all such arrays; what they hold is read from their files again when it is used."""
    if hasattr(mmap, "MADV_DONTNEED"):
        for each in _maps:
            each.madvise(mmap.MADV_DONTNEED)
