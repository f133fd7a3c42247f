"""Products with rows of which only a window of six neighbouring columns is not zero, and the normal equations of such
rows, in C: each is one pass."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.linalg import LinAlgError
from numpy.typing import NDArray

from hydroopt.kernels.shared_library import of_file
from hydroopt.kernels.thread_memory import room
from hydroopt.spatial.inertia import Array

WIDTH, LANES = 6, 4
"""Of windows.c."""


class Windows:
    """A matrix (N, m) whose row i holds `values` (N, 6) from the column `first` (N,), not decreasing, on."""

    def __init__(self, library: ctypes.CDLL, values: Array, first: NDArray[Any], columns: int) -> None:
        self._library, self._columns, self._count = library, columns, len(values)
        self._held = np.ascontiguousarray(values, dtype=float), np.ascontiguousarray(first, dtype=ctypes.c_int)
        self._rows = ctypes.c_long(len(values)), *(_at(each) for each in self._held)

    def product(self, coefficients: Array) -> Array:
        """Products (N, k) with coefficients (m, k)."""
        made = np.empty((coefficients.shape[1], self._count))
        for column, own in zip(np.ascontiguousarray(coefficients.T, dtype=float), made, strict=True):
            self._library.product(*self._rows, _at(column), _at(own))
        return made.T

    def gathered(self, samples: Array) -> Array:
        """Products (m, k) of the transpose with samples (N, k)."""
        made = np.zeros((samples.shape[1], self._columns))
        for column, own in zip(np.ascontiguousarray(samples.T, dtype=float), made, strict=True):
            self._library.gathered(*self._rows, _at(column), _at(own))
        return made.T

    def gram(self) -> Array:
        """The product (m, m) of the transpose with these rows, in lower band storage (6, m)."""
        made = np.zeros((self._columns, WIDTH))
        self._library.gram(*self._rows, _at(made))
        return made.T


class Factors:
    """Cholesky factors of ``gram + weight·penalty`` (m, m), in lower band storage (6, m), for some weights (k,), until
    this thread makes others."""

    def __init__(self, library: ctypes.CDLL, gram: Array, penalty: Array, weights: Sequence[float]) -> None:
        self._library, self._columns, self._count = library, gram.shape[1], len(weights)
        self._parts = []
        turned = [np.ascontiguousarray(each.T, dtype=float) for each in (gram, penalty)]
        size = (self._columns + WIDTH) * WIDTH * LANES
        every = room("factors", -(-self._count // LANES) * size).reshape(-1, size)
        for first, made in zip(range(0, self._count, LANES), every, strict=True):
            lanes = np.resize(np.array(weights[first : first + LANES], dtype=float), LANES)
            made[: WIDTH * WIDTH * LANES] = 0.0
            library.factors(ctypes.c_long(self._columns), *(_at(each) for each in (*turned, lanes, made)))
            self._parts.append(made)

    def solved(self, right: Array) -> Array:
        """x (m, k) of the systems with right-hand sides (m, k).

        Raises:
            LinAlgError: a matrix is not positive definite.
        """
        made = np.empty_like(right)
        for n, part in enumerate(self._parts):
            some = slice(n * LANES, min((n + 1) * LANES, self._count))
            x = np.zeros((self._columns + 2 * WIDTH, LANES))
            x[WIDTH:-WIDTH, : some.stop - some.start] = right[:, some]
            self._library.solved(ctypes.c_long(self._columns), _at(part), _at(x))
            made[:, some] = x[WIDTH:-WIDTH, : some.stop - some.start]
        if not np.all(np.isfinite(made)):
            raise LinAlgError("a matrix is not positive definite")
        return made


def factors(gram: Array, penalty: Array, weights: Sequence[float]) -> Factors | None:
    """The factors; None where no compiler works."""
    library = _library()
    return None if library is None else Factors(library, gram, penalty, weights)


def weights(x: Array, cell: NDArray[Any], powers: Array) -> Array | None:
    """Values (N, 6) of the splines that live at the places x (N,); None where no compiler works.

    In a `cell` (N,), the whole part of x, they are sums of u^k·powers[k] over powers of the place u in it.
    """
    if (library := _library()) is None:
        return None
    made = np.empty((len(x), WIDTH))
    places, cells, matrix = (np.ascontiguousarray(each, dtype=kind) for each, kind in (
        (x, float), (cell, ctypes.c_int), (powers, float)))
    library.weights(ctypes.c_long(len(x)), _at(places), _at(cells), ctypes.c_long(len(powers)), _at(matrix), _at(made))
    return made


def curves(x: Array, cell: NDArray[Any], powers: Array, coefficients: Array, scale: float) -> Array | None:
    """Values and first two derivatives (3, N, k) of curves at the places x (N,); None where no compiler works.

    In a `cell` (N,), the whole part of x, curve k is the sum of u^i·powers[i, a]·coefficients[cell + a, k], where u is
    the place in it; derivatives are by ``x / scale``.
    """
    if (library := _library()) is None:
        return None
    made = np.empty((3, len(x), coefficients.shape[1]))
    places, cells, matrix = (np.ascontiguousarray(each, dtype=kind) for each, kind in (
        (x, float), (cell, ctypes.c_int), (powers, float)))
    for k, column in enumerate(np.ascontiguousarray(coefficients.T, dtype=float)):
        library.curve(ctypes.c_long(len(x)), *(_at(each) for each in (places, cells, matrix, column)),
                      ctypes.c_double(scale), _at(made[:, :, k]), ctypes.c_long(made.shape[2]),
                      ctypes.c_long(made[0].size))
    return made


def _at(values: NDArray[Any]) -> ctypes.c_void_p:
    return ctypes.c_void_p(values.ctypes.data)


def compiled(values: Array, first: NDArray[Any], columns: int) -> Windows | None:
    """The products of these rows; None where windows have another width, or no compiler works."""
    library = _library() if values.shape[1] == WIDTH else None
    return None if library is None else Windows(library, values, first, columns)


def _library() -> ctypes.CDLL | None:
    return of_file("windows.c", "splines", "NumPy and LAPACK compute them, more slowly")
