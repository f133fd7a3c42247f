"""The Gaussian that stands in for a truncated one, against distributions that are known exactly."""

from __future__ import annotations

import numpy as np
import pytest

from hydroopt.estimation.inference.barrier import SYMMETRIC, interior
from hydroopt.estimation.inference.posterior import _settled

FAR = 1e3
"""Standard deviations from the mean to the edge: the density is then exponential."""


def test_exponential_density_at_an_edge() -> None:
    """z > FAR of a standard normal z is exponential above FAR with rate FAR; the other coordinate stays as it is."""
    found = interior(np.array([FAR + 1.0, 3.0]), lambda _: (np.zeros((0, 10)), np.zeros((0, 10, 2))),
                     lambda z: (z[:1] - FAR, np.array([[1.0, 0.0]])))
    covariance = found.root @ found.root.T
    assert found.centre[0] - FAR == pytest.approx(1 / FAR, rel=0.02)
    assert np.sqrt(covariance[0, 0]) == pytest.approx(1 / FAR, rel=0.02)
    assert found.centre[1] == pytest.approx(0.0, abs=0.02)
    assert covariance[1, 1] == pytest.approx(1.0)


def test_wishart_density_at_the_corner_of_all_matrices() -> None:
    """W = FAR·1 + z has the density exp(−FAR·tr W): Wishart with five degrees of freedom and scale 1/(2·FAR)."""
    start = np.eye(4)[np.triu_indices(4)]
    found = interior((1 + FAR) * start, lambda z: ((z - FAR * start)[None], np.eye(10)[None]),
                     lambda _: (np.zeros(0), np.zeros((0, 10))))
    mean, covariance = found.centre - FAR * start, found.root @ found.root.T
    np.testing.assert_allclose((SYMMETRIC @ mean).reshape(4, 4), 2.5 / FAR * np.eye(4), atol=0.05 / FAR)
    # of Wishart(5, 1/(2·FAR)): 2·5/(2·FAR)² on the diagonal, half of it beside
    np.testing.assert_allclose(np.diag(covariance), np.where(start == 1, 10, 5) / (2 * FAR) ** 2, rtol=0.04)


def test_ratio_of_densities() -> None:
    rng = np.random.default_rng(0)
    found = interior(np.array([2.0, 0.0]), lambda _: (np.zeros((0, 10)), np.zeros((0, 10, 2))),
                     lambda z: (np.array([z[0] + z[1] - 1.0]), np.ones((1, 2))))
    y = rng.standard_normal((2, 5))
    z = found.centre[:, None] + found.root @ y
    expected = 0.5 * np.sum(y**2, axis=0) - 0.5 * np.sum(z**2, axis=0)
    np.testing.assert_allclose(np.diff(found.log_ratio(y)), np.diff(expected), rtol=1e-9)


def test_chains_that_stay_in_place_have_not_settled() -> None:
    rng = np.random.default_rng(1)
    before, now = rng.standard_normal((2, 10, 128))
    assert _settled(before, now)
    assert not _settled(now, now)
    assert not _settled(before + 1, now)
