"""Which joints move, are calm or at rest in each sample, in C; `estimation.dynamic.friction_sign` says when."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
from numpy.typing import NDArray

from hydroopt.kernels.shared_library import ADDRESS, COUNT, NUMBER, of_file, routine
from hydroopt.kernels.thread_memory import room
from hydroopt.spatial.inertia import Array

PARTS = 4
"""Of phases.c."""
Marks = NDArray[np.bool_]


def phases(t: Array, angles: Array, speeds: Array, shifts: Array, slow: Array, apart: Array, least: float
           ) -> tuple[Marks, Marks, Marks] | None:
    """Where joints move, are calm, and have one mean in all parts of the window, (N, c) each; None where no compiler
    works.

    Args:
        t: times (N,) [s], not decreasing.
        angles: measured positions (N, c).
        speeds: (N, c).
        shifts: (PARTS + 1,) from a sample's time to the first of each part of its window, and to the end [s].
        slow: (c,) speeds up to which joints do not move.
        apart: (c,) difference of two means of one sample each, over the square root of 2, up to which they are one.
        least: difference up to which they are one, however many samples.
    """
    if (run := _compiled()) is None:
        return None
    (rows, joints), made = angles.shape, np.empty((3, angles.shape[1], len(t)), dtype=bool)
    sums = room("phases", joints * (rows + 1))
    held = [np.ascontiguousarray(each, dtype=float) for each in (t, shifts, slow, apart)]
    strides = [[step // 8 for step in each.strides] for each in (angles, speeds)]
    assert len(shifts) == PARTS + 1
    assert angles.dtype == speeds.dtype == float
    at = [each.ctypes.data for each in held]
    run(rows, at[0], at[1], joints, angles.ctypes.data, *strides[0], speeds.ctypes.data, *strides[1], *at[2:], least,
        sums.ctypes.data, *(each.ctypes.data for each in made))
    moving, calm, same = made
    return moving.T, calm.T, same.T


@cache
def _compiled() -> Callable[..., None] | None:
    library = of_file("phases.c", "phases of motion", "NumPy tells them, more slowly")
    return None if library is None else routine(
        library, "phases", COUNT, ADDRESS, ADDRESS, COUNT, *[ADDRESS, COUNT, COUNT] * 2, *[ADDRESS] * 2, NUMBER,
        *[ADDRESS] * 4)
