"""The linear estimators against certified numbers and other ways to the same answer."""

from __future__ import annotations

import numpy as np
import pytest

from hydroopt.estimation.inference import least_squares
from hydroopt.estimation.inference.identifiability import analyse
from hydroopt.parameters.parameter_set import ParameterKind, ParameterSet

# NIST Statistical Reference Datasets, Longley (1967): employment y and six regressors that are nearly collinear
LONGLEY = np.array([
    [60323, 83.0, 234289, 2356, 1590, 107608, 1947], [61122, 88.5, 259426, 2325, 1456, 108632, 1948],
    [60171, 88.2, 258054, 3682, 1616, 109773, 1949], [61187, 89.5, 284599, 3351, 1650, 110929, 1950],
    [63221, 96.2, 328975, 2099, 3099, 112075, 1951], [63639, 98.1, 346999, 1932, 3594, 113270, 1952],
    [64989, 99.0, 365385, 1870, 3547, 115094, 1953], [63761, 100.0, 363112, 3578, 3350, 116219, 1954],
    [66019, 101.2, 397469, 2904, 3048, 117388, 1955], [67857, 104.6, 419180, 2822, 2857, 118734, 1956],
    [68169, 108.4, 442769, 2936, 2798, 120445, 1957], [66513, 110.8, 444546, 4681, 2637, 121950, 1958],
    [68655, 112.6, 482704, 3813, 2552, 123366, 1959], [69564, 114.2, 502601, 3931, 2514, 125368, 1960],
    [69331, 115.7, 518173, 4806, 2572, 127852, 1961], [70551, 116.9, 554894, 4007, 2827, 130081, 1962]])
CERTIFIED = np.array([
    [-3482258.63459582, 890420.383607373], [15.0618722713733, 84.9149257747669],
    [-0.358191792925910e-01, 0.334910077722432e-01], [-2.02022980381683, 0.488399681651699],
    [-1.03322686717359, 0.214274163161675], [-0.511041056535807e-01, 0.226073200069370],
    [1829.15146461355, 455.478499142212]])
RESIDUAL_STD = 304.854073561965


def test_longley_has_the_certified_values_and_standard_errors() -> None:
    X, y = np.column_stack([np.ones(16), LONGLEY[:, 1:]]), LONGLEY[:, 0]
    triangle = np.linalg.qr(np.column_stack([X, y]), mode="r")
    psi, covariance, found = least_squares.base_least_squares(triangle[:7, :7], triangle[:7, 7], tuple("ABCDEFG"),
                                                              1e-12)
    assert found.rank == 7
    assert abs(triangle[7, 7]) / 3 == pytest.approx(RESIDUAL_STD, rel=1e-9)
    np.testing.assert_allclose(psi, CERTIFIED[:, 0], rtol=1e-8)
    np.testing.assert_allclose(RESIDUAL_STD * np.sqrt(np.diag(covariance)), CERTIFIED[:, 1], rtol=1e-8)


@pytest.fixture
def dependent() -> tuple[np.ndarray, np.ndarray]:
    """A regressor (60, 9) with columns of very different size, two dependent ones and one of zeros."""
    rng = np.random.default_rng(5)
    K = rng.standard_normal((60, 9)) * np.logspace(-3, 3, 9)
    K[:, 4], K[:, 6], K[:, 7] = 2 * K[:, 0] - K[:, 1], K[:, 3] + K[:, 5], 0
    return K, rng.standard_normal(60)


NAMES = tuple("abcdefghi")


def test_base_least_squares_predicts_what_the_pseudo_inverse_predicts(dependent: tuple) -> None:
    K, f = dependent
    psi, covariance, found = least_squares.base_least_squares(K, f, NAMES)
    assert found.rank == 6
    left, s, _ = np.linalg.svd(K / np.maximum(np.linalg.norm(K, axis=0), 1e-300), full_matrices=False)
    span = left[:, s > 1e-8]
    np.testing.assert_allclose(K @ psi, span @ (span.T @ f), atol=1e-10)
    assert np.all(psi[[k for k in range(9) if k not in found.basis]] == 0)
    np.testing.assert_allclose(covariance, np.linalg.inv(K[:, found.basis].T @ K[:, found.basis]), rtol=1e-6)


def test_individual_values_are_given_to_none_but_the_identifiable(dependent: tuple) -> None:
    K, f = dependent
    value, std = least_squares.individual_values(*least_squares.base_least_squares(K, f, NAMES))
    assert [NAMES[k] for k in np.flatnonzero(np.isfinite(value))] == ["c", "i"]
    np.testing.assert_array_equal(np.isfinite(value), np.isfinite(std))


@pytest.mark.parametrize("strength", [1e-8, 1e-3, 0.5])
def test_ridge_is_least_squares_with_pseudo_measurements_of_zero(dependent: tuple, strength: float) -> None:
    K, f = dependent
    lengths = np.where(np.any(K, axis=0), np.linalg.norm(K, axis=0), 1.0)
    damping = np.sqrt(strength) * np.linalg.norm(K / lengths, 2)
    stacked = np.vstack([K / lengths, damping * np.eye(9)])
    expected = np.linalg.lstsq(stacked, np.concatenate([f, np.zeros(9)]), rcond=None)[0] / lengths
    np.testing.assert_allclose(least_squares.ridge(K, f, strength)[0] * lengths, expected * lengths, rtol=1e-6,
                               atol=1e-12 * np.linalg.norm(f))  # the column of zeros has no more than rounding


def test_ridge_chooses_the_strength_that_predicts_each_sample_best_from_the_rest() -> None:
    rng = np.random.default_rng(2)
    K = rng.standard_normal((40, 12)) @ rng.standard_normal((12, 12))
    K /= np.linalg.norm(K, axis=0)
    f = K @ rng.standard_normal(12) + 0.5 * rng.standard_normal(40)

    def score(strength: float) -> float:
        hat = K @ np.linalg.solve(K.T @ K + strength * np.linalg.norm(K, 2) ** 2 * np.eye(12), K.T)
        return float(np.sum((f - hat @ f) ** 2) / (40 - np.trace(hat)) ** 2)

    chosen = least_squares.ridge(K, f)[1].of_largest
    assert score(chosen) <= min(score(s) for s in np.logspace(-12, 0, 400)) * (1 + 1e-3)


@pytest.mark.parametrize("strength", [1e-8, 1e-3])
def test_ridge_compares_its_strength_with_the_smallest_eigenvalue_that_is_not_zero(dependent: tuple,
                                                                                 strength: float) -> None:
    K, f = dependent
    unit = K / np.where(np.any(K, axis=0), np.linalg.norm(K, axis=0), 1.0)
    values = np.linalg.eigvalsh(unit.T @ unit)[::-1]
    smallest = values[np.linalg.matrix_rank(unit) - 1]
    assert 0 < smallest < values[0]
    found = least_squares.ridge(K, f, strength)[1]
    assert found.of_largest == strength
    assert found.of_smallest == pytest.approx(strength * values[0] / smallest)


@pytest.mark.parametrize("tolerance", [1e-8, 0.2])
def test_truncated_svd_is_the_pseudo_inverse_of_the_scaled_columns(dependent: tuple, tolerance: float) -> None:
    K, f = dependent
    lengths = np.where(np.any(K, axis=0), np.linalg.norm(K, axis=0), 1.0)
    psi, kept = least_squares.truncated_svd(K, f, tolerance)
    np.testing.assert_allclose(psi, np.linalg.pinv(K / lengths, rcond=tolerance) @ f / lengths, rtol=1e-8, atol=1e-12)
    assert kept == np.linalg.matrix_rank(K / lengths, tol=tolerance * np.linalg.norm(K / lengths, 2))


def test_nearest_keeps_the_base_parameters_and_no_other_point_is_nearer(dependent: tuple) -> None:
    K, f = dependent
    rng = np.random.default_rng(8)
    nominal, scale = rng.standard_normal(9), rng.uniform(0.5, 2.0, 9)
    parameters = ParameterSet(
        NAMES, (ParameterKind.COEFFICIENT,) * 9, ("1",) * 9, nominal, np.full(9, -np.inf), np.full(9, np.inf), scale,
        np.zeros((9, 9))
    )
    found = analyse(K, NAMES)
    psi = np.linalg.lstsq(K, f, rcond=None)[0]
    near = least_squares.nearest(parameters, found, psi)
    base = found.grouping @ psi
    np.testing.assert_allclose(found.grouping @ near, base, rtol=1e-9, atol=1e-9 * np.max(np.abs(base)))

    free = np.linalg.svd(found.grouping)[2][found.rank:].T
    slope = free.T @ ((near - nominal) / scale**2)  # of the squared distance, along all that leaves the base alone
    np.testing.assert_allclose(slope, 0, atol=1e-9 * np.max(np.abs((near - nominal) / scale**2)))
