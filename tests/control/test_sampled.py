"""Sampled loops with delays, and their margins, against what can be derived by hand."""

from __future__ import annotations

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose

from hydroopt.control.linear_plant import sampled
from hydroopt.control.loops import Loops, response

PERIOD = 0.02
INTEGRATOR = control.ss(0, 1, 1, 0)


def loops(plant: control.StateSpace, feedback: control.StateSpace) -> Loops:
    """All loops of a plant whose first output is a position."""
    return Loops("here", [f"loop {k}" for k in range(plant.ninputs)], plant, feedback, (0,))


def proportional(gain: float) -> control.StateSpace:
    """u = −gain·y."""
    return control.ss([], [], [], -gain, PERIOD)


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
    made = loops(sampled(INTEGRATOR, np.array([PERIOD]), PERIOD), proportional(gain))
    found = made.margins
    turn = 2 * np.arcsin(gain * PERIOD / 2)
    assert found[0].gain == pytest.approx(1 / (gain * PERIOD), rel=1e-3)
    assert found[0].phase == pytest.approx(np.pi / 2 - 1.5 * turn, rel=1e-3)
    assert found[0].phase_at == pytest.approx(turn / PERIOD, rel=1e-3)
    z = np.exp(1j * made.omega * PERIOD)
    assert_allclose(made.cut[0], gain * PERIOD / (z * (z - 1)), rtol=1e-9)


@pytest.mark.parametrize(("gain", "stable"), [(49.0, True), (51.0, False)])
def test_stability_ends_where_the_characteristic_polynomial_says(gain: float, stable: bool) -> None:
    plant = sampled(INTEGRATOR, np.array([PERIOD]), PERIOD)
    (found,) = loops(plant, proportional(gain)).margins
    assert (found.damping > 0) == stable
    roots = np.roots([1, -1, gain * PERIOD])
    closed = control.feedback(plant, proportional(gain), sign=1).poles()
    assert_allclose(np.sort_complex(closed), np.sort_complex(roots), atol=1e-9)
    # of an unstable loop the factor that would bring it back
    assert found.gain == pytest.approx(50 / gain, rel=1e-2)


def test_a_loop_is_cut_while_the_others_stay_closed() -> None:
    """Two integrators, the second of which also feels the first: closing one loop leaves a first-order lag."""
    plant = control.ss(np.zeros((2, 2)), [[1.0, 0.5], [0.3, 1.0]], np.eye(2), 0)
    gains = np.array([3.0, 7.0])
    feedback = control.ss([], [], [], -np.diag(gains), PERIOD)
    made = loops(sampled(plant, np.zeros(2), PERIOD), feedback)
    # x1+ = x1 + h·(u1 + u2/2), x2+ = x2 + h·(0.3·u1 + u2), u2 = −7·x2: solved for x1 by u1
    z = np.exp(1j * made.omega * PERIOD)
    second = 0.3 * PERIOD / (z - 1 + 7 * PERIOD)
    assert_allclose(made.cut[0], 3 * PERIOD * (1 - 3.5 * second) / (z - 1), rtol=1e-9)


@pytest.fixture(scope="module", params=range(3))
def loop(request: pytest.FixtureRequest) -> tuple[control.StateSpace, control.StateSpace]:
    """A resonant plant of two commands and three outputs, held and delayed, and a stable feedback with states."""
    rng = np.random.default_rng(request.param)
    A = rng.standard_normal((5, 5))
    A -= (np.max(np.linalg.eigvals(A).real) + 0.3) * np.eye(5)
    plant = control.ss(A, rng.standard_normal((5, 2)), rng.standard_normal((3, 5)), 0, inputs=["u", "v"],
                       outputs=["a_measured", "b_measured", "c_measured"])
    feedback = control.ss(np.diag([1.0, 0.6]), 0.02 * rng.standard_normal((2, 3)), np.eye(2),
                          0.2 * rng.standard_normal((2, 3)), 0.1, states=["i", "j"])
    return sampled(plant, np.array([0.13, 0.05]), 0.1), feedback


def test_responses_are_those_of_python_control(loop: tuple[control.StateSpace, control.StateSpace]) -> None:
    z = np.exp(1j * np.geomspace(1e-3, np.pi, 50))
    for system in loop:
        expected = np.moveaxis(system(z, squeeze=False), 2, 0)
        assert_allclose(response(system, z), expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


def test_commands_that_wait_have_names(loop: tuple[control.StateSpace, control.StateSpace]) -> None:
    plant, _ = loop
    assert plant.state_labels[:3] == ["u_1_samples_ago", "u_2_samples_ago", "v_1_samples_ago"]
    assert (plant.input_labels, plant.output_labels) == (["u", "v"], ["a_measured", "b_measured", "c_measured"])


@pytest.mark.parametrize("gain", [2.0, 10.0, 25.0])
def test_disk_margin_is_that_of_python_control(gain: float) -> None:
    """Of an integrator with a sample of delay."""
    made = loops(sampled(INTEGRATOR, np.array([PERIOD]), PERIOD), proportional(gain))
    loop = control.tf([gain * PERIOD], [1, -1, 0], PERIOD)
    assert made.margins[0].disk == pytest.approx(float(control.disk_margins(loop, made.omega, skew=0.0)[0]), rel=1e-6)


def test_an_unstable_loop_has_no_disk_margin() -> None:
    made = loops(sampled(INTEGRATOR, np.array([PERIOD]), PERIOD), proportional(51.0))
    assert made.margins[0].disk == made.disks[0] == 0


def test_closed_loops_answer_to_steps_as_plant_and_feedback_do(
        loop: tuple[control.StateSpace, control.StateSpace]) -> None:
    """References of two outputs are subtracted from the readings, sample by sample."""
    plant, feedback = loop
    found = Loops("here", ["u", "v"], plant, feedback, (0, 2))
    t, y = found.steps(6.0)
    assert (found.closed.input_labels, found.closed.output_labels) == (["a_reference", "c_reference"], ["a", "c"])
    for own, place in enumerate((0, 2)):
        x, state, reference = np.zeros(plant.nstates), np.zeros(feedback.nstates), np.eye(3)[place]
        for k in range(len(t)):
            error = plant.C @ x - reference
            assert y[k, own] == pytest.approx((plant.C @ x)[place], abs=1e-9)
            x, state = (plant.A @ x + plant.B @ (feedback.C @ state + feedback.D @ error),
                        feedback.A @ state + feedback.B @ error)
    closed = control.feedback(plant, feedback, sign=1).poles()
    assert_allclose(np.sort_complex(found.poles), np.sort_complex(closed), atol=1e-6)


def test_the_least_damping_is_that_of_an_oscillator() -> None:
    """A sampled oscillator of 3 rad/s and a ratio of 0.05, without feedback, beside a position that nothing moves."""
    A = np.array([[0, 1, 0], [-9.0, -0.3, 0], [0, 0, 0]])
    plant = control.ss(A, [[0.0], [1], [1]], [[1.0, 0, 0]], 0)
    (found,) = loops(sampled(plant, np.zeros(1), PERIOD), proportional(0.0)).margins
    assert found.undisturbed == pytest.approx(0.05, rel=1e-9)
    (found,) = loops(sampled(plant, np.zeros(1), PERIOD), proportional(-5.0)).margins
    assert found.damping < 0.05
    slower = sampled(control.ss(A[:2, :2], plant.B[:2], plant.C[:, :2], 0), np.zeros(1), PERIOD)
    (found,) = loops(slower, proportional(0.0)).margins
    assert (found.damping, found.damping_at) == (pytest.approx(0.05, rel=1e-9), pytest.approx(3.0, rel=1e-9))


def test_a_narrow_resonance_takes_what_its_circle_takes() -> None:
    """A resonance with a damping ratio of 1e-4 between two of the frequencies: its Nyquist curve is a circle.

    L = c·ω²/(s² + 2·ζ·ω·s + ω²), at ω equal to −j·c/(2·ζ): of radius c/(4·ζ), which passes −1 at the distance from its
    centre less the radius.
    """
    omega, ratio, size = 11.7, 1e-4, 1e-4
    A = np.array([[0.0, 1.0], [-omega**2, -2 * ratio * omega]])
    plant = sampled(control.ss(A, [[0.0], [size * omega**2]], [[1.0, 0.0]], 0), np.zeros(1), 1e-3)
    (found,) = loops(plant, control.ss([], [], [], -1, 1e-3)).margins
    radius = size / (4 * ratio)
    assert found.distance == pytest.approx(np.hypot(1, radius) - radius, rel=5e-3)
