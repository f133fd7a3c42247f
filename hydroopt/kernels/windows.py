"""Products with rows of which only a window of six neighbouring columns is not zero, in C: each is one pass."""

from __future__ import annotations

import ctypes
import subprocess
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydroopt.kernels.compiler import compiler, notice, reason
from hydroopt.spatial.inertia import Array

WIDTH = 6
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


def _at(values: NDArray[Any]) -> ctypes.c_void_p:
    return ctypes.c_void_p(values.ctypes.data)


def compiled(values: Array, first: NDArray[Any], columns: int) -> Windows | None:
    """The products of these rows; None where windows have another width, or no compiler works."""
    library = _library() if values.shape[1] == WIDTH else None
    return None if library is None else Windows(library, values, first, columns)


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
        notice(f"sums of splines cannot be compiled ({reason(error)})", "NumPy computes them, more slowly")
        return None
