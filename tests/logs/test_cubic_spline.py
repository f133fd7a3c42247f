"""Cubic splines through samples, beside SciPy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

from hydroopt.logs.cubic_spline import CubicSpline


@pytest.mark.parametrize("count", [4, 5, 40])
def test_it_is_that_of_scipy(count: int) -> None:
    rng = np.random.default_rng(count)
    t = np.cumsum(rng.uniform(0.2, 2.0, count))
    values = rng.standard_normal((count, 3, 2))
    times = np.concatenate([t, rng.uniform(t[0] - 0.1, t[-1] + 0.1, 50)])
    theirs = make_interp_spline(t, values, k=3)(times)
    assert CubicSpline(t, values)(times) == pytest.approx(theirs, rel=1e-9, abs=1e-9)
