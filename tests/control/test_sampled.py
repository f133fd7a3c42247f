"""Sampled loops with delays, and their margins, against what can be derived by hand."""

from __future__ import annotations

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose

from hydroopt.control.linear_system import LinearSystem, closed_loop
from hydroopt.control.loop_margins import margins
from hydroopt.control.sampled_plant import sampled

PERIOD = 0.02
ONE = np.ones((1, 1))
INTEGRATOR = LinearSystem(0 * ONE, ONE, ONE, 0 * ONE, 0.0)


def proportional(gain: float) -> LinearSystem:
    """u = −gain·y."""
    return LinearSystem(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), -gain * ONE, PERIOD)


@pytest.mark.parametrize("delay", [0.0, 0.008, 0.02, 0.034])
def test_held_commands_that_come_late_move_an_integrator_as_they_should(delay: float) -> None:
    """Its place at the samples is the integral of the held commands, shifted by the delay."""
    plant = sampled(INTEGRATOR, np.array([delay]), PERIOD)
    rng = np.random.default_rng(2)
    u = rng.standard_normal(40)
    x, place = np.zeros(len(plant.A)), []
    for value in u:
        place.append((plant.C @ x)[0])
        x = plant.A @ x + plant.B[:, 0] * value
    fine = np.arange(0, len(u) * PERIOD, 1e-5) + 5e-6
    index = np.floor((fine - delay) / PERIOD).astype(int)
    integral = np.concatenate([[0.0], np.cumsum(np.where(index >= 0, u[index], 0.0)) * 1e-5])
    assert_allclose(place, integral[::round(PERIOD / 1e-5)][:len(u)], atol=1e-9)


@pytest.mark.parametrize("gain", [2.0, 10.0, 30.0])
def test_margins_of_an_integrator_with_one_sample_of_delay(gain: float) -> None:
    """L = k·h/(z·(z − 1)): the closed loop z² − z + k·h is stable for k·h < 1, which is the gain margin.

    |L| = 1 where 2·sin(θ/2) = k·h, and there the phase is −90° − 3·θ/2.
    """
    found, omega, L = margins(sampled(INTEGRATOR, np.array([PERIOD]), PERIOD), proportional(gain), ["loop"], "here")
    turn = 2 * np.arcsin(gain * PERIOD / 2)
    assert found[0].gain == pytest.approx(1 / (gain * PERIOD), rel=1e-3)
    assert found[0].phase == pytest.approx(np.pi / 2 - 1.5 * turn, rel=1e-3)
    assert found[0].phase_at == pytest.approx(turn / PERIOD, rel=1e-3)
    z = np.exp(1j * omega * PERIOD)
    assert_allclose(L[0], gain * PERIOD / (z * (z - 1)), rtol=1e-9)


@pytest.mark.parametrize(("gain", "stable"), [(49.0, True), (51.0, False)])
def test_stability_ends_where_the_characteristic_polynomial_says(gain: float, stable: bool) -> None:
    plant = sampled(INTEGRATOR, np.array([PERIOD]), PERIOD)
    (found,), _, _ = margins(plant, proportional(gain), ["loop"], "here")
    assert (found.damping > 0) == stable
    roots = np.roots([1, -1, gain * PERIOD])
    assert_allclose(np.sort_complex(closed_loop(plant, proportional(gain)).poles), np.sort_complex(roots), atol=1e-9)
    # of an unstable loop the factor that would bring it back
    assert found.gain == pytest.approx(50 / gain, rel=1e-2)


def test_a_loop_is_cut_while_the_others_stay_closed() -> None:
    """Two integrators, the second of which also feels the first: closing one loop leaves a first-order lag."""
    plant = LinearSystem(np.zeros((2, 2)), np.array([[1.0, 0.5], [0.3, 1.0]]), np.eye(2), np.zeros((2, 2)), 0.0)
    gains = np.array([3.0, 7.0])
    feedback = LinearSystem(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((2, 0)), -np.diag(gains), PERIOD)
    _, omega, L = margins(sampled(plant, np.zeros(2), PERIOD), feedback, ["a", "b"], "here")
    # x1+ = x1 + h·(u1 + u2/2), x2+ = x2 + h·(0.3·u1 + u2), u2 = −7·x2: solved for x1 by u1
    z = np.exp(1j * omega * PERIOD)
    second = 0.3 * PERIOD / (z - 1 + 7 * PERIOD)
    assert_allclose(L[0], 3 * PERIOD * (1 - 3.5 * second) / (z - 1), rtol=1e-9)


@pytest.fixture(scope="module", params=range(3))
def loop(request: pytest.FixtureRequest) -> tuple[LinearSystem, LinearSystem]:
    """A resonant plant of two commands and three outputs, held and delayed, and a stable feedback with states."""
    rng = np.random.default_rng(request.param)
    A = rng.standard_normal((5, 5))
    A -= (np.max(np.linalg.eigvals(A).real) + 0.3) * np.eye(5)
    plant = LinearSystem(A, rng.standard_normal((5, 2)), rng.standard_normal((3, 5)), np.zeros((3, 2)), 0.0)
    feedback = LinearSystem(np.diag([1.0, 0.6]), 0.02 * rng.standard_normal((2, 3)), np.eye(2),
                            0.2 * rng.standard_normal((2, 3)), 0.1)
    return sampled(plant, np.array([0.13, 0.05]), 0.1), feedback


def test_responses_are_those_of_python_control(loop: tuple[LinearSystem, LinearSystem]) -> None:
    z = np.exp(1j * np.geomspace(1e-3, np.pi, 50))
    for system in loop:
        expected = np.moveaxis(system.python_control()(z, squeeze=False), 2, 0)
        assert_allclose(system.response(z), expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


def test_a_held_system_is_that_of_python_control(loop: tuple[LinearSystem, LinearSystem]) -> None:
    rng = np.random.default_rng(3)
    system = LinearSystem(*(rng.standard_normal(size) for size in ((4, 4), (4, 2), (1, 4))), np.zeros((1, 2)), 0.0,
                          ("a.q", "b", "c", "d"), ("u.1", "u.2"), ("y",))
    held, expected = sampled(system, np.zeros(2), 0.1), control.sample_system(system.python_control(), 0.1, "zoh")
    assert_allclose(held.A, expected.A, atol=1e-12)
    assert_allclose(held.B, expected.B, atol=1e-12)
    assert (expected.state_labels, expected.input_labels) == (["a_q", "b", "c", "d"], ["u_1", "u_2"])


def test_margins_and_poles_are_those_of_python_control(loop: tuple[LinearSystem, LinearSystem]) -> None:
    plant, feedback = loop
    found, omega, L = margins(plant, feedback, ["a", "b"], "here")
    closed = control.feedback(plant.python_control(), feedback.python_control(), sign=1).poles()
    assert_allclose(np.sort_complex(closed_loop(plant, feedback).poles), np.sort_complex(closed), atol=1e-6)
    for margin, curve in zip(found, L, strict=True):
        gains, phases, distances, *_ = control.stability_margins(
            control.FrequencyResponseData(curve, omega, smooth=True), returnall=True)
        own = [g for g in gains if (g > 1) == (margin.damping >= 0)]
        assert margin.gain == pytest.approx(min(own, key=lambda g: abs(np.log(g)), default=np.inf), rel=1e-3)
        assert np.degrees(margin.phase) == pytest.approx(min(abs((p + 180) % 360 - 180) for p in phases)
                                                         if len(phases) else np.inf, rel=1e-3)
        assert margin.distance <= min(distances) * (1 + 1e-3)
        assert margin.distance == pytest.approx(min(*distances, *np.abs(1 + curve)), rel=1e-3)


@pytest.mark.parametrize("gain", [2.0, 10.0, 25.0])
def test_disk_margin_is_that_of_python_control(gain: float) -> None:
    """Of an integrator with a sample of delay."""
    (found,), omega, _ = margins(sampled(INTEGRATOR, np.array([PERIOD]), PERIOD), proportional(gain), ["a"], "here")
    loop = control.tf([gain * PERIOD], [1, -1, 0], PERIOD)
    assert found.disk == pytest.approx(float(control.disk_margins(loop, omega, skew=0.0)[0]), rel=1e-6)


def test_steps_poles_and_zeros_of_closed_loops_are_those_of_python_control(
        loop: tuple[LinearSystem, LinearSystem]) -> None:
    """From references of two outputs to these; python-control sees the feedback fed by three readings less both."""
    plant, feedback = loop
    closed = closed_loop(plant, feedback, (0, 2), ("a.q", "c.q"))
    chosen = control.ss([], [], [], np.eye(3)[:, [0, 2]], 0.1)
    forward = control.series(-1 * chosen, feedback.python_control(), plant.python_control())
    back = control.feedback(control.ss([], [], [], np.eye(3), 0.1), plant.python_control() * feedback.python_control(),
                            sign=1)
    expected = control.ss([], [], [], np.eye(3)[[0, 2]], 0.1) * back * forward
    t = np.arange(60) * 0.1
    assert_allclose(closed.steps(60), np.moveaxis(control.step_response(expected, t).outputs, 2, 0), atol=1e-9)
    own = closed.python_control()
    assert (own.input_labels, own.output_labels) == (["a_q_reference", "c_q_reference"], ["a_q", "c_q"])
    assert_allclose(np.sort_complex(closed.poles), np.sort_complex(own.poles()), atol=1e-9)
    for zero in closed.zeros:
        pencil = np.block([[closed.A - zero * np.eye(len(closed.A)), closed.B], [closed.C, closed.D]])
        sizes = np.linalg.svd(pencil, compute_uv=False)
        assert sizes[-1] < 1e-7 * sizes[0]
    # at any other place outputs can be had
    other = np.block([[closed.A - 0.37 * np.eye(len(closed.A)), closed.B], [closed.C, closed.D]])
    assert np.linalg.svd(other, compute_uv=False)[-1] > 1e-6


def test_the_least_damping_is_that_of_an_oscillator() -> None:
    """A sampled oscillator of 3 rad/s and a ratio of 0.05, without feedback, beside a position that nothing moves."""
    A = np.array([[0, 1, 0], [-9.0, -0.3, 0], [0, 0, 0]])
    plant = LinearSystem(A, np.array([[0.0], [1], [1]]), np.array([[1.0, 0, 0]]), np.zeros((1, 1)), 0.0)
    (found,), _, _ = margins(sampled(plant, np.zeros(1), PERIOD), proportional(0.0), ["a"], "here")
    assert found.undisturbed == pytest.approx(0.05, rel=1e-9)
    (found,), _, _ = margins(sampled(plant, np.zeros(1), PERIOD), proportional(-5.0), ["a"], "here")
    assert found.damping < 0.05
    slower = sampled(LinearSystem(A[:2, :2], plant.B[:2], plant.C[:, :2], plant.D, 0.0), np.zeros(1), PERIOD)
    (found,), _, _ = margins(slower, proportional(0.0), ["a"], "here")
    assert (found.damping, found.damping_at) == (pytest.approx(0.05, rel=1e-9), pytest.approx(3.0, rel=1e-9))
