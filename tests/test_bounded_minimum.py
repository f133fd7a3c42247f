"""The minimum between bounds, beside SciPy's of the same algorithm."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from hydroopt.bounded_minimum import bounded_minimum

FUNCTIONS: list[Callable[[float], float]] = [
    lambda x: (x - 0.3) ** 2, lambda x: np.cos(3 * x), lambda x: np.exp(-x), lambda x: abs(x - 0.7) ** 1.5, lambda x: x,
    lambda x: np.inf if x < 0 else np.sqrt(x + 0.1), lambda x: 1.0, lambda x: np.log1p((x - 0.5) ** 2) + 0.1 * x]


@pytest.mark.parametrize("function", FUNCTIONS)
@pytest.mark.parametrize(("low", "high"), [(-1.0, 2.0), (-10.0, 1.0), (0.2, 0.9)])
@pytest.mark.parametrize("tolerance", [1e-5, 0.03])
def test_it_is_that_of_scipy(function: Callable[[float], float], low: float, high: float, tolerance: float) -> None:
    places: tuple[list[float], list[float]] = [], []

    def noted(which: int, x: float) -> float:
        places[which].append(x)
        return function(x)

    x, value = bounded_minimum(lambda x: noted(0, x), low, high, tolerance)
    with np.errstate(invalid="ignore"):
        theirs = minimize_scalar(lambda x: noted(1, x), bounds=(low, high), method="bounded",
                                 options={"xatol": tolerance})
    assert (x, value) == (theirs.x, theirs.fun)
    assert places[0] == places[1]
