"""Regulator and filter against python-control, and against what any other gains would cost."""

from __future__ import annotations

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import solve_discrete_lyapunov

from hydroopt.control.linear_system import LinearSystem, poles
from hydroopt.control.lqg import BANDWIDTH_SHARE, PROCESS_NOISE, Design, Lqg, design, reading_noise
from hydroopt.control.reference import Demand, Preview
from hydroopt.control.sampled_plant import Point, linearised, sampled
from hydroopt.control.sampled_plant import point as steady_point
from hydroopt.control.tuning import INTEGRAL_RATIO
from hydroopt.control.valve_inversion import Valves
from hydroopt.machine.machine_file import load_machine
from hydroopt.model.model import Model
from hydroopt.model.plant import Plant

PERIOD, BANDWIDTH = 0.01, np.array([2.0])


@pytest.fixture(scope="module")
def made() -> tuple[Design, LinearSystem, Valves, np.ndarray, Point]:
    plant = Plant(Model(load_machine("patu655_lift")))
    psi, theta = plant.model.parameters.nominal, plant.parameters.nominal
    lower, upper = plant.machine.link("lift").joint.range
    at = steady_point(plant, "middle", np.array([(lower + upper) / 2]), np.array([0.05]), psi, theta)
    held = sampled(linearised(plant, at, psi, theta), np.array([0.017]), PERIOD)
    valves, noise = Valves(plant, theta), reading_noise(plant)
    return design(held, at, valves, BANDWIDTH, noise), held, valves, noise, at


def weights(one: Design, at: Point) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A and B with the integral of the length's error, and Q, for speeds of weight one: written out here."""
    size = len(one.A)
    length = at.lever_arm @ one.C[:1]
    A = np.zeros((size + 1, size + 1))
    A[:size, :size], A[size, :size], A[size, size] = one.A, PERIOD * length[0], 1.0
    Q = np.zeros_like(A)
    Q[:size, :size] = (BANDWIDTH_SHARE * BANDWIDTH[0]) ** 2 * length.T @ length
    Q[size, size] = ((BANDWIDTH_SHARE * BANDWIDTH[0]) ** 2 / INTEGRAL_RATIO) ** 2
    return A, np.vstack([one.B, [[0.0]]]), Q


def test_regulator_solves_the_riccati_equation(made) -> None:
    one, _, _, _, at = made
    A, B, Q = weights(one, at)
    K, _, _ = control.dlqr(A, B, Q, np.eye(1))
    assert_allclose(one.feedback, K, rtol=1e-5, atol=1e-6 * np.abs(one.feedback).max())


def test_no_other_feedback_costs_less(made) -> None:
    """Cost from any start by Lyapunov's equation, which knows nothing of Riccati."""
    one, _, _, _, at = made
    A, B, Q = weights(one, at)

    def cost(K: np.ndarray) -> float:
        closed = A - B @ K
        assert np.max(np.abs(np.linalg.eigvals(closed))) < 1
        return float(np.trace(solve_discrete_lyapunov(closed.T, Q + K.T @ K)))

    least, rng = cost(one.feedback), np.random.default_rng(0)
    for _ in range(10):
        assert cost(one.feedback * (1 + 0.02 * rng.standard_normal(one.feedback.shape))) >= least * (1 - 1e-9)


def test_filter_solves_the_riccati_equation(made) -> None:
    one, _, _, noise, at = made
    disturbed = np.hstack([one.B * np.abs(at.speed), PROCESS_NOISE * np.eye(len(one.A))])
    scaled = one.C / noise[:, None]
    gain = control.dlqe(one.A, disturbed, scaled, np.eye(disturbed.shape[1]), np.eye(len(noise)))[0] / noise
    assert_allclose(one.filter * noise, gain * noise, rtol=1e-5, atol=1e-6 * np.abs(gain * noise).max())


def test_poles_are_those_of_regulator_and_filter(made) -> None:
    """Separation: about its own point the closed loop has the poles of A − B·K and of A − L·C."""
    one, held, valves, _, at = made
    A, B, _ = weights(one, at)
    apart = np.concatenate([np.linalg.eigvals(A - B @ one.feedback), np.linalg.eigvals(one.A - one.filter @ one.C)])
    none = np.zeros((1, 1))
    aim = Demand(none, none, none, Preview(none, none, none, none, np.zeros((1, 1, 2))))
    together = poles(held, Lqg(valves, aim, [one], [0], PERIOD).linear(at))
    # zero is a pole of several samples of delay at once, which rounding spreads to its third root
    assert_allclose(np.sort(np.abs(together)), np.sort(np.abs(apart)), atol=1e-5)
