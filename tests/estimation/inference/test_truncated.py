"""Marginal distributions of a truncated Gaussian, against eigenvalues and SciPy's truncated normal distribution."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import truncnorm

from hydroopt.estimation.inference.truncated import TruncatedGaussian, chords, marginals
from hydroopt.estimation.inference.whitening import GaussianPosterior

MATRICES, SINGLE, SUMS, SAMPLES = 3, 2, 4, 8
UPPER = np.triu_indices(4)


def ends(matrices: np.ndarray, along: np.ndarray, single: np.ndarray, slope: np.ndarray) -> tuple[float, float]:
    """How far a step along a direction leads down and up until a condition (matrices (m, 4, 4), numbers (k,)) ends."""
    rates = [slope / single]
    for matrix, change in zip(matrices, along, strict=True):
        inverse = np.linalg.inv(np.linalg.cholesky(matrix))
        rates.append(np.linalg.eigvalsh(inverse @ change @ inverse.T))
    every = np.concatenate(rates)
    return 1 / max(every.max(), 0.01), 1 / max(-every.min(), 0.01)


@pytest.mark.parametrize(("far", "thin"), [(0.0, 1.0), (-12.0, 1.0), (12.0, 1.0), (0.0, 1e-4)])
def test_they_are_means_of_truncated_normal_distributions(far: float, thin: float) -> None:
    """In thin bodies, all samples but one change as little as they have; that one is at its edge."""
    rng = np.random.default_rng(int(abs(far)))
    factors, size = rng.standard_normal((MATRICES, SAMPLES, 4, 5)), np.array([1.0, 1.0, thin, thin])
    factors[0] *= size[:, None]
    factors[1, 0, -1] *= thin
    bodies, single = factors @ factors.swapaxes(2, 3), rng.exponential(size=(SINGLE, SAMPLES))
    along = rng.standard_normal((SUMS, MATRICES, 4, 4))
    along += along.swapaxes(2, 3)
    along[:, 0] *= np.outer(size, size)
    along[0], slope = 0.0, rng.standard_normal((SUMS, SINGLE))  # by single conditions alone
    at = far + rng.standard_normal((SUMS, SAMPLES))
    slack = np.concatenate([bodies[..., *UPPER].transpose(2, 0, 1).reshape(10 * MATRICES, SAMPLES), single])
    changes = np.concatenate([along[..., *UPPER].transpose(0, 2, 1).reshape(SUMS, 10 * MATRICES), slope], axis=1)
    down, up = chords(slack, changes, MATRICES)
    exact = np.array([[ends(bodies[:, i], along[n], single[:, i], slope[n]) for i in range(SAMPLES)]
                      for n in range(SUMS)])
    np.testing.assert_allclose(np.stack([down, up], axis=-1), exact, rtol=1e-7)
    found = marginals(at, down, up, SAMPLES)
    for n in range(SUMS):
        parts = [truncnorm(t - less, t + more) for t, less, more in zip(at[n], down[n], up[n], strict=True)]
        mean, square = (np.mean([one.moment(order) for one in parts]) for order in (1, 2))
        assert found.mean[n] == pytest.approx(mean, abs=1e-8)
        assert found.std[n] == pytest.approx(np.sqrt(square - mean**2), abs=1e-8)
        for q, wanted in zip(found.interval[n], (0.025, 0.975), strict=True):
            place = brentq(lambda x, parts=parts, wanted=wanted: np.mean([one.cdf(x) for one in parts]) - wanted,
                           far - 20, far + 20, xtol=1e-9)
            assert q == pytest.approx(place, abs=1e-6)


def test_a_sum_is_exact_where_nothing_else_cuts_it_off() -> None:
    rng = np.random.default_rng(0)
    gaussian = GaussianPosterior(np.array([1.0, 2.0]), np.array([[3.0, 0.0], [1.0, 2.0]]), np.eye(2), np.zeros(2))
    z = np.array([truncnorm.rvs(-0.5, np.inf, size=64, random_state=rng), rng.standard_normal(64)])
    samples = (gaussian.offset[:, None] + gaussian.slope @ z).T
    subject = TruncatedGaussian(gaussian, np.array([[1.0, 0.0]]), 0)
    exact = truncnorm(-0.5, np.inf, loc=1.0, scale=3.0)
    found = subject.marginal(samples, z[:1] + 0.5, np.array([[1.0, 0.0], [0.0, 0.0]]), 64)
    assert found.mean == pytest.approx([exact.mean(), 0.0], abs=1e-6)
    assert found.std == pytest.approx([exact.std(), 0.0], abs=1e-6)
    assert found.interval == pytest.approx(np.array([exact.ppf([0.025, 0.975]), [0.0, 0.0]]), abs=1e-6)
