"""Marginal distributions of linear sums of a truncated Gaussian in C; `hydroopt.estimation.inference.truncated` says
what of."""

from __future__ import annotations

import ctypes
import subprocess
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np

from hydroopt.kernels import native
from hydroopt.kernels.compiler import compiler, notice, reason
from hydroopt.spatial.inertia import Array

TILE = 8
"""Number of samples that the C takes at a time."""


def marginals(slack: Array, along: Array, at: Array, matrices: int, tail: float) -> Array | None:
    """Mean, mean square and both quantiles (n, 4) of n sums; None where no compiler works.

    Args:
        slack: (m, s) of so many matrices at the samples, first entries of their upper triangles, second ones, ..., then
            of single conditions; s a multiple of `TILE`.
        along: (n, m) what a step of length 1 in the direction of each sum changes them by.
        at: (n, s) values of the sums, of unit variance without conditions.
        matrices: their number.
        tail: probability beyond each quantile.
    """
    run = _compiled()
    if run is None:
        return None
    (rows, samples), sums = slack.shape, len(along)
    assert samples % TILE == 0
    assert along.shape == (sums, rows)
    assert at.shape == (sums, samples)
    held = [np.ascontiguousarray(each, dtype=float) for each in (slack, along, at)]
    work, found = np.empty(2 * sums * samples + 10 * TILE * matrices), np.empty((sums, 4))
    run(samples, matrices, rows - 10 * matrices, sums, tail, *(each.ctypes.data for each in (*held, work, found)))
    return found


@cache
def _compiled() -> Callable[..., None] | None:
    found = compiler()
    if found is None or found.hangs:
        return None
    source = Path(__file__).with_suffix(".c").read_text("utf-8")
    try:
        run: Callable[..., None] = native.built([source.encode()], found, lambda: source).marginals
    except (OSError, subprocess.SubprocessError) as error:
        notice(f"marginal distributions cannot be compiled ({reason(error)})", "intervals are those of the samples, "
               "which are less exact")
        return None
    run.argtypes = [*[ctypes.c_long] * 4, ctypes.c_double, *[ctypes.c_void_p] * 5]  # type: ignore[attr-defined]
    run.restype = None  # type: ignore[attr-defined]
    return run
