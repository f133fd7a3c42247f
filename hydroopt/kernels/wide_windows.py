"""Products with rows of which only a window of neighbouring columns is not zero, however wide, and triangles with a
band, in C: `hydroopt.kernels.windows` is for few columns of many samples, this for many columns of few."""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from hydroopt.kernels.shared_library import of_file
from hydroopt.spatial.inertia import Array


def gram(values: Array, first: NDArray[Any], columns: int) -> Array | None:
    """The product (m, m) of the transpose of rows with these, in lower band storage (w, m); None where no compiler
    works.

    Args:
        values: (N, w) in each row.
        first: (N,) the columns that they begin at.
        columns: their number m.
    """
    if (library := _library()) is None:
        return None
    made = np.zeros((columns, values.shape[1]))
    library.gram(*_rows(values, first, columns), _at(made))
    return made.T


def gathered(values: Array, first: NDArray[Any], columns: int, samples: Array) -> Array | None:
    """Products (m, k) of the transpose of such rows with samples (N, k); None where no compiler works."""
    if (library := _library()) is None:
        return None
    held = np.ascontiguousarray(samples, dtype=float)
    made = np.zeros((columns, held.shape[1]))
    library.gathered(*_rows(values, first, columns), ctypes.c_long(held.shape[1]), _at(held), _at(made))
    return made


def forward(factor: Array, right: Array) -> Array:
    """x (m, k) of L·x = right (m, k), L in lower band storage (w, m)."""
    if (library := _library()) is None:
        return np.asarray(lapack.dtbtrs(factor, right, uplo="L")[0])
    band, made = np.ascontiguousarray(factor.T, dtype=float), np.array(right, dtype=float, order="C")
    library.forward(*map(ctypes.c_long, band.shape), _at(band), ctypes.c_long(made.shape[1]), _at(made))
    return made


def _rows(values: Array, first: NDArray[Any], columns: int) -> tuple[Any, ...]:
    assert not len(first) or (first.min() >= 0 and first.max() + values.shape[1] <= columns)
    held = np.ascontiguousarray(values, dtype=float), np.ascontiguousarray(first, dtype=ctypes.c_long)
    return *map(ctypes.c_long, held[0].shape), _at(held[0]), _at(held[1])


def _at(values: NDArray[Any]) -> ctypes.c_void_p:
    return values.ctypes.data_as(ctypes.c_void_p)  # holds the array


def _library() -> ctypes.CDLL | None:
    return of_file("wide_windows.c", "errors of the motion", "NumPy and LAPACK weigh them, more slowly")
