"""Medians of a window that runs along a signal, and what stands off them, in C at several places at once."""

from __future__ import annotations

import ctypes

import numpy as np

from hydroopt.kernels.shared_library import ADDRESS, COUNT, NUMBER, of_file, routine
from hydroopt.spatial.inertia import Array
from hydroopt.spectra import windowed_median

WIDTH, LANES = 25, 8
"""Samples of a window of running_median.c, so that spikes up to 12 samples wide stand out, and as many windows as are
compared side by side at most."""
FEW = 2**14
"""Number of samples below which loading it does not pay."""


def running_median(x: Array) -> Array:
    """Medians (N,) of x (N,), finite, over `WIDTH` samples about each; the ends are repeated beyond them.

    >>> running_median(np.where(np.arange(100) == 50, 9.0, 1.0)).tolist() == [1.0] * 100
    True
    """
    count, half = len(x), WIDTH // 2
    library = _library() if count >= FEW else None
    if library is None:
        return windowed_median(x, WIDTH)
    run = routine(library, "running_median", COUNT, ADDRESS, ADDRESS)
    x, made = np.ascontiguousarray(x, dtype=float), np.empty(count)
    inner = (count - WIDTH + 1) // LANES * LANES  # windows that reach beyond no end
    run(inner, x.ctypes.data, made[half:].ctypes.data)
    for first, end in ((0, half), (half + inner, count)):
        some = np.arange(first - half, end + half + LANES).clip(0, count - 1)
        beside, own = x[some], np.empty(end - first + LANES)
        run((end - first + LANES - 1) // LANES * LANES, beside.ctypes.data, own.ctypes.data)
        made[first:end] = own[: end - first]
    return made


def residuals(x: Array, share: float) -> tuple[Array, float, int]:
    """What x (N,), finite, is beyond its running median, (N,); the largest size of these residuals, and how many are at
    least this `share` of it.

    >>> off, worst, many = residuals(np.where(np.arange(100) == 50, 9.0, 1.0), 0.5)
    >>> np.flatnonzero(off).tolist(), worst, many
    ([50], 8.0, 1)
    """
    made = running_median(x)
    library = _library() if len(x) >= FEW else None
    if library is None:
        off = x - made
        size = np.abs(off)
        worst = float(size.max(initial=0.0))
        return off, worst, int(np.count_nonzero(size >= share * worst))
    x, most = np.ascontiguousarray(x, dtype=float), ctypes.c_double()
    count = routine(library, "residuals", COUNT, ADDRESS, ADDRESS, NUMBER, ADDRESS, result=COUNT)
    many = count(len(x), x.ctypes.data, made.ctypes.data, share, ctypes.addressof(most))
    return made, most.value, int(many)


def _library() -> ctypes.CDLL | None:
    return of_file("running_median.c", "the running median", "SciPy computes it, more slowly")
