"""Marginal distributions of a truncated Gaussian, against SciPy's truncated normal distribution."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import truncnorm

from hydroopt.estimation.inference import truncated
from hydroopt.estimation.inference.truncated import TruncatedGaussian
from hydroopt.estimation.inference.whitening import GaussianPosterior
from hydroopt.kernels.marginals import TILE


def test_a_sum_is_exact_where_nothing_else_cuts_it_off(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(0)
    gaussian = GaussianPosterior(np.array([1.0, 2.0]), np.array([[3.0, 0.0], [1.0, 2.0]]), np.eye(2), np.zeros(2))
    z = np.array([truncnorm.rvs(-0.5, np.inf, size=8 * TILE, random_state=rng), rng.standard_normal(8 * TILE)])
    samples = (gaussian.offset[:, None] + gaussian.slope @ z).T
    subject = TruncatedGaussian(gaussian, np.array([[1.0, 0.0]]), 0)
    exact = truncnorm(-0.5, np.inf, loc=1.0, scale=3.0)
    rows = np.array([[1.0, 0.0], [0.0, 0.0]])
    found = subject.marginal(samples, z[:1] + 0.5, rows)
    assert found.mean == pytest.approx([exact.mean(), 0.0], abs=1e-6)
    assert found.std == pytest.approx([exact.std(), 0.0], abs=1e-6)
    assert found.interval == pytest.approx(np.array([exact.ppf([0.025, 0.975]), [0.0, 0.0]]), abs=1e-6)
    monkeypatch.setattr(truncated, "marginals", lambda *_: None)  # without a compiler
    own = subject.marginal(samples, z[:1] + 0.5, rows)
    assert own.interval == pytest.approx(np.quantile(rows @ samples.T, [0.025, 0.975], axis=1).T)
