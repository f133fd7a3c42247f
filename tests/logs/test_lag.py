"""Readings with a first-order lag, against the exact response to sines and against the differential equation."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from hydroopt.logs.lag import lagged, slowed

T = np.sort(np.concatenate([np.arange(0, 10, 0.01), np.random.default_rng(1).uniform(0, 10, 50)]))


@pytest.mark.parametrize("lag", [1e-4, 0.005, 0.03, 0.2])
def test_a_sine_is_late_and_smaller_as_the_transfer_function_says(lag):
    omega = 2 * np.pi * 1.0
    gain = 1 / (1 + 1j * omega * lag)
    made = lagged(T, np.column_stack([np.sin(omega * T), np.cos(omega * T)]), lag)
    settled = 12 * lag < T
    wave = gain * np.exp(1j * omega * T)
    assert made[settled] == pytest.approx(np.column_stack([wave.imag, wave.real])[settled], abs=1e-3)


def test_it_solves_the_differential_equation_from_sample_to_sample():
    x = np.random.default_rng(2).normal(size=T.size)
    made = lagged(T, x, 0.05)
    solved = solve_ivp(lambda t, y: (np.interp(t, T, x) - y) / 0.05, (0, 2), made[:1], rtol=1e-9, atol=1e-11,
                       t_eval=T[T <= 2], max_step=0.002)
    assert solved.y[0] == pytest.approx(made[T <= 2], abs=1e-5)


def test_stretches_do_not_remember_one_another():
    segment = (T > 5).astype(int)
    made = lagged(T, np.where(segment, 100.0, 0.0) + T, 0.1, segment)
    assert made == pytest.approx(np.where(segment, 100.0, 0.0) + T - 0.1)


def test_a_slowed_reading_is_that_of_the_slower_sensor():
    x = np.sin(3 * T)
    assert slowed(T, lagged(T, x, 0.02), 0.02, 0.08) == pytest.approx(lagged(T, x, 0.08), abs=2e-3)
    assert slowed(T, x, 0.1, 0.05) is x
