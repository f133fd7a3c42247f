"""The adjustment of volume balances: derivatives, covariance, and the same optimum by IPOPT."""

from __future__ import annotations

from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from hydroopt import load_machine
from hydroopt.errors import ProblemError
from hydroopt.estimation.hydraulic.adjustment import Balanced, Linear, _Solver, adjust
from hydroopt.estimation.hydraulic.problem import HydraulicProblem, hydraulic_problem
from hydroopt.estimation.hydraulic.volume_balance import Misclosure, Readings
from hydroopt.model.plant import Plant
from hydroopt.simulation.drive_valves import drive

CRANE = Path(__file__).parents[3] / "studies" / "actuator_coverage" / "crane.toml"
RNG = np.random.default_rng(0)


@pytest.fixture(scope="module")
def problem() -> HydraulicProblem:
    plant = Plant(load_machine(str(CRANE)))
    t = np.arange(100) / 100
    return hydraulic_problem(plant.machine, [drive(plant, t, 5.7 - 1.2 * np.sin(3 * t)[:, None], np.array([0.3]),
                                                   seed=1)])


def test_derivatives_are_those_of_finite_differences(problem: HydraulicProblem) -> None:
    (each,), known = problem.balanced, problem.parameters
    at = each.balance.misclosure(each.readings, each.readings.values, known.nominal)
    for k in range(len(known)):
        step = 1e-4 * known.scale[k] * np.eye(len(known))[k]
        high, low = (each.balance.misclosure(each.readings, each.readings.values, known.nominal + sign * step).value
                     for sign in (1, -1))
        slope = (high - low) / (2 * step[k])
        np.testing.assert_allclose(at.by_theta[:, :, k], slope, atol=1e-6 * np.max(np.abs(slope)))
    begin = each.readings.begin
    for k, size in enumerate((1e-5, 1e3, 1e3, 1e3, 1e3)):
        moved = each.readings.values.copy()
        moved[begin + 3, k] += size
        change = each.balance.misclosure(each.readings, moved, known.nominal).value - at.value
        np.testing.assert_allclose(change[2], size * at.by_last[2, :, k], rtol=1e-3, atol=1e-15)
        np.testing.assert_allclose(change[3], size * at.by_first[3, :, k], rtol=1e-3, atol=1e-15)


@pytest.mark.parametrize("chambers", [(0, 1), (0,)])
def test_the_band_is_the_covariance_of_what_errors_of_readings_leave(chambers: tuple[int, ...]) -> None:
    count, c = 6, len(chambers)
    first, last = RNG.standard_normal((2, count, c, 5))
    variance, dt = RNG.uniform(0.5, 2.0, (count + 1, 5)), RNG.uniform(0.01, 0.02, count)
    readings = Readings(np.append(0, np.cumsum(dt)), *np.zeros((2, count, 2)), np.zeros((count + 1, 5)), variance,
                        chambers, 0, np.zeros((count + 1, 0)))
    at = Misclosure(np.zeros((count, c)), np.zeros((count, c, 1)), first, last, np.zeros((count, c)))
    nothing = np.zeros(0)
    band = Linear(at.value, at, np.zeros((count + 1, 5)), nothing, nothing, nothing).covariance(readings, 3.0)
    slope = np.zeros((count * c, (count + 1) * 5))
    for j in range(count):
        slope[j * c : (j + 1) * c, 5 * j : 5 * j + 10] = np.hstack([first[j], last[j]])
    dense = slope @ np.diag(variance.ravel()) @ slope.T + 9.0 * np.diag(np.repeat(dt, c))
    for k in range(len(band)):
        np.testing.assert_allclose(band[k, : count * c - k], np.diag(dense, -k), atol=1e-12)
    assert not np.any(np.diag(dense, -len(band)))


@pytest.mark.slow
def test_ipopt_closes_the_balances_with_the_same_corrections(problem: HydraulicProblem) -> None:
    """By the program that the user gets, all corrections being unknowns, against corrections that are eliminated."""
    text = str(problem)
    for part in ("variables x", "jack.dead_band", "minimise f", "corrections of readings of jack", "subject to g",
                 "volume balance of jack"):
        assert part in text
    program = problem.nlp()
    options = {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.tol": 1e-9,
               "ipopt.nlp_scaling_method": "none"}
    answer = ca.nlpsol("by_hand", "ipopt", program.as_dict(), options)(**program.arguments())
    known = problem.parameters
    ours = _Solver(problem.balanced, known, np.zeros(1)).solve(
        np.zeros(len(known)), [np.zeros_like(each.readings.values) for each in problem.balanced])
    assert float(answer["f"]) == pytest.approx(ours.cost / 2, rel=1e-4)
    np.testing.assert_allclose(np.asarray(answer["x"]).ravel()[: len(known)], ours.x, atol=0.01)
    with pytest.raises(ProblemError, match="not convex"):
        problem.cvxpy()


@pytest.mark.slow
def test_noise_in_pressures_does_not_soften_the_oil(problem: HydraulicProblem) -> None:
    """Pressures that err by 5 bar: derivatives at raw readings would find volumes too small by many σ."""
    (each,), known, found = problem.balanced, problem.parameters, []
    place = known.index("jack.volume_a")
    for seed in range(12):
        rng = np.random.default_rng(seed)
        values, variance = each.readings.values.copy(), each.readings.variance.copy()
        clean = drive(problem.plant, each.readings.t, problem.logs[0].channels["jack.u"][:, None], np.array([0.3]),
                      noise=False)
        std = np.array([5e-5, 5e5, 5e5, 0.0, 0.0])
        names = ("jack.length", "jack.p_head", "jack.p_rod", "pump.p_supply", "pump.p_tank")
        values[:] = np.column_stack([clean.channels[name] for name in names]) + std * rng.standard_normal(values.shape)
        variance[:] = std**2
        noisy = Readings(each.readings.t, each.readings.times, each.readings.command, values, variance, (0, 1),
                         each.readings.begin, each.readings.lever)
        one = adjust([Balanced(0, each.balance, noisy)], known, 1)
        information = one.data + known.information
        found.append((one.theta[place] - known.nominal[place]) / np.sqrt(np.linalg.inv(information)[place, place]))
    assert abs(np.mean(found)) < 1.0
    assert np.sqrt(np.mean(np.square(found))) < 1.6
