"""Regulator and filter against what any other gains would cost, and how both work together."""

from __future__ import annotations

from dataclasses import replace

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import solve_discrete_lyapunov

from hydroopt.control.linear_plant import Point, linearised, point, sampled
from hydroopt.control.lqg import (
    BANDWIDTH_SHARE,
    FORCE_DRIFT,
    PROCESS_NOISE,
    Design,
    Lqg,
    Matrices,
    Schedule,
    design,
    reading_noise,
)
from hydroopt.control.reference import Demand, Preview
from hydroopt.control.tuning import INTEGRAL_RATIO
from hydroopt.control.valve_inversion import Valves
from hydroopt.machine.machine_file import load_machine
from hydroopt.model.model import Model
from hydroopt.model.plant import Plant

PERIOD, BANDWIDTH = 0.01, np.array([2.0])


@pytest.fixture(scope="module")
def made() -> tuple[Design, control.StateSpace, Valves, np.ndarray, Point]:
    plant = Plant(Model(load_machine("patu655_lift")))
    psi, theta = plant.model.parameters.nominal, plant.parameters.nominal
    lower, upper = plant.machine.link("lift").joint.range
    q, qd = np.array([(lower + upper) / 2]), np.array([0.05])
    late = sampled(linearised(plant, plant.steady(q, qd, psi, theta), psi, theta), np.array([0.017]), PERIOD)
    at = replace(point(plant, "middle", q, qd, psi, theta, PERIOD), system=late)
    valves, noise = Valves(plant, theta), reading_noise(plant)
    return design(at, valves, BANDWIDTH, noise), late, valves, noise, at


def weights(one: Matrices, at: Point) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A and B of the plant without the error of the demanded force, with the integral of the length's error, and Q,
    for speeds of weight one: written out here."""
    size = len(one.A) - 1
    length = at.lever_arm @ one.C[:1, :size]
    A = np.zeros((size + 1, size + 1))
    A[:size, :size], A[size, :size], A[size, size] = one.A[:size, :size], PERIOD * length[0], 1.0
    Q = np.zeros_like(A)
    Q[:size, :size] = (BANDWIDTH_SHARE * BANDWIDTH[0]) ** 2 * length.T @ length
    Q[size, size] = ((BANDWIDTH_SHARE * BANDWIDTH[0]) ** 2 / INTEGRAL_RATIO) ** 2
    return A, np.vstack([one.B[:size], [[0.0]]]), Q


def on_states(one: Matrices) -> np.ndarray:
    """The feedback of the plant's states and of the integral."""
    return np.delete(one.feedback, len(one.A) - 1, axis=1)


def test_no_other_feedback_costs_less(made) -> None:
    """Cost from any start by Lyapunov's equation, which knows nothing of Riccati."""
    one, _, _, _, at = made
    A, B, Q = weights(one.matrices, at)

    def cost(K: np.ndarray) -> float:
        closed = A - B @ K
        assert np.max(np.abs(np.linalg.eigvals(closed))) < 1
        return float(np.trace(solve_discrete_lyapunov(closed.T, Q + K.T @ K)))

    found = on_states(one.matrices)
    least, rng = cost(found), np.random.default_rng(0)
    for _ in range(10):
        assert cost(found * (1 + 0.02 * rng.standard_normal(found.shape))) >= least * (1 - 1e-9)


def test_filter_solves_the_riccati_equation(made) -> None:
    one, _, valves, noise, at = made
    A, B, C = one.matrices[:3]
    assert np.isinf(noise[-1])  # the supply's pressure is not read
    drift = FORCE_DRIFT * 1e7 * valves.plant.actuators[0].areas[0]
    disturbed = np.hstack([B * np.abs(at.speed), np.diag([*np.full(len(A) - 1, PROCESS_NOISE), drift])])
    gain = control.dlqe(A, disturbed, C[:-1] / noise[:-1, None], np.eye(disturbed.shape[1]), np.eye(len(noise) - 1))[0]
    assert_allclose(one.matrices.filter[:, :-1] * noise[:-1], gain, rtol=1e-5, atol=1e-6 * np.abs(gain).max())
    assert not one.matrices.filter[:, -1].any()


def test_poles_are_those_of_regulator_and_filter(made) -> None:
    """Separation: about its own point the closed loop has the poles of A − B·K and of A − L·C, and as an error of the
    demanded force is only estimated, not that of one which stays."""
    one, held, valves, _, at = made
    A, B, _ = weights(one.matrices, at)
    filtered = one.matrices.A - one.matrices.filter @ one.matrices.C
    apart = np.concatenate([np.linalg.eigvals(A - B @ on_states(one.matrices)), np.linalg.eigvals(filtered)])
    none = np.zeros((1, 1))
    aim = Demand(none, none, none, Preview(none, none, none, none, np.zeros((1, 1, 2))))
    together = control.feedback(held, Lqg(valves, aim, [one], PERIOD).linear(at), sign=1).poles()
    together, apart = np.sort(np.abs(together)), np.sort(np.abs(apart))
    # zero is a pole of several samples of delay at once, which rounding spreads to its fourth root
    held_back = 2 * sum(name.endswith("samples_ago") for name in held.state_labels)
    assert_allclose(together[held_back:], apart[held_back:], rtol=1e-6)
    assert max(together[held_back - 1], apart[held_back - 1]) < 1e-4


def test_a_force_that_is_demanded_wrong_moves_nothing_in_the_end(made) -> None:
    """Where readings of force are off for good, the filter lays it to the demand: the actuator stays where it is."""
    one, held, _, _, at = made
    A, B, C, feedback, gain = one.matrices
    size, x, state, integral = len(A), np.zeros(len(held.A)), np.zeros(len(A)), 0.0
    lengths = []
    for _ in range(3000):
        speed = -feedback[:, :size] @ state - feedback[:, size:] @ [integral]
        readings = held.C @ x + np.array([0.0, 1e4, 0.0])
        state = A @ state + B @ speed + gain @ (readings - C @ state)
        integral += PERIOD * float(at.lever_arm[0, 0] * readings[0])
        x = A[:-1, :-1] @ x + B[:-1] @ speed
        lengths.append(at.lever_arm[0, 0] * x[0])
    assert abs(lengths[-1]) < 1e-3 * np.max(np.abs(lengths))
    assert state[-1] == pytest.approx(1e4, rel=1e-6)


def test_gains_pass_from_one_point_to_the_next(made) -> None:
    """At a point with the same directions its own gains act, halfway the mean, at the other way's another's."""
    one, _, _, _, at = made
    far = replace(at, q=at.q + 0.5)
    back = replace(at, speed=-at.speed)
    doubled, tripled = (Matrices(*(factor * part for part in one.matrices)) for factor in (2.0, 3.0))
    schedule = Schedule([one, Design(far, doubled, one.states), Design(back, tripled, one.states)])

    def factor(q: np.ndarray, speed: np.ndarray) -> float:
        return float(np.linalg.norm(schedule.at(q, speed).feedback) / np.linalg.norm(one.matrices.feedback))

    assert factor(at.q, at.speed) == pytest.approx(1.0, abs=0.01)
    assert factor(at.q + 0.25, 2 * at.speed) == pytest.approx(1.5, abs=0.01)
    assert factor(far.q, at.speed) == pytest.approx(2.0, abs=0.01)
    assert factor(at.q, -at.speed) == pytest.approx(3.0, abs=0.01)
    assert 1.5 < factor(at.q, 0 * at.speed) < 2.5
