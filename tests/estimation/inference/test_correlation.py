"""Correlation times against the exact ones of known processes."""

import numpy as np
import pytest
from scipy.signal import lfilter

from hydroopt.estimation.inference.correlation import correlation_time

ONE = np.zeros(40_000, int)


def autoregressive(a: float, seed: int = 1) -> np.ndarray:
    return lfilter([1.0], [1.0, -a], np.random.default_rng(seed).standard_normal(len(ONE)))


@pytest.mark.parametrize("a", [0.0, 0.5, 0.9])
def test_first_order_process(a: float) -> None:
    taken = np.ones(len(ONE), bool)
    assert correlation_time(autoregressive(a), taken, ONE) == pytest.approx((1 + a) / (1 - a), rel=0.15)


def test_alternating_noise_is_not_worth_more_than_white() -> None:
    assert correlation_time(autoregressive(-0.6), np.ones(len(ONE), bool), ONE) == 1.0


def test_excluded_plateaus_leave_no_trace() -> None:
    noise = np.random.default_rng(2).standard_normal(len(ONE))
    still = (np.arange(len(ONE)) // 500) % 4 == 0
    spoilt = noise + 50.0 * still
    assert correlation_time(spoilt, ~still, ONE) == pytest.approx(1.0, abs=0.2)
    assert correlation_time(spoilt, np.ones(len(ONE), bool), ONE) > 50


def test_stretches_are_kept_apart() -> None:
    whole = autoregressive(0.8)
    stretches = np.arange(len(ONE)) // 2000
    order = np.random.default_rng(3).permutation(20)
    shuffled = np.concatenate([whole[2000 * k : 2000 * (k + 1)] for k in order])
    taken = np.ones(len(ONE), bool)
    assert correlation_time(shuffled, taken, stretches) == pytest.approx(9.0, rel=0.15)


def test_too_few_samples_count_as_white() -> None:
    taken = np.zeros(len(ONE), bool)
    assert correlation_time(autoregressive(0.9), taken, ONE) == 1.0
