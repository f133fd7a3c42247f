"""Tails of distributions, against `scipy.special`."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import special

from hydroopt.tails import chi_square, fisher, normal, student_quantile


def test_tails_are_those_of_scipy() -> None:
    rng = np.random.default_rng(0)
    for k, below, x in zip(10 ** rng.uniform(-0.3, 3, 300), 10 ** rng.uniform(0.2, 7, 300), rng.uniform(0.01, 4, 300),
                           strict=True):
        assert chi_square(k, k * x) == pytest.approx(float(special.chdtrc(k, k * x)), rel=1e-9, abs=1e-280)
        assert fisher(k, below, x) == pytest.approx(float(special.fdtrc(k, below, x)), rel=1e-6, abs=1e-200)
        assert normal(5 * x) == pytest.approx(float(special.ndtr(-5 * x)), rel=1e-12)


def test_quantiles_are_those_of_scipy() -> None:
    freedom = np.logspace(-1.6, 9, 400)
    np.testing.assert_allclose(student_quantile(freedom), special.stdtrit(freedom, 0.975), rtol=1e-10)


def test_hardly_any_freedom_gives_a_wide_interval_and_no_overflow() -> None:
    assert np.all(student_quantile(np.array([0.0, 1e-4, 0.01])) > 1e60)


def test_ends() -> None:
    assert chi_square(3, 0.0) == 1.0
    assert chi_square(3, np.inf) == 0.0
    assert chi_square(0, 1.0) == 0.0
    assert np.isnan(chi_square(3, np.nan))
    assert np.isnan(fisher(2, 3, np.nan))
    assert fisher(2, 3, 0.0) == 1.0
    assert fisher(2, 3, np.inf) == 0.0
    assert fisher(40, 1e9, 1.2) == pytest.approx(float(special.fdtrc(40, 1e9, 1.2)), rel=1e-6)
