"""Tails of the distributions of tests, without loading SciPy's packages; tests compare them with `scipy.special`.

Incomplete gamma and beta functions by series and continued fractions (Press et al. 2007, sections 6.2 and 6.4).
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import count
from math import erfc, exp, inf, isnan, lgamma, log, log1p, nan, sqrt

import numpy as np
from numpy.typing import NDArray

PRECISION, TINY = 1e-15, 1e-300
INFINITE = 1e8
"""Degrees of freedom beyond which Fisher's F counts as chi-squared: p-values agree to 1e-6."""
NORMAL = 1.959963984540054
"""Quantile of the normal distribution at 97.5 %."""


def normal(z: float) -> float:
    """Probability of more than z from a standard normal variable.

    >>> round(normal(1.959964), 6)
    0.025
    """
    return erfc(z / sqrt(2)) / 2


def chi_square(freedom: float, x: float) -> float:
    """Probability of more than x from a chi-squared variable.

    >>> round(chi_square(3, 7.814728), 6)
    0.05
    """
    a, x = freedom / 2, x / 2
    if isnan(x) or isnan(a):
        return nan
    if x <= 0 or a <= 0:
        return float(x <= 0 < a)
    if x == inf:
        return 0.0
    front = exp(a * log(x) - x - lgamma(a))
    if x < a + 1:
        term = total = 1 / a
        for k in count(1):
            term *= x / (a + k)
            total += term
            if term < PRECISION * total:
                return 1 - front * total
    return front / _continued(((k * (a - k), x + 2 * k + 1 - a) for k in count(1)), x + 1 - a)


def fisher(above: float, below: float, x: float) -> float:
    """Probability of more than x from Fisher's F with these degrees of freedom above and below.

    >>> round(fisher(3, 20, 3.098391), 6)
    0.05
    """
    if below > INFINITE:
        return chi_square(above, above * x)
    return _beta(below / 2, above / 2, below, above * x) if x > 0 else 1.0 if x <= 0 else nan


def student_quantile(freedom: NDArray[np.float64]) -> NDArray[np.float64]:
    """The 97.5 % quantiles of Student's t with degrees of freedom (...): by their expansion about the normal one
    (Abramowitz and Stegun 1964, 26.7.5), and Newton's steps where freedoms are few.

    >>> student_quantile(np.array([3.0, 1e12])).round(6).tolist()
    [3.182446, 1.959964]
    """
    z, n = NORMAL, np.maximum(np.asarray(freedom, dtype=float), 0.02)
    found = z + (z**3 + z) / (4 * n) + (5 * z**5 + 16 * z**3 + 3 * z) / (96 * n**2) + (
        3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / (384 * n**3) + (
        79 * z**9 + 776 * z**7 + 1482 * z**5 - 1920 * z**3 - 945 * z) / (92160 * n**4)
    for at in np.flatnonzero(n < 200):
        found.flat[at] = _student(float(n.flat[at]), float(found.flat[at]))
    return np.asarray(found)


def _student(n: float, t: float) -> float:
    """The quantile near t, by Newton's steps on the logarithm of the tail over that of t, which is nearly straight."""
    size = exp(lgamma((n + 1) / 2) - lgamma(n / 2)) / sqrt(n * np.pi)
    t = max(t, NORMAL) if n > 1 else 0.025 ** (-1 / n)  # tails fall as t⁻ⁿ
    for _ in range(60):
        tail = _beta(n / 2, 0.5, n, t * t) / 2
        step = log(tail / 0.025) * tail / (t * size * (1 + t * t / n) ** (-(n + 1) / 2))
        t *= exp(step)
        if abs(step) < 1e-6:  # what is left is of the size of its square
            break
    return t


def _beta(a: float, b: float, p: float, q: float) -> float:
    """The regularised incomplete beta function at p/(p + q), whose complement is q/(p + q)."""
    x, y = p / (p + q), q / (p + q)
    if x in (0.0, 1.0):
        return x
    front = exp(lgamma(a + b) - lgamma(a) - lgamma(b) - a * log1p(q / p) - b * log1p(p / q))
    swapped = x > (a + 1) / (a + b + 2)
    if swapped:
        a, b, x = b, a, y
    found = front / (a * _continued(_beta_fractions(a, b, x), 1.0))
    return 1 - found if swapped else found


def _beta_fractions(a: float, b: float, x: float) -> Iterator[tuple[float, float]]:
    yield -(a + b) * x / (a + 1), 1.0
    for k in count(1):
        yield k * (b - k) * x / ((a + 2 * k - 1) * (a + 2 * k)), 1.0
        yield -(a + k) * (a + b + k) * x / ((a + 2 * k) * (a + 2 * k + 1)), 1.0


def _continued(fractions: Iterator[tuple[float, float]], first: float) -> float:
    """``first + α₁/(β₁ + α₂/(β₂ + …))`` by Lentz's method, for terms (α, β)."""
    value = first or TINY
    above, below = value, 0.0
    for alpha, beta in fractions:
        below = 1 / (beta + alpha * below or TINY)
        above = beta + alpha / above or TINY
        value *= above * below
        if abs(above * below - 1) < PRECISION:
            break
    return value
