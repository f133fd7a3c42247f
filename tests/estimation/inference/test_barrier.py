"""The Gaussian that stands in for a truncated one, against distributions that are known exactly."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from hydroopt.estimation.inference import barrier
from hydroopt.estimation.inference.barrier import Interior, Matrices, Slack, interior
from hydroopt.estimation.inference.conditions import SYMMETRIC
from hydroopt.estimation.inference.posterior import _settled

FAR = 1e3
"""Standard deviations from the mean to the edge: the density is then exponential."""


def of_normal(start: np.ndarray, single: Slack, matrices: Callable[[np.ndarray], Matrices] | None = None,
              *more: np.ndarray) -> Interior:
    """What stands in for a standard normal z."""
    none = Matrices(np.zeros((0, 10)), np.zeros((0, 10, len(start))), np.zeros(0))
    found = interior((start, *more), np.eye(len(start)), np.zeros(len(start)), matrices or (lambda _: none), single)
    assert found is not None
    return found


def test_exponential_density_at_an_edge() -> None:
    """z > FAR of a standard normal z is exponential above FAR with rate FAR; the other coordinate stays as it is."""
    found = of_normal(np.array([FAR + 1.0, 3.0]), lambda z: (z[:1] - FAR, np.array([[1.0, 0.0]])))
    covariance = found.root @ found.root.T
    assert found.centre[0] - FAR == pytest.approx(1 / FAR, rel=0.02)
    assert np.sqrt(covariance[0, 0]) == pytest.approx(1 / FAR, rel=0.02)
    assert found.centre[1] == pytest.approx(0.0, abs=0.02)
    assert covariance[1, 1] == pytest.approx(1.0)


def test_another_start_is_taken_where_steps_from_the_first_do_not_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(barrier, "STEPS", 12)

    def single(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return z[:1] - FAR, np.array([[1.0, 0.0]])

    far, near = np.array([FAR + 1e-12, 3.0]), np.array([FAR + 1e-2, 3.0])
    assert of_normal(far, single).centre[0] - FAR < 0.1 / FAR  # each step at most doubles the distance to the edge
    assert of_normal(far, single, None, near).centre[0] - FAR == pytest.approx(1 / FAR, rel=0.02)
    assert interior([], np.eye(2), np.zeros(2), lambda _: pytest.fail("nothing to ask"), single) is None


def test_beside_a_barrier_that_is_almost_met_no_direction_is_wider_than_the_gaussian() -> None:
    """Curvatures of 1e22 and of 1, from which no step leads away: rounding of the large one made others negative."""
    slopes = np.random.default_rng(0).standard_normal((1, 40))
    found = of_normal(np.zeros(40), lambda _: (np.array([1e-10]), slopes))
    assert np.linalg.svd(found.root, compute_uv=False)[0] <= 1 + 1e-9


def test_wishart_density_at_the_corner_of_all_matrices() -> None:
    """W = FAR·1 + z has the density exp(−FAR·tr W): Wishart with five degrees of freedom and scale 1/(2·FAR)."""
    start = np.eye(4)[np.triu_indices(4)]
    found = of_normal((1 + FAR) * start, lambda _: (np.zeros(0), np.zeros((0, 10))),
                      lambda z: Matrices((z - FAR * start)[None], np.eye(10)[None], np.zeros(1)))
    mean, covariance = found.centre - FAR * start, found.root @ found.root.T
    np.testing.assert_allclose((SYMMETRIC @ mean).reshape(4, 4), 2.5 / FAR * np.eye(4), atol=0.05 / FAR)
    # of Wishart(5, 1/(2·FAR)): 2·5/(2·FAR)² on the diagonal, half of it beside
    np.testing.assert_allclose(np.diag(covariance), np.where(start == 1, 10, 5) / (2 * FAR) ** 2, rtol=0.04)


@pytest.mark.parametrize("weight", [2.0, 12.5])
def test_density_of_a_distance_alone(weight: float) -> None:
    """exp(−½κ·(tr W − log det W)) is Wishart with κ + 5 degrees of freedom and scale 1/κ, vague as it may be."""
    one, none = np.eye(4)[np.triu_indices(4)], np.zeros((1, 10))
    found = interior([one], none, np.zeros(1), lambda z: Matrices(z[None], np.eye(10)[None], np.array([weight])),
                     lambda _: (np.zeros(0), np.zeros((0, 10))))
    assert found is not None
    np.testing.assert_allclose(found.centre, (weight + 5) / weight * one, atol=0.01)
    of_wishart = np.where(one == 1, 2, 1) * (weight + 5) / weight**2
    np.testing.assert_allclose(np.diag(found.root @ found.root.T), of_wishart, rtol=0.02)


def test_ratio_of_densities() -> None:
    rng = np.random.default_rng(0)
    found = of_normal(np.array([2.0, 0.0]), lambda z: (np.array([z[0] + z[1] - 1.0]), np.ones((1, 2))))
    y = rng.standard_normal((2, 5))
    z = found.centre[:, None] + found.root @ y
    expected = 0.5 * np.sum(y**2, axis=0) - 0.5 * np.sum(z**2, axis=0)
    square, linear = found.ratio
    np.testing.assert_allclose(np.diff(square @ y**2 + linear @ y), np.diff(expected), rtol=1e-9)


def test_chains_that_stay_in_place_have_not_settled() -> None:
    rng = np.random.default_rng(1)
    before, now = rng.standard_normal((2, 10, 128))
    assert _settled(before, now)
    assert not _settled(now, now)
    assert not _settled(before + 1, now)
    now[3] = before[3]
    assert not _settled(before, now)
