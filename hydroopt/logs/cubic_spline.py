"""Cubic splines through samples, the third derivative steady at the second and the last but one ("not a knot")."""

from __future__ import annotations

import numpy as np

from hydroopt.lapack import banded_solved
from hydroopt.spatial.inertia import Array


def cubic_spline(t: Array, values: Array, times: Array) -> Array:
    """The spline at some times; that of SciPy's ``make_interp_spline``, whose import takes longer than most jobs.

    Args:
        t: times (N,) of at least four samples, increasing.
        values: at them (N, ...).
        times: where to evaluate (M,).

    Returns:
        (M, ...); beyond the samples the first and last pieces go on.

    >>> t = np.array([0.0, 1.0, 3.0, 4.0, 6.0])
    >>> cubic_spline(t, t**3, np.array([2.0, 5.0])).round(9).tolist()
    [8.0, 125.0]
    """
    h = np.diff(t)
    y = np.reshape(values, (len(t), -1)).astype(float)
    rise = np.diff(y, axis=0) / h[:, None]
    bands, right = np.zeros((3, len(t))), np.empty_like(y)
    # slopes at the samples: equal second derivatives of neighbouring pieces
    bands[0, 2:], bands[1, 1:-1], bands[2, :-2] = h[:-1], 2 * (h[:-1] + h[1:]), h[1:]
    right[1:-1] = 3 * (h[1:, None] * rise[:-1] + h[:-1, None] * rise[1:])
    first, last = h[0] + h[1], h[-1] + h[-2]
    bands[1, 0], bands[0, 1] = h[1], first
    right[0] = ((h[0] + 2 * first) * h[1] * rise[0] + h[0] ** 2 * rise[1]) / first
    bands[1, -1], bands[2, -2] = h[-2], last
    right[-1] = (h[-1] ** 2 * rise[-2] + (2 * last + h[-1]) * h[-2] * rise[-1]) / last
    slope = banded_solved(1, 1, bands, right)
    k = np.clip(np.searchsorted(t, times, side="right") - 1, 0, len(t) - 2)
    u, step = ((times - t[k]) / h[k])[:, None], h[k][:, None]
    off, on = step * (slope[k] - rise[k]), step * (slope[k + 1] - rise[k])
    made = y[k] + u * step * rise[k] + u * (1 - u) * (off * (1 - u) - on * u)
    return np.asarray(made.reshape(len(times), *np.shape(values)[1:]))
