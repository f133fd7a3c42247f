"""Readings that follow as a first-order system does: ``τ·dy/dt + y = x``."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_banded

from hydroopt.logs.readings import bridged
from hydroopt.spatial.inertia import Array


def stretches(segment: NDArray[np.int64]) -> list[tuple[int, int]]:
    """First sample of each stretch, and one after its last.

    >>> stretches(np.array([0, 0, 1, 1, 1]))
    [(0, 2), (2, 5)]
    """
    edges = np.flatnonzero(np.diff(segment, prepend=segment[0] - 1, append=segment[-1] + 1)).tolist()
    return list(pairwise(edges))


def lagged(t: Array, x: Array, lag: float, segment: NDArray[np.int64] | None = None) -> Array:
    """What a sensor with a lag reads of x (N, ...) at the times t (N,) [s]: exact where x is linear between samples.

    Args:
        t: increasing times [s].
        x: true values.
        lag: time constant τ [s], not negative.
        segment: (N,) stretch of each sample; each begins as if x had changed before as it does at its beginning.

    >>> t = np.arange(5) / 10
    >>> lagged(t, 2.0 * t, 0.05).round(6).tolist()
    [-0.1, 0.1, 0.3, 0.5, 0.7]
    """
    values = np.asarray(x, dtype=float)
    if lag <= 0:
        return values.copy()
    made = np.empty_like(values)
    for first, end in stretches(np.zeros(len(t), dtype=int) if segment is None else segment):
        made[first:end] = _stretch(t[first:end], values[first:end].reshape(end - first, -1), lag).reshape(
            values[first:end].shape)
    return made


def _stretch(t: Array, x: Array, lag: float) -> Array:
    if len(t) < 2:
        return x
    steps = np.diff(t) / lag
    keeps = np.exp(-steps)
    ramp = -np.expm1(-steps) / steps  # mean weight of the past over a step
    recursion = np.zeros((2, len(t)))
    recursion[0], recursion[1, :-1] = 1.0, -keeps
    driven = np.empty_like(x)
    driven[1:] = (1 - ramp)[:, None] * x[1:] + (ramp - keeps)[:, None] * x[:-1]
    driven[0] = x[0] - (x[1] - x[0]) / steps[0]
    return solve_banded((1, 0), recursion, driven)


def slowed(t: Array, y: Array, lag: float, wanted: float, segment: NDArray[np.int64] | None = None) -> Array:
    """Readings y (N,), some NaN, of a sensor with a `lag` [s] as one with a longer lag, `wanted` [s], gives them.

    >>> t = np.arange(5) / 10
    >>> slowed(t, 2.0 * t, 0.01, 0.05).round(6).tolist()
    [-0.08, 0.12, 0.32, 0.52, 0.72]
    """
    if wanted <= lag:
        return y
    return np.asarray(y * (lag / wanted) + (1 - lag / wanted) * lagged(t, bridged(y), wanted, segment))
