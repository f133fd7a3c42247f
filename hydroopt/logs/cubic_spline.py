"""Cubic splines through samples, the third derivative steady at the second and the last but one ("not a knot")."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.linalg import solve_banded

from hydroopt.spatial.inertia import Array


class CubicSpline:
    """The spline through samples; that of SciPy's ``make_interp_spline``, whose import takes longer than most jobs.

    Args:
        t: times (N,) of at least four samples, increasing.
        values: at them (N, ...).

    >>> t = np.array([0.0, 1.0, 3.0, 4.0, 6.0])
    >>> CubicSpline(t, t**3)(np.array([2.0, 5.0])).round(9).tolist()
    [8.0, 125.0]
    """

    def __init__(self, t: Array, values: Array) -> None:
        self._t, self._steps = t, np.diff(t)
        self._values = np.asarray(values, dtype=float)
        h, y = self._steps, self._values.reshape(len(t), -1)
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
        self._slopes = solve_banded((1, 1), bands, right).reshape(self._values.shape)

    def __call__(self, times: Array, which: tuple[Any, ...] = ()) -> Array:
        """At some times (M, ...), all entries or those of an index; beyond the samples the outer pieces go on."""
        k = np.clip(np.searchsorted(self._t, times, side="right") - 1, 0, len(self._t) - 2)
        y, slope = (each[:, *which].reshape(len(self._t), -1) for each in (self._values, self._slopes))
        h = self._steps[k][:, None]
        start, step = y[k], y[k + 1] - y[k]
        u = (times - self._t[k])[:, None] / h
        off, on = h * slope[k] - step, h * slope[k + 1] - step
        made = start + u * step + u * (1 - u) * (off * (1 - u) - on * u)
        return np.asarray(made.reshape(len(times), *self._values[:, *which].shape[1:]))
