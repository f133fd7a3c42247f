"""Sweeps of elliptical slice sampling in C; `hydroopt.estimation.inference.elliptical_moves` says what they do."""

from __future__ import annotations

import ctypes
import subprocess
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hydroopt.kernels import native
from hydroopt.kernels.compiler import compiler, notice, reason
from hydroopt.spatial.inertia import Array


class _Density(ctypes.Structure):
    """The structure `density` of ellipses.c."""

    _fields_ = (*((name, ctypes.c_long) for name in ("coordinates", "functions", "matrices", "own")),
                *((name, ctypes.c_void_p) for name in ("place", "slope", "square", "linear", "weight", "spread")),
                ("freedoms", ctypes.c_double))


class Sweeper:
    """Moves chains in a density.

    Args:
        slope: (m, k) of the linear functions, first the entries of the matrices' upper triangles.
        square: (k,) coefficients of the log-density's squares beyond standard normal coordinates.
        linear: (k,) those of the coordinates themselves.
        weight: (b,) weights of the matrices' log-det distances, 0 where there is none.
        spread: (b,) from which matrices have that distance.
        freedoms: of the Student-t about which blocks move; 0 of a Gaussian.
    """

    def __init__(self, sweep: Callable[..., None], slope: Array, square: Array, linear: Array, weight: Array,
                 spread: Array, freedoms: float) -> None:
        (own, coordinates), matrices = slope.shape, len(weight)
        wide = _filled(matrices)
        entries = np.arange(10 * matrices).reshape(10, matrices) + (wide - matrices) * np.arange(10)[:, None]
        place = np.concatenate([entries.ravel(), np.arange(own - 10 * matrices) + 10 * wide]).astype(np.int_)
        functions = _filled(10 * wide + own - 10 * matrices)
        slopes, weights, spreads = np.zeros((coordinates, functions)), np.zeros(wide), np.ones(wide)
        slopes[:, place], weights[:matrices], spreads[:matrices] = slope.T, weight, spread
        alike = (np.ascontiguousarray(each, dtype=float) for each in (square, linear))
        held = [place, slopes, *alike, weights, spreads]
        self._sweep, self._held = sweep, held
        self._density = _Density(coordinates, functions, wide, own, *(each.ctypes.data for each in held), freedoms)
        self._work = np.empty(3 * coordinates + 4 * functions + 4 * wide)

    def __call__(self, size: int, order: NDArray[np.intp], other: Array, square: Array, chance: Array, level: Array,
                 state: Array, slack: Array, log_density: Array) -> None:
        """Move every block of `size` coordinates of all chains once; state (k, c), slack (m, c) and log-density (c,)
        change in place.

        Args:
            size: of a block; the last one may be smaller.
            order: (k,) of the coordinates, block by block.
            other: (k, c) second axes of the ellipses, in this order.
            square: (blocks, c) chi-squared numbers, which make these axes Student-t; not read of a Gaussian.
            chance: (blocks, tries, c) between 0 and 1, of the angles.
            level: (blocks, c) by which the log-density may fall at most.
        """
        changed = (state, slack, log_density)
        assert all(each.flags.c_contiguous and each.dtype == float for each in (*changed, other, square, chance, level))
        self._sweep(ctypes.byref(self._density), state.shape[1], chance.shape[1], size,
                    np.ascontiguousarray(order, dtype=np.int_).ctypes.data,
                    *(each.ctypes.data for each in (other, square, chance, level, *changed, self._work)))


def _filled(count: int) -> int:
    """The next multiple of `TILE` in ellipses.c."""
    return -(-count // 8) * 8


@cache
def compiled() -> Callable[..., None] | None:
    """The C of `Sweeper`; None where no compiler works."""
    found = compiler()
    if found is None or found.hangs:
        return None
    source = Path(__file__).with_name("ellipses.c").read_text("utf-8")
    try:
        sweep = native.built([source.encode()], found, lambda: source).sweep
    except (OSError, subprocess.SubprocessError) as error:
        notice(f"the sampler cannot be compiled ({reason(error)})", "NumPy does its work, more slowly")
        return None
    sweep.argtypes = [ctypes.c_void_p, *[ctypes.c_long] * 3, *[ctypes.c_void_p] * 9]
    sweep.restype = None
    compiled_sweep: Callable[..., None] = sweep
    return compiled_sweep
