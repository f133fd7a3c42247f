"""The smoothing filter of the thesis (section 4.5): least squares with weights on the first and second derivatives.

Minimises ``Σ (y_i − q_i)²·h̄ + β₁·∫ q̇² dt + β₂·∫ q̈² dt`` over the positions q_i at the samples' own times (h̄ is the
mean step), with q̇ and q̈ as their divided differences. The thesis solves it by dynamic programming, one sample after the
other; here it is one pentadiagonal system, with the same minimum, in O(N).

Far from the ends a motion of the angular frequency ω passes with the amplitude ``1 / (1 + β₁·ω² + β₂·ω⁴)``, without
delay: β₂ alone is a low-pass of order four, flat below its bandwidth; β₁ takes speed away from slow motions too. White
noise of positions, σ in each sample, leaves ``σ·√(2·h̄·∫ (2πf)^(2k)·response² df)`` in the k-th derivative.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import solveh_banded

from hydroopt.spatial.inertia import Array


def two_weights(t: Array, y: Array, speed: float, acceleration: float) -> Array:
    """Smooth positions with their first and second derivatives (3, N, n).

    Args:
        t: (N,) increasing times [s], at least three.
        y: (N, n) measured positions [rad or m].
        speed: β₁ [s²].
        acceleration: β₂ [s⁴].

    >>> t = np.arange(500) / 50
    >>> q, qd, qdd = two_weights(t, np.sin(t)[:, None], 0.0, 1e-6)
    >>> bool(np.max(np.abs(q[50:-50, 0] - np.sin(t[50:-50]))) < 1e-5)
    True
    """
    steps = np.diff(t)
    banded = np.zeros((3, len(t)))
    banded[0] = np.mean(steps)
    banded[0, :-1] += speed / steps
    banded[0, 1:] += speed / steps
    banded[1, :-1] -= speed / steps
    before, after = steps[:-1], steps[1:]
    both = before + after
    rows = np.array([2 / (before * both), -2 / (before * after), 2 / (after * both)])  # of q̈ at the inner samples
    weight = acceleration * both / 2
    for i in range(3):
        for j in range(i, 3):
            banded[j - i, i : len(t) - 2 + i] += weight * rows[i] * rows[j]
    q = solveh_banded(banded, np.mean(steps) * y, lower=True)
    inner = rows[0, :, None] * q[:-2] + rows[1, :, None] * q[1:-1] + rows[2, :, None] * q[2:]
    return np.stack([q, np.gradient(q, t, axis=0), np.concatenate([inner[:1], inner, inner[-1:]])])


def bandwidth(speed: float, acceleration: float) -> float:
    """Frequency [Hz] that passes by half."""
    if acceleration == 0:
        return float(1 / np.sqrt(speed) / (2 * np.pi))
    return float(np.sqrt(2 / (speed + np.sqrt(speed**2 + 4 * acceleration))) / (2 * np.pi))
