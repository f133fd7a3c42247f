"""Parameters of dynamics from records, against simulations by CVODES and the derivatives of these."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from hydroopt.errors import ProblemError
from hydroopt.estimation.hydraulic.diagnostics import parameter_diagnostics
from hydroopt.estimation.hydraulic.dynamics import WIDEST, Dynamics, Record, ShootingProblem, free_run
from hydroopt.estimation.hydraulic.shooting import multiple_shooting
from hydroopt.parameters.parameter_set import ParameterKind, ParameterSet
from hydroopt.results.diagnostic import of_kind
from hydroopt.results.wording import Kind

RNG = np.random.default_rng(0)


def parameter_set(names, start, *, lower=0.0, sigma=None):
    start = np.asarray(start, float)
    information = np.zeros((len(start),) * 2) if sigma is None else np.diag(1 / np.asarray(sigma) ** 2)
    return ParameterSet(tuple(names), (ParameterKind.COEFFICIENT,) * len(start), ("1",) * len(start), start,
                        np.full(len(start), lower), np.full(len(start), np.inf), np.abs(start), information)


def cylinder():
    """A valve feeding the chamber that carries a mass; the small chamber before it empties within a tenth of a ms."""
    x, u, theta = ca.SX.sym("x", 4), ca.SX.sym("u", 2), ca.SX.sym("theta", 4)
    modulus, gain, viscous, leakage = ca.vertsplit(theta)
    position, speed, p, line = ca.vertsplit(x)
    drop = u[1] - line
    flow = gain * u[0] * drop / (drop**2 + 1e10) ** 0.25
    through = 1e-7 * (line - p)
    rates = ca.vertcat(speed, (5e-3 * p - viscous * speed - 4e4) / 2e4,
                       modulus / (1e-3 + 5e-3 * position) * (through - 5e-3 * speed - leakage * p),
                       1e9 / 1e-5 * (flow - through))
    return Dynamics(ca.Function("rates", [x, u, theta], [rates]), ca.Function("seen", [x, u, theta], [x[[0, 2]]]),
                    ("position", "speed", "p", "line"), ("u", "supply"), ("position", "p"),
                    np.array([0.1, 0.1, 1e7, 1e7]), np.array([False, True]))


TRUTH = np.array([1e9, 1e-7, 3e4, 2e-11])
SIGMA = np.array([1e-3, 1e5])


def recorded(dynamics, t, seed=0, noise=0.0):
    phase = np.random.default_rng(seed).uniform(0, 6, 2)
    u = np.column_stack([0.4 + 0.3 * np.sin(2 * np.pi * 0.3 * t + phase[0]) + 0.1 * np.sin(8 * t + phase[1]),
                         np.where(np.sin(5 * t) > 0, 2e7, 1.9e7)])
    blank = Record(t, u, np.zeros((len(t), 2)), np.zeros((len(t), 4)))
    states, outputs = free_run(dynamics, blank, np.array([0.05, 0.0, 8e6, 8.1e6]), TRUTH)
    y = outputs + noise * SIGMA * np.random.default_rng(seed + 1).standard_normal(outputs.shape)
    guess = np.column_stack([y[:, 0], np.gradient(y[:, 0], t), y[:, 1], y[:, 1]])
    return Record(t, u, y, guess), states


@pytest.mark.slow
def test_recovers_stiff_dynamics_simulated_by_cvodes():
    dynamics = cylinder()
    t = np.cumsum(np.random.default_rng(3).uniform(0.005, 0.015, 500))
    records, states = zip(*(recorded(dynamics, t, seed) for seed in (0, 1)), strict=True)
    record = records[1]
    record.y[RNG.random(record.y.shape) < 0.3] = np.nan
    problem = ShootingProblem(dynamics, parameter_set("abcd", TRUTH * [1.3, 0.8, 1.2, 0.7]), SIGMA, records)
    found = multiple_shooting(problem)
    np.testing.assert_allclose(found.theta, TRUTH, rtol=1e-5)
    # the line forgets how it began before the second sample
    np.testing.assert_allclose(found.solution.points[1][3::3] / dynamics.scale, states[1][1:] / dynamics.scale,
                               atol=1e-5)
    assert parameter_diagnostics(found) == ()
    simulated, outputs = found.free_run(problem.records[0])
    np.testing.assert_allclose(simulated[1:] / dynamics.scale, states[0][1:] / dynamics.scale, atol=1e-4)
    np.testing.assert_allclose(outputs, problem.records[0].y, rtol=1e-4, atol=1e-5)


def test_collocation_keeps_its_order():
    """Against CVODES, over one interval of a tenth of the oscillation's period and its halves."""
    x, u, theta = ca.SX.sym("x", 2), ca.SX.sym("u"), ca.SX.sym("theta")
    oscillator = Dynamics(ca.Function("rates", [x, u, theta], [ca.vertcat(x[1], -theta * ca.sin(x[0]))]),
                          ca.Function("seen", [x, u, theta], [x]), ("x", "v"), ("u",), ("x", "v"), np.ones(2),
                          np.array([False]))
    errors = []
    for steps in (1, 2, 4):
        t = np.array([0.0, 0.6])
        record = Record(t, np.zeros((2, 1)), np.array([[1.0, 0.0], [np.nan, np.nan]]), np.array([[1.0, 0.0]] * 2),
                        steps=steps, initial_sigma=np.full(2, 1e-6))
        fixed = ParameterSet(("w",), (ParameterKind.COEFFICIENT,), ("1",), *[np.ones(1)] * 4, np.eye(1))
        end = multiple_shooting(ShootingProblem(oscillator, fixed, np.full(2, 1e-6), (record,))).solution.points[0][-1]
        fine = Record(np.linspace(0, 0.6, 60), np.zeros((60, 1)), np.zeros((60, 2)), np.zeros((60, 2)))
        errors.append(np.abs(end - free_run(oscillator, fine, np.array([1.0, 0.0]), np.ones(1))[0][-1]).max())
    assert errors[0] < 1e-4
    assert errors[0] / errors[1] > 2**4.5


@pytest.mark.slow
def test_covariance_is_that_of_the_simulation_s_own_derivatives():
    dynamics = cylinder()
    t = np.arange(300) * 0.01
    record, _ = recorded(dynamics, t, noise=1.0)
    nominal = TRUTH * 1.1
    found = multiple_shooting(ShootingProblem(dynamics, parameter_set("abcd", nominal, sigma=nominal), SIGMA,
                                              (record,)))
    first, theta = found.solution.points[0][0], found.theta
    columns = []
    for k in range(4 + 4):
        size = theta[k] if k < 4 else dynamics.scale[k - 4]
        moved = []
        for step in (1e-3, -1e-3):
            values, states = theta.copy(), first.copy()
            (values if k < 4 else states)[k % 4] += step * size
            moved.append(free_run(dynamics, record, states, values)[1])
        columns.append(((moved[0] - moved[1]) / (2e-3 * size) / SIGMA).ravel())
    J = np.column_stack(columns)
    information = J.T @ J
    information += np.diag(1 / np.concatenate([nominal, WIDEST * dynamics.scale]) ** 2)
    expected = np.sqrt(np.diag(np.linalg.inv(information / np.outer(*[np.sqrt(np.diag(information))] * 2)))[:4]
                       / np.diag(information)[:4])
    np.testing.assert_allclose(found.std / max(1, found.residual_scale), expected, rtol=1e-2)
    assert 0.9 < found.residual_scale < 1.1
    # four parameters, ten to the twentieth apart, and four first states
    assert found.residual_scale == pytest.approx(np.sqrt(np.nansum(found.residuals[0] ** 2) / (600 - 8)), rel=1e-9)


def first_order():
    x, u, theta = ca.SX.sym("x"), ca.SX.sym("u"), ca.SX.sym("theta", 3)
    rates = ca.Function("rates", [x, u, theta], [theta[0] / theta[1] * (u - x) - theta[2] * x])
    return Dynamics(rates, ca.Function("seen", [x, u, theta], [x]), ("x",), ("u",), ("x",), np.ones(1),
                    np.array([True]))


def driven(truth, noise=1e-3):
    t = np.arange(200) * 0.05
    record = Record(t, np.sign(np.sin(2 * t))[:, None], np.zeros((200, 1)), np.zeros((200, 1)))
    x = free_run(first_order(), record, np.zeros(1), np.array(truth))[1]
    y = x + noise * np.random.default_rng(5).standard_normal(x.shape)
    return Record(t, record.u, y, y)


def test_says_what_shows_only_as_a_ratio():
    start = parameter_set(("gain", "size", "leak"), [2.2, 0.9, 0.3], sigma=[1.0, 1.0, 1.0])
    found = multiple_shooting(ShootingProblem(first_order(), start, np.array([1e-3]), (driven([2.0, 1.0, 0.2]),)))
    assert found["gain"] / found["size"] == pytest.approx(2.0, rel=1e-3)
    (only,) = of_kind(parameter_diagnostics(found), Kind.RATIO_OR_PRODUCT_ONLY)
    assert set(only.subject) == {"gain", "size"}
    assert only.evidence["form"] == "ratio"
    assert only.evidence["determined_by"] == "the prior"


def test_without_priors_a_ratio_has_no_deviations():
    start = parameter_set(("gain", "size", "leak"), [2.2, 0.9, 0.3])
    found = multiple_shooting(ShootingProblem(first_order(), start, np.array([1e-3]), (driven([2.0, 1.0, 0.2]),)))
    assert np.isnan(found.std).tolist() == [True, True, False]
    assert any(each.evidence.get("determined_by") == "nothing" for each in parameter_diagnostics(found))


def test_a_bound_holds_and_is_named():
    start = parameter_set(("gain", "size", "leak"), [2.2, 1.0, 0.3], sigma=[1.0, 1e-6, 1.0])
    found = multiple_shooting(ShootingProblem(first_order(), start, np.array([1e-3]), (driven([2.0, 1.0, -0.05]),)))
    assert found["leak"] == pytest.approx(0.0, abs=1e-7)
    assert np.isnan(found.std[2])
    assert found.ci95[2, 0] == 0
    assert 0 < found.ci95[2, 1] < 0.01
    (held,) = of_kind(parameter_diagnostics(found), Kind.PARAMETER_AT_BOUND)
    assert held.subject == ("leak",)
    assert (held.evidence["side"], held.evidence["bound"], held.evidence["beyond"]) == ("lower", 0.0, "below")


def test_errors_that_repeat_themselves_count_less():
    record = driven([2.0, 1.0, 0.2])
    waves = Record(record.t, record.u, record.y + 5e-3 * np.sin(3 * record.t)[:, None], record.guess)
    start = parameter_set(("gain", "size", "leak"), [2.0, 1.0, 0.2], sigma=[1.0, 1e-6, 1.0])
    white = multiple_shooting(ShootingProblem(first_order(), start, np.array([1e-3]), (record,)))
    assert white.reweighted.sigma[0] < 1.3e-3
    assert multiple_shooting(ShootingProblem(first_order(), start, np.array([1e-3]),
                                             (waves,))).reweighted.sigma[0] > 6e-3


def test_refuses_what_is_incomplete():
    record = driven([2.0, 1.0, 0.2])
    with pytest.raises(ProblemError, match="inputs are missing at sample 3"):
        Record(record.t, np.where(np.arange(200)[:, None] == 3, np.nan, record.u), record.y, record.guess)
    with pytest.raises(ProblemError, match="199 rows of readings at 200 samples"):
        Record(record.t, record.u, record.y[1:], record.guess)
    with pytest.raises(ProblemError, match="times do not increase"):
        Record(record.t[::-1], record.u, record.y, record.guess)
    with pytest.raises(ProblemError, match="no positive standard deviation"):
        ShootingProblem(first_order(), parameter_set("abc", [1, 1, 1]), np.zeros(1), (record,))
