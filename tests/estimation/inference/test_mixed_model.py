"""The mixed model against closed forms of balanced designs, dense generalised least squares, and draws."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from hydroopt.estimation.inference.mixed_model import MixedModel, projected, variance_components


def sessions(count: int, error: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """One common value, and one of its own for each later session; each session measures its value once."""
    return np.full((count, 1), 1 / error), np.eye(count)[:, 1:] / error, np.eye(count) / error


def test_a_step_of_a_balanced_design_is_the_difference_of_means() -> None:
    """Means of the sessions before and after; its variance is (κ² + σ²)·(1/n₁ + 1/n₂)."""
    error, before, after = 0.2, 3, 4
    rng = np.random.default_rng(2)
    measured = 0.5 * rng.standard_normal(before + after) + 2.0 * (np.arange(before + after) >= before)
    common, own, random = sessions(before + after, error)
    found = projected(common, own, measured / error, np.ones(own.shape[1]))
    model = MixedModel(found.sums, found.left, np.full(before + after, np.inf),
                       (found.left.T @ (random - random.mean(axis=0)),))
    step = found.effects[:, before - 1 :].sum(axis=1, keepdims=True)
    components = model.components(step)
    fixed = model.fixed(step, np.linalg.norm(step, axis=0), components)
    value, std, _ = fixed.along(fixed.units)
    assert value[0] == pytest.approx(measured[before:].mean() - measured[:before].mean(), rel=1e-9)
    assert std[0] ** 2 == pytest.approx((components.variance[0] + error**2) * (1 / before + 1 / after), rel=1e-9)
    # analysis of variance: κ² + σ² is the mean square within the groups, which the interval contains
    within = np.sum((measured[:before] - measured[:before].mean()) ** 2)
    within += np.sum((measured[before:] - measured[before:].mean()) ** 2)
    low, high = components.interval[0]
    assert low**2 < within / (before + after - 2) - error**2 < high**2


def test_effects_are_those_of_dense_generalised_least_squares() -> None:
    rng = np.random.default_rng(3)
    X, D, y = rng.standard_normal((30, 4)), rng.standard_normal((30, 10)), rng.standard_normal(30)
    model = MixedModel(y, np.eye(30), np.full(30, np.inf), (D,))
    components = model.components(X)
    fixed = model.fixed(X, np.linalg.norm(X, axis=0), components)
    V = np.eye(30) + components.variance[0] * D @ D.T
    covariance = np.linalg.inv(X.T @ np.linalg.solve(V, X))
    value, std, _ = fixed.along(fixed.units)
    assert value == pytest.approx(covariance @ X.T @ np.linalg.solve(V, y), rel=1e-9)
    assert std == pytest.approx(np.sqrt(np.diag(covariance)), rel=1e-9)


def test_variances_of_two_groups_are_told_apart() -> None:
    rng = np.random.default_rng(4)
    first, second = 20 * rng.standard_normal((60, 30)), 20 * rng.standard_normal((60, 30))
    blocks = [(rng.standard_normal(60) + 0.3 * first @ rng.standard_normal(30), [first, second]) for _ in range(4)]
    found = variance_components(blocks)
    assert found.variance[0] ** 0.5 == pytest.approx(0.3, rel=0.2)
    assert found.variance[1] ** 0.5 < 0.02
    assert found.p_value < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("truth", [0.0, 0.05, 0.3])
def test_the_interval_of_a_variance_holds(truth: float) -> None:
    """Twelve effects, whose errors are a hundredth of the friction force."""
    rng, inside = np.random.default_rng(5), []
    for _ in range(400):
        right = rng.standard_normal(12) + 100 * truth * rng.standard_normal(12)
        low, high = variance_components([(right, [100 * np.eye(12)])]).interval[0]
        inside.append(low <= truth <= high)
    assert np.sum(~np.array(inside)) <= stats.binom(400, 0.05).ppf(0.999)
