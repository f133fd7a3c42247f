"""The filter with weights on the first and second derivatives, against dense normal equations and its response."""

from __future__ import annotations

import numpy as np
import pytest

from hydroopt.cli.options import smoothing_of
from hydroopt.errors import LogError, ProblemError
from hydroopt.logs.smoothing import TwoWeights, condition
from hydroopt.logs.two_weights import bandwidth, two_weights
from hydroopt.machine.machine_file import load_machine


def response(frequency: np.ndarray, speed: float, acceleration: float) -> np.ndarray:
    """Part of the amplitude of a motion that passes at these frequencies [Hz], for short steps."""
    omega = 2 * np.pi * frequency
    return np.asarray(1 / (1 + speed * omega**2 + acceleration * omega**4))


@pytest.mark.parametrize(("speed", "acceleration"), [(0.0, 1e-4), (0.02, 0.0), (3e-3, 2e-5)])
def test_it_solves_the_normal_equations(speed: float, acceleration: float) -> None:
    """Rows written one by one, solved dense."""
    rng = np.random.default_rng(1)
    t = np.cumsum(rng.uniform(0.01, 0.03, 60))
    y = rng.normal(size=(60, 2))
    mean, rows, right = np.mean(np.diff(t)), [], []
    for i in range(60):
        row = np.zeros(60)
        row[i] = np.sqrt(mean)
        rows.append(row)
        right.append(np.sqrt(mean) * y[i])
    for i in range(59):
        row = np.zeros(60)
        row[i], row[i + 1] = -1, 1
        rows.append(np.sqrt(speed * (t[i + 1] - t[i])) * row / (t[i + 1] - t[i]))
        right.append(np.zeros(2))
    for i in range(1, 59):
        row, half = np.zeros(60), (t[i + 1] - t[i - 1]) / 2
        row[i + 1] += 1 / (t[i + 1] - t[i])
        row[i] -= 1 / (t[i + 1] - t[i]) + 1 / (t[i] - t[i - 1])
        row[i - 1] += 1 / (t[i] - t[i - 1])
        rows.append(np.sqrt(acceleration * half) * row / half)
        right.append(np.zeros(2))
    A, b = np.array(rows), np.array(right)
    expected = np.linalg.solve(A.T @ A, A.T @ b)
    q, _, qdd = two_weights(t, y, speed, acceleration)
    np.testing.assert_allclose(q, expected, rtol=1e-10, atol=1e-12)
    if acceleration:
        scale = np.sqrt(acceleration * (t[2:] - t[:-2]) / 2)[:, None]
        np.testing.assert_allclose(qdd[1:-1], A[-58:] @ expected / scale, rtol=1e-8, atol=1e-9)


@pytest.mark.parametrize(("speed", "acceleration"), [(0.0, (2 * np.pi * 2.0) ** -4), (1e-3, 1e-5)])
@pytest.mark.parametrize("frequency", [0.5, 2.0, 5.0])
def test_a_sine_passes_with_the_stated_amplitude_and_without_delay(speed: float, acceleration: float,
                                                                   frequency: float) -> None:
    t = np.arange(8000) / 400
    omega = 2 * np.pi * frequency
    made = two_weights(t, np.sin(omega * t)[:, None], speed, acceleration)[:, 2000:-2000, 0]
    passed = float(response(np.array(frequency), speed, acceleration))
    inner = t[2000:-2000]
    waves = np.sin(omega * inner), omega * np.cos(omega * inner), -omega**2 * np.sin(omega * inner)
    for order, wave in enumerate(waves):
        np.testing.assert_allclose(made[order], passed * wave, atol=2e-3 * passed * omega**order)


def test_noise_is_that_of_the_response() -> None:
    weight, step, sigma = (2 * np.pi * 3.0) ** -4, 1 / 200, 0.01
    t = np.arange(60000) * step
    noise = np.random.default_rng(2).normal(0, sigma, (t.size, 1))
    made = two_weights(t, noise, 0.0, weight)[:, 1000:-1000, 0]
    frequency = np.linspace(0, 0.5 / step, 20001)
    for order in range(2):  # the acceleration's noise depends on how differences end at half the sampling rate
        passed = response(frequency, 0.0, weight) * (2 * np.pi * frequency) ** order
        expected = sigma * np.sqrt(2 * step * np.trapezoid(passed**2, frequency))
        assert np.std(made[order]) == pytest.approx(expected, rel=0.04)


def test_uniform_motion_passes_and_a_weight_on_speed_slows_it() -> None:
    t = np.arange(400) / 50
    exact = two_weights(t, (0.3 * t - 1)[:, None], 0.0, 1e-3)
    np.testing.assert_allclose(exact[:, :, 0], np.stack([0.3 * t - 1, 0 * t + 0.3, 0 * t]), atol=1e-8)
    assert np.mean(two_weights(t, (0.3 * t - 1)[:, None], 1.0, 0.0)[1]) < 0.25


@pytest.mark.parametrize(("speed", "acceleration"), [(0.0, 1e-4), (0.02, 0.0), (3e-3, 2e-5)])
def test_half_passes_at_the_bandwidth(speed: float, acceleration: float) -> None:
    assert float(response(np.array(bandwidth(speed, acceleration)), speed, acceleration)) == pytest.approx(0.5)


def test_it_is_selected_beside_the_spline() -> None:
    machine = load_machine("cat215b")
    assert smoothing_of("two-weights:0.001:2e-5", None, machine) == TwoWeights(0.001, 2e-5)
    with pytest.raises(ProblemError, match="takes no bandwidth"):
        smoothing_of("two-weights:0.001:2e-5", 2.0, machine)
    with pytest.raises(ProblemError, match="does not exist"):
        smoothing_of("two-weights:0.001", None, machine)
    t = np.concatenate([np.arange(100), np.arange(200, 300)]) / 50
    motion = condition(t, np.sin(t), np.repeat([0, 1], 100), TwoWeights(0.0, 1e-6))
    assert np.max(np.abs(motion.q[:, 0] - np.sin(t))) < 5e-3
    assert "two weights" in motion.notes[-1]


@pytest.mark.parametrize("weights", [(0.0, 0.0), (-1.0, 1.0), (float("nan"), 1.0), (1.0, float("inf"))])
def test_weights_that_are_none_are_refused(weights: tuple[float, float]) -> None:
    with pytest.raises(ProblemError, match="no weights of a filter"):
        condition(np.arange(100) / 50, np.zeros(100), smoothing=TwoWeights(*weights))


def test_a_stretch_that_is_too_short_is_refused() -> None:
    with pytest.raises(LogError, match="too short"):
        condition(np.arange(5) / 50, np.zeros(5), smoothing=TwoWeights(0.0, 1e-4))
