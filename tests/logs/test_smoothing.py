import time

import numpy as np
import pytest

from hydroopt.errors import LogError, ProblemError
from hydroopt.logs.smoothing import Butterworth, Fourier, SmoothingSpline, condition
from hydroopt.machine.sensors import Sensor

SENSOR = Sensor(channels=("boom.q",), accuracy=np.deg2rad(0.1), resolution=2 * np.pi / 2**14)
NOISE = SENSOR.std


def sines(t, seed=0):
    """Position, velocity and acceleration of four sines."""
    phase = np.random.default_rng(seed).uniform(0, 2 * np.pi, 4)
    w = 2 * np.pi * np.array([0.1, 0.23, 0.37, 0.6])
    x = np.outer(t, w) + phase
    return 0.3 * np.sin(x).sum(1), (0.3 * w * np.cos(x)).sum(1), (-0.3 * w**2 * np.sin(x)).sum(1)


def rest_move_rest(t):
    s = np.clip((t - 5) / 4, 0, 1)
    return (0.8 * (10 * s**3 - 15 * s**4 + 6 * s**5), 0.2 * (30 * s**2 - 60 * s**3 + 30 * s**4),
            0.05 * (60 * s - 180 * s**2 + 120 * s**3))


def rms(x):
    return float(np.sqrt(np.mean(x**2)))


T = np.arange(1650) / 50


@pytest.mark.parametrize("noise", [NOISE, None], ids=["stated", "cross-validated"])
@pytest.mark.parametrize(("motion", "velocity", "acceleration"), [
    (sines, 0.0035, 0.05), (rest_move_rest, 0.0012, 0.008)])
def test_derivatives_of_noisy_motion(noise, motion, velocity, acceleration):
    q, qd, qdd = motion(T)
    made = condition(T, SENSOR.read(q, np.random.default_rng(2)), None, SmoothingSpline(), noise)
    inner = made.interior
    assert inner.mean() > 0.9
    assert rms(made.q[inner, 0] - q[inner]) < 0.5 * NOISE
    assert rms(made.qd[inner, 0] - qd[inner]) < velocity
    assert rms(made.qdd[inner, 0] - qdd[inner]) < acceleration
    assert 0.3 < made.bandwidth[0] < 5
    assert "bandwidth" in made.notes[0]


def test_clean_data_are_differentiated_almost_exactly():
    q, qd, qdd = sines(T)
    made = condition(T, q, noise=0.0)
    inner = slice(50, -50)
    np.testing.assert_allclose(made.qd[inner, 0], qd[inner], atol=1e-6)
    np.testing.assert_allclose(made.qdd[inner, 0], qdd[inner], atol=1e-4)


def test_irregular_stamps_are_used_as_they_are():
    rng = np.random.default_rng(3)
    t = np.sort(rng.uniform(0, 33, 1650))
    q, qd, _ = sines(t)
    made = condition(t, q + rng.normal(0, NOISE, t.size), noise=NOISE)
    assert rms((made.qd[:, 0] - qd)[made.interior]) < 0.005


def test_a_fast_log_is_smoothed_like_a_slow_one():
    t = np.arange(0, 20, 0.001)
    q, _, qdd = sines(t)
    made = condition(t, q + np.random.default_rng(4).normal(0, NOISE, t.size), noise=NOISE)
    assert rms((made.qdd[:, 0] - qdd)[made.interior]) < 0.03


def test_segments_share_their_weight_alone():
    q = sines(T)[0]
    segment = (T >= 15).astype(int)
    small, large = (condition(T, q + jump * segment, segment, noise=NOISE) for jump in (2.0, 200.0))
    np.testing.assert_allclose(small.qdd, large.qdd, atol=1e-6)
    assert np.max(np.abs(small.qd)) < 3


def test_polynomials_of_second_order_pass_unchanged():
    made = condition(T, np.column_stack([np.ones_like(T), 1 + 0.1 * T, 0.005 * T**2]), noise=[1e-3] * 3)
    np.testing.assert_allclose(made.qdd, np.tile([0.0, 0.0, 0.01], (T.size, 1)), atol=1e-5)


def test_a_wrong_noise_statement_is_noticed():
    made = condition(T, SENSOR.read(sines(T)[0], np.random.default_rng(5)), noise=NOISE / 10)
    assert "does not agree" in made.notes[0] or made.bandwidth[0] > 5


def test_time_grows_with_the_number_of_samples_only():
    t = np.arange(20_000) / 50
    q = np.column_stack([sines(t, seed)[0] for seed in range(3)])
    noisy = SENSOR.read(q, np.random.default_rng(6))
    begin = time.perf_counter()
    condition(t, noisy, noise=[NOISE] * 3)
    assert time.perf_counter() - begin < 5


def test_fourier_recovers_a_periodic_motion_across_a_gap():
    t = np.concatenate([T[:700], T[900:]])
    w = 2 * np.pi / 10
    q = 0.2 + 0.5 * np.sin(w * t) - 0.1 * np.cos(3 * w * t)
    made = condition(t, q, np.repeat([0, 1], [700, t.size - 700]), Fourier(10.0, 4))
    np.testing.assert_allclose(made.qd[:, 0], 0.5 * w * np.cos(w * t) + 0.3 * w * np.sin(3 * w * t),
                               atol=1e-12)
    np.testing.assert_allclose(made.qdd[:, 0], -0.5 * w**2 * np.sin(w * t) + 0.9 * w**2 * np.cos(3 * w * t),
                               atol=1e-12)


def test_butterworth_has_no_phase_lag():
    w = 2 * np.pi * 0.3
    made = condition(T, np.sin(w * T), None, Butterworth(5.0))
    inner = slice(200, -200)
    np.testing.assert_allclose(made.qd[inner, 0], w * np.cos(w * T[inner]), atol=2e-4)
    np.testing.assert_allclose(made.qdd[inner, 0], -(w**2) * np.sin(w * T[inner]), atol=2e-3)


@pytest.mark.parametrize(("smoothing", "t", "error", "word"), [
    (SmoothingSpline(), T[:8], LogError, "samples 1 to 8"),
    (Butterworth(2.0), T[:20], LogError, "too short"),
    (Butterworth(2.0), T**1.3, LogError, "irregular"),
    (Butterworth(30.0), T, ProblemError, "cutoff"),
    (Fourier(40.0, 3), T, LogError, "period of 40 s"),
    (Fourier(1.0, 25), T, ProblemError, "half the sampling rate"),
    (Fourier(1.0, 0), T, ProblemError, "does not define a Fourier series"),
    (SmoothingSpline(), T[::-1], LogError, "do not increase")])
def test_what_cannot_be_done_is_refused(smoothing, t, error, word):
    with pytest.raises(error, match=word):
        condition(t, np.sin(t), None, smoothing)


def test_a_joint_without_stated_noise_is_cross_validated_alone():
    noisy = SENSOR.read(np.column_stack([sines(T)[0], sines(T, 1)[0]]), np.random.default_rng(7))
    made = condition(T, noisy, noise=[np.nan, NOISE])
    assert "from cross-validation" in made.notes[0]
    assert "from the stated noise" in made.notes[1]
    np.testing.assert_array_equal(made.qd[:, 0], condition(T, noisy[:, 0]).qd[:, 0])
    np.testing.assert_array_equal(made.qd[:, 1], condition(T, noisy[:, 1], noise=NOISE).qd[:, 0])


@pytest.mark.parametrize("noise", [-1.0, np.inf])
def test_impossible_noise_is_refused(noise):
    with pytest.raises(ProblemError, match="negative or infinite"):
        condition(T, np.sin(T), noise=noise)


@pytest.mark.parametrize("bandwidth", [1e-9, 0.9 / 30])
def test_a_bandwidth_that_leaves_nothing_of_the_motion_is_refused(bandwidth):
    with pytest.raises(ProblemError, match=r"leaves nothing.*state one above 0\.03"):
        condition(T, np.sin(T), None, SmoothingSpline(bandwidth=bandwidth))


def test_a_nan_is_refused():
    with pytest.raises(LogError, match="not finite"):
        condition(T, np.where(T == 1, np.nan, T))
