"""Brent's minimum of a function of one variable between bounds, without derivatives (Brent 1973, chapter 5)."""

from __future__ import annotations

import math
from collections.abc import Callable

GOLDEN = (3 - math.sqrt(5)) / 2
MOST = 500
"""Evaluations at most."""


def bounded_minimum(function: Callable[[float], float], low: float, high: float,
                    tolerance: float = 1e-5) -> tuple[float, float]:
    """Where a function is lowest between two bounds, and its value there.

    Golden sections, and parabolas through the three best places where these converge: the steps of SciPy's
    ``minimize_scalar(method="bounded")``, whose import takes longer than an identification.

    Args:
        function: has one minimum between the bounds; else a local one is found.
        low, high: the bounds, never evaluated themselves.
        tolerance: of the place.

    >>> x, value = bounded_minimum(lambda x: (x - 2.0) ** 2 + 1.0, 0.0, 3.0)
    >>> round(x, 4), round(value, 4)
    (2.0, 1.0)
    """
    best = second = third = low + GOLDEN * (high - low)
    lowest = next_lowest = third_lowest = float(function(best))
    step = before = 0.0
    for _ in range(MOST - 1):
        middle = (low + high) / 2
        least = 1.4832396974191326e-08 * abs(best) + tolerance / 3
        if abs(best - middle) <= 2 * least - (high - low) / 2:
            break
        golden = True
        if abs(before) > least:
            r = (best - second) * (lowest - third_lowest)
            q = (best - third) * (lowest - next_lowest)
            p = (best - third) * q - (best - second) * r
            q = 2 * (q - r)
            p, q = (-p, q) if q > 0 else (p, -q)
            r, before = before, step
            if abs(p) < abs(q * r / 2) and q * (low - best) < p < q * (high - best):
                golden, step = False, p / q
                if best + step - low < 2 * least or high - best - step < 2 * least:
                    step = math.copysign(least, middle - best)
        if golden:
            before = low - best if best >= middle else high - best
            step = GOLDEN * before
        x = best + math.copysign(max(abs(step), least), step)
        value = float(function(x))
        if value <= lowest:
            low, high = (best, high) if x >= best else (low, best)
            best, second, third = x, best, second
            lowest, next_lowest, third_lowest = value, lowest, next_lowest
            continue
        low, high = (x, high) if x < best else (low, x)
        if value <= next_lowest or second == best:
            second, third = x, second
            next_lowest, third_lowest = value, next_lowest
        elif value <= third_lowest or third in (best, second):
            third, third_lowest = x, value
    return best, lowest
