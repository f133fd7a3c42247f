"""Integration in C against solutions in closed form, and against SciPy where there are none."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from hydroopt.kernels import integrator as module
from hydroopt.kernels.integrator import IntegrationError, Integrator


def oscillator(tolerance: float) -> Integrator:
    """ẍ = w − k·x."""
    x, w, k = ca.SX.sym("x", 2), ca.SX.sym("w"), ca.SX.sym("k")
    rates = ca.Function("oscillator", [x, w, k], [ca.vertcat(x[1], w - k * x[0])], ["x", "w", "k"], ["rates"])
    return Integrator(rates, [np.array([4.0])], np.ones(2), tolerance=tolerance)


def relaxation(tolerance: float) -> Integrator:
    """ẋ = −λ·(x − cos y), ẏ = w (Prothero and Robinson 1974): x follows cos y, however great λ is."""
    x, w, rate = ca.SX.sym("x", 2), ca.SX.sym("w"), ca.SX.sym("rate")
    right = ca.vertcat(-rate * (x[0] - ca.cos(x[1])) - w * ca.sin(x[1]), w)
    function = ca.Function("relaxation", [x, w, rate], [right], ["x", "w", "rate"], ["rates"])
    return Integrator(function, [np.array([1e7])], np.ones(2), tolerance=tolerance)


@pytest.fixture(params=["C", "CVODES"])
def way(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    if request.param == "CVODES":
        monkeypatch.setattr(module, "compiler", lambda: None)
    return str(request.param)


def test_inputs_that_are_constant_or_linear_in_time_give_the_solution_in_closed_form(way: str) -> None:
    """x(t) of the oscillator at w = a + b·t is (a + b·t)/k plus an oscillation."""
    loose = 1e-10 if way == "C" else 1e-8
    exact = oscillator(1e-11)
    t = np.linspace(0.0, 3.0, 31)
    constant = exact.along([0.0, 0.0], np.diff(t), np.ones((30, 1)))[:, 0]
    np.testing.assert_allclose(constant, (1 - np.cos(2 * t[1:])) / 4, atol=loose)
    ramp = exact.along([0.0, 0.0], np.diff(t), t[:-1, None], slopes=[np.ones((30, 1))])[:, 0]
    np.testing.assert_allclose(ramp, (t[1:] - np.sin(2 * t[1:]) / 2) / 4, atol=loose)
    np.testing.assert_allclose(exact([0.0, 0.0], 3.0, [1.0]), [constant[-1], np.sin(6.0) / 2], atol=loose)


def test_errors_and_steps_follow_the_tolerance_by_the_order_of_the_method() -> None:
    """Dormand and Prince's fifth order: 10⁴ times less error takes 10^(4/5) times as many steps."""
    end, steps, errors = 20.0, [], []
    for tolerance in (1e-6, 1e-10):
        made = oscillator(tolerance)
        errors.append(abs(made([0.0, 0.0], end, [1.0])[0] - (1 - np.cos(2 * end)) / 4))
        steps.append(made.steps)
        assert not made.stiff
    assert errors[0] < 1e-4
    assert errors[1] < 1e-8
    assert steps[1] / steps[0] == pytest.approx(10**0.8, rel=0.25)


@pytest.mark.parametrize("width", [0.0, 1e-6], ids=["sharp", "rounded"])
def test_the_error_of_a_step_across_a_kink_is_seen_wherever_the_kink_is(width: float) -> None:
    """ẋ = max(t − u, 0) has x = (t − u)²/2; by the embedded estimate alone 6e-6 would pass."""
    x, u = ca.SX.sym("x", 2), ca.SX.sym("u")
    past = x[1] - u
    right = ca.vertcat(ca.fmax(past, 0) if width == 0 else (past + ca.sqrt(past**2 + width**2)) / 2, 1.0)
    function = ca.Function("kink", [x, ca.SX.sym("none", 0), u], [right], ["x", "none", "u"], ["rates"])
    errors = []
    for place in np.linspace(0.3, 0.7, 200):
        made = Integrator(function, [np.array([place])], np.ones(2), tolerance=1e-7)
        errors.append(abs(made([0.0, 0.0], 1.0, [])[0] - (1 - place)**2 / 2))
    assert max(errors) < 3e-7  # the root mean square over two states lets the one with an error have √2 times as much


def test_what_is_stiff_is_integrated_by_implicit_steps_of_fourth_order() -> None:
    """Explicit steps would have to be shorter than 3.3e-7 s: 10⁷ of them for this time."""
    steps = []
    for tolerance in (1e-5, 1e-8):
        made = relaxation(tolerance)
        found = made([1.0, 0.0], 3.0, [1.0])
        assert made.stiff
        np.testing.assert_allclose(found, [np.cos(3.0), 3.0], atol=30 * tolerance)
        steps.append(made.steps)
    assert steps[1] < 1500
    assert steps[1] / steps[0] < 10**(3 / 3)  # 10^(3/4), or less where the error is that of the stiff part


def test_implicit_steps_take_inputs_that_change_within_a_piece() -> None:
    """ẏ = w at w = t gives y = t²/2."""
    made = relaxation(1e-8)
    t = np.linspace(0.0, 2.0, 11)
    states = made.along([1.0, 0.0], np.diff(t), t[:-1, None], slopes=[np.ones((10, 1))])
    assert made.stiff
    np.testing.assert_allclose(states, np.column_stack([np.cos(t[1:]**2 / 2), t[1:]**2 / 2]), atol=1e-6)


@pytest.mark.slow
def test_a_stiff_oscillation_agrees_with_an_implicit_method_of_another_family() -> None:
    """Van der Pol's equation at μ = 1000 alternates between stiff and not; SciPy's Radau is the reference."""
    x, mu = ca.SX.sym("x", 2), ca.SX.sym("mu")
    right = ca.vertcat(x[1], mu * (1 - x[0]**2) * x[1] - x[0])
    none = ca.SX.sym("none", 0)
    made = Integrator(ca.Function("van_der_pol", [x, none, mu], [right], ["x", "none", "mu"], ["rates"]),
                      [np.array([1e3])], np.ones(2), tolerance=1e-9)
    reference = solve_ivp(lambda _, z: [z[1], 1e3 * (1 - z[0]**2) * z[1] - z[0]], (0, 2000), [2.0, 0.0], "Radau",
                          rtol=1e-10, atol=1e-12, t_eval=[1000.0, 2000.0]).y.T
    found = made.along([2.0, 0.0], np.array([1000.0, 1000.0]), np.zeros((2, 0)))
    np.testing.assert_allclose(found, reference, rtol=1e-4)


def test_what_ends_in_infinity_is_an_error_that_says_where(way: str) -> None:
    """ẋ = x² from x = 1 has no solution beyond t = 1."""
    x, w = ca.SX.sym("x"), ca.SX.sym("w", 0)
    made = Integrator(ca.Function("blow_up", [x, w], [x**2], ["x", "w"], ["rates"]), [], np.ones(1))
    with pytest.raises(IntegrationError) as raised:
        made.along([1.0], np.full(5, 0.3), np.zeros((5, 0)))
    assert raised.value.pieces == 3
