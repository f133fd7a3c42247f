"""Marginal distributions of linear sums of a truncated Gaussian in C; `hydroopt.estimation.inference.truncated` says
what of."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np

from hydroopt.kernels.shared_library import ADDRESS, COUNT, NUMBER, of_file, routine
from hydroopt.spatial.inertia import Array

TILE, MINORS = 8, 42
"""Of marginals.c: samples that it takes at a time, and numbers that it keeps of a matrix."""


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
    work, found = np.empty(2 * sums * samples + MINORS * matrices * (sums + TILE) + 10 * matrices), np.empty((sums, 4))
    run(samples, matrices, rows - 10 * matrices, sums, tail, *(each.ctypes.data for each in (*held, work, found)))
    return found


@cache
def _compiled() -> Callable[..., None] | None:
    library = of_file("marginals.c", "marginal distributions",
                      "intervals are those of the samples, which are less exact")
    return None if library is None else routine(library, "marginals", *[COUNT] * 4, NUMBER, *[ADDRESS] * 5)
