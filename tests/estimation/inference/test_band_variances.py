"""Variances by frequency against noise of known spectrum, and the tests and intervals that follow from them."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy import stats
from scipy.fft import dct

from hydroopt.estimation.inference.band_variances import (
    Channel,
    Shared,
    Spectrum,
    band_variances,
    combined,
    f_test,
    score_rows,
    students,
)

N, BANDS = 512, 8
EDGES = np.array([0, 8, 13, 21, 34, 64, 128, 256, N])
TIME = np.arange(N) / N
K = np.column_stack([np.ones(N), np.sin(2 * np.pi * 3 * TIME), np.cos(2 * np.pi * 7.3 * TIME), TIME])
TRUTH = np.array([1.0, -2.0, 0.5, 3.0])
SCALE = np.ones(4)
NO_PRIOR = (np.zeros((0, 4)), np.zeros(0))
LEAST = np.full(1, 1e-12)


def channel(f: np.ndarray) -> Channel:
    """The rows [K, f] by band."""
    turned = dct(np.column_stack([K, f]), axis=0, norm="ortho")
    rows = tuple(turned[a:b] for a, b in pairwise(EDGES))
    return Channel(np.arange(4), rows, np.diff(EDGES).astype(float))


def estimated(f: np.ndarray) -> tuple[np.ndarray, np.ndarray, Spectrum]:
    """Least squares, its standard deviations and the spectrum."""
    one = channel(f)
    (spectrum,) = band_variances([one], np.array([np.std(f)]), NO_PRIOR, SCALE, LEAST)
    T = score_rows(one, spectrum, SCALE).triangle(widened=True)
    R, r = T[:4, :4], T[:4, 4]
    return np.linalg.solve(R, r), np.linalg.norm(np.linalg.inv(R), axis=1), spectrum


def autoregressive(a: float, rng: np.random.Generator, count: int = N) -> np.ndarray:
    """First-order noise with innovations of variance 1."""
    noise = rng.normal(size=count + 100)
    for k in range(1, len(noise)):
        noise[k] += a * noise[k - 1]
    return noise[100:]


def test_white_noise_has_one_variance_and_the_intervals_of_least_squares() -> None:
    exact, rng, variances = 0.3 * np.sqrt(np.diag(np.linalg.inv(K.T @ K))), np.random.default_rng(1), []
    stds = []
    for _ in range(40):
        f = K @ TRUTH + 0.3 * rng.normal(size=N)
        value, std, spectrum = estimated(f)
        variances.append(spectrum.variance)
        np.testing.assert_allclose(value, np.linalg.lstsq(K, f, rcond=None)[0], rtol=1e-9)
        stds.append(std)
    np.testing.assert_allclose(np.mean(variances, axis=0), 0.09, rtol=0.15)
    assert np.all(np.mean(stds, axis=0) > exact)
    assert np.all(np.mean(stds, axis=0) < 1.25 * exact)


@pytest.mark.parametrize("a", [0.0, 0.8, -0.5])
@pytest.mark.slow
def test_intervals_hold_in_noise_of_any_colour(a: float) -> None:
    rng = np.random.default_rng(2)
    z = []
    for _ in range(150):
        value, std, _ = estimated(K @ TRUTH + autoregressive(a, rng))
        z.append((value - TRUTH) / std)
    coverage = np.mean(np.abs(z) < 1.96)
    assert 0.92 < coverage < 0.995, coverage
    assert 0.7 < np.sqrt(np.mean(np.square(z))) < 1.15  # neither too narrow nor needlessly wide


def test_the_information_is_that_of_the_sandwich() -> None:
    """Independent of decompositions: H⁻¹·J·H⁻¹ from dense matrices, where no direction's variance is at its floor."""
    one = channel(K @ TRUTH + np.random.default_rng(6).normal(size=N))
    spectrum = Spectrum(np.linspace(9.0, 2.0, BANDS), np.full(BANDS, 1e9), 1.0)
    rows = [block[:, :4] for block in one.rows]
    H = sum(row.T @ row for row in rows)
    J = sum(s * row.T @ row for s, row in zip(spectrum.variance, rows, strict=True))
    found = score_rows(one, spectrum, SCALE)
    np.testing.assert_allclose(np.linalg.inv(found.rows.T @ found.rows), np.linalg.inv(H) @ J @ np.linalg.inv(H),
                               rtol=1e-9, atol=1e-12)
    g = sum(block[:, :4].T @ block[:, 4] for block in one.rows)
    np.testing.assert_allclose(np.linalg.solve(found.rows, found.right), np.linalg.solve(H, g), rtol=1e-9)


def test_an_idle_channel_has_no_information() -> None:
    idle = Channel(np.arange(4), tuple(np.zeros((0, 5)) for _ in range(BANDS)), np.zeros(BANDS))
    found = score_rows(idle, Spectrum(np.ones(BANDS), np.ones(BANDS), 1.0), SCALE)
    np.testing.assert_array_equal(found.triangle(widened=True), 0)


def test_errors_that_rows_share_widen_only_what_they_move() -> None:
    one = channel(K @ TRUTH + 0.1 * np.random.default_rng(3).normal(size=N))
    (spectrum,) = band_variances([one], np.array([0.1]), NO_PRIOR, SCALE, LEAST)
    shared = Shared((K.T @ K[:, :1],), 0.5**2, 1e6)
    plain, wide = (np.linalg.inv(score_rows(one, spectrum, SCALE, extra).rows[:, :4]) for extra in ((), (shared,)))
    plain, wide = plain @ plain.T, wide @ wide.T
    assert wide[0, 0] == pytest.approx(plain[0, 0] + 0.25, rel=0.02)
    assert wide[1, 1] == pytest.approx(plain[1, 1], rel=0.3)


def test_hardly_any_freedom_gives_a_wide_interval_and_no_overflow() -> None:
    assert np.all(1 / students(np.array([0.0, 1e-4, 0.01])) > 1e60)
    np.testing.assert_allclose(students(np.array([1e12, np.inf])), 1.0, rtol=1e-6)


@pytest.mark.parametrize("freedom", [6.0, 30.0])
def test_the_f_test_holds_its_level(freedom: float) -> None:
    """Sums of rows whose one variance is estimated with so many degrees of freedom."""
    rng, count = np.random.default_rng(4), 4000
    k = 5
    p = []
    for _ in range(count):
        variance = rng.chisquare(freedom) / freedom
        sums = rng.normal(size=k) / np.sqrt(variance)
        p.append(f_test(sums, np.eye(k), np.full(k, freedom)).p_value)
    assert np.mean(np.array(p) < 0.05) < 0.075
    assert np.mean(np.array(p) < 0.05) > 0.02
    assert f_test(np.ones(k), np.eye(k), np.full(k, np.inf)).p_value == pytest.approx(stats.f.sf(1.0, k, 1e9), rel=1e-3)


def test_priors_have_no_uncertain_variance() -> None:
    shares = np.array([[0.5, 0.0], [0.5, 1.0]])
    np.testing.assert_allclose(combined(shares, np.array([8.0, np.inf])), [32.0, 1e9])


def test_priors_that_the_data_contradict_do_not_pass_for_residuals() -> None:
    rng = np.random.default_rng(7)
    one = channel(K @ TRUTH + 0.1 * rng.normal(size=N))
    for wrong in (0.0, 50.0):  # standard deviations
        prior = (np.eye(4) / 0.01, (TRUTH + 0.01 * wrong) / 0.01)
        (spectrum,) = band_variances([one], np.array([0.1]), prior, SCALE, LEAST)
        np.testing.assert_allclose(np.average(spectrum.variance[:3], weights=one.counts[:3]), 0.01, rtol=0.6)


@pytest.mark.parametrize("stated", [1.0, 2.0])
def test_rows_without_a_force_keep_the_variance_that_noise_of_them_makes(stated: float) -> None:
    """0 = (K + δ)·ψ is fitted best by ψ = 0, where residuals and their variance vanish; a weak prior does not help."""
    rng, psi, noise = np.random.default_rng(2), np.array([2.0, 1.0]), 0.1
    rows = np.outer(rng.normal(size=4 * N), [1.0, -2.0]) + noise * rng.normal(size=(4 * N, 2))
    one = Channel(np.arange(2), (np.column_stack([rows, np.zeros(4 * N)]),), np.array([4.0 * N]))
    prior = (np.diag(1 / (0.3 * psi)), np.full(2, 1 / 0.3))
    added = {0: 4 * N * (stated * noise) ** 2 * np.eye(2)}
    (right,), (left_out,) = (band_variances([one], np.array([0.2]), prior, psi, LEAST, given)
                             for given in (added, None))
    assert right.variance[0] == pytest.approx(noise**2 * psi @ psi, rel=0.15)
    assert right.noisy == pytest.approx(1 / stated**2, rel=0.15)
    assert left_out.variance[0] < 1e-3 * right.variance[0]
