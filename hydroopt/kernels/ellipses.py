"""Sweeps of elliptical slice sampling in C; `hydroopt.estimation.inference.elliptical_moves` says what they do."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import cache

import numpy as np
from numpy.typing import NDArray

from hydroopt.kernels.shared_library import ADDRESS, COUNT, of_file, routine
from hydroopt.spatial.inertia import Array

TILE, GROUP = 4, 6
"""Of ellipses.c: chains side by side, and functions whose sums are computed at a time."""


class _Density(ctypes.Structure):
    """The structure `density` of ellipses.c."""

    _fields_ = (*((name, ctypes.c_long) for name in ("coordinates", "functions", "matrices")),
                *((name, ctypes.c_void_p) for name in ("slope", "square", "linear", "weight", "spread")),
                ("freedoms", ctypes.c_double))


class Sweeper:
    """Moves chains in a density.

    Args:
        slope: (m, k) of the linear functions, first the entries of the matrices' upper triangles.
        square: (k,) coefficients of the log-density's squares beyond standard normal coordinates.
        linear: (k,) those of the coordinates themselves.
        weight: (b,) weights of the matrices' log-det distances, 0 where there is none.
        spread: (b,) from which matrices have that distance.
        freedoms: of the Student-t about which blocks move where matrices have such distances; 0 of a Gaussian.
    """

    def __init__(self, sweep: Callable[..., None], slope: Array, square: Array, linear: Array, weight: Array,
                 spread: Array, freedoms: float) -> None:
        (functions, coordinates), matrices = slope.shape, len(weight)
        held = [np.ascontiguousarray(each, dtype=float) for each in (slope, square, linear, weight, spread)]
        self._sweep, self._held = sweep, held
        self._density = _Density(coordinates, functions, matrices, *(each.ctypes.data for each in held), freedoms)
        filled = -(-functions // GROUP) * GROUP
        self._work = np.empty(filled * coordinates + TILE * (3 * coordinates + 3 * filled))

    def __call__(self, size: int, order: NDArray[np.intp], other: Array, square: Array, chance: Array, level: Array,
                 state: Array, slack: Array, log_density: Array) -> None:
        """Move every block of `size` coordinates of all chains once; state (k, c), slack (m, c) and log-density (c,)
        change in place; c is a multiple of `TILE`.

        Args:
            size: of a block; the last one may be smaller.
            order: (k,) of the coordinates, block by block.
            other: (k, c) second axes of the ellipses, in this order.
            square: (blocks, c) chi-squared numbers, which make these axes Student-t; not read of a Gaussian.
            chance: (blocks, tries, c) between 0 and 1, of the angles.
            level: (blocks, c) by which the log-density may fall at most.
        """
        changed = (state, slack, log_density)
        assert state.shape[1] % TILE == 0
        assert all(each.flags.c_contiguous and each.dtype == float for each in (*changed, other, square, chance, level))
        self._sweep(ctypes.byref(self._density), state.shape[1], chance.shape[1], size,
                    np.ascontiguousarray(order, dtype=ctypes.c_long).ctypes.data,
                    *(each.ctypes.data for each in (other, square, chance, level, *changed, self._work)))


@cache
def compiled() -> Callable[..., None] | None:
    """The C of `Sweeper`; None where no compiler works."""
    library = of_file("ellipses.c", "the sampler", "NumPy does its work, more slowly")
    return None if library is None else routine(library, "sweep", ADDRESS, *[COUNT] * 3, *[ADDRESS] * 9)
