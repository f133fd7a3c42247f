"""Delays of valves: commands that arrive between samples, delays that are identified, and those that are wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hydroopt import load_machine
from hydroopt.estimation.hydraulic.problem import HydraulicProblem, hydraulic_problem
from hydroopt.logs.log import Log
from hydroopt.machine.links import Note
from hydroopt.machine.machine import Machine
from hydroopt.model.plant import Plant
from hydroopt.results.diagnostic import of_kind
from hydroopt.simulation.drive_valves import changes, drive
from hydroopt.solving import solve

CRANE = Path(__file__).parents[3] / "studies" / "actuator_coverage" / "crane.toml"
NAME = "jack.delay"


def crane(delay: float, sigma: float | None = None) -> Machine:
    machine = load_machine(str(CRANE))
    data = machine.model_dump()
    data["cylinders"][0]["circuit"]["valve"]["delay"] = delay
    changed = Machine.model_validate(data | {"notes": dict(machine.notes)})
    return changed.with_values({NAME: delay}, {NAME: Note(sigma=sigma)}) if sigma else changed


def driven(delay: float, rate: float = 100.0, seconds: float = 8.0, *, noise: bool = True, held: int = 1) -> Log:
    """Valve driven to both sides in steps; `held` samples long each."""
    t = np.arange(round(seconds * rate)) / rate
    coarse = t[np.arange(len(t)) // held * held]
    u = 5.7 - 1.3 * np.sin(2 * np.pi * (0.4 * coarse + 0.08 * coarse**2))
    return drive(Plant(crane(delay)), t, u[:, None], np.array([0.3]), noise=noise, seed=3)


def test_commands_arrive_between_samples() -> None:
    """A delay of 1.3 samples is that of 13 samples, ten times as short."""
    coarse, fine = driven(0.013, noise=False), driven(0.013, 1000.0, noise=False, held=10)
    for channel in ("jack.length", "jack.p_head", "jack.p_rod"):
        scale = np.ptp(fine.channels[channel])
        np.testing.assert_allclose(coarse.channels[channel], fine.channels[channel][::10], atol=1e-6 * scale)
    rounded = driven(0.010, noise=False)
    assert np.max(np.abs(rounded.channels["jack.p_head"] - coarse.channels["jack.p_head"])) > 1e4


def test_moments_of_samples_and_arrivals() -> None:
    t = np.array([0.0, 0.1, 0.2])
    at, samples = changes(t, np.array([0.0, 0.13, 0.1, 0.03]))
    np.testing.assert_allclose(at, [0.0, 0.03, 0.1, 0.13, 0.2], atol=1e-12)
    assert at[samples].tolist() == t.tolist()


@pytest.fixture(scope="module")
def problem() -> HydraulicProblem:
    machine = crane(0.010, 0.010)
    return hydraulic_problem(machine, [driven(0.0172, 200.0, noise=False, held=2)])


def test_derivatives_by_the_delay_are_those_of_finite_differences(problem: HydraulicProblem) -> None:
    (each,), known = problem.balanced, problem.parameters
    k, step = known.index(NAME), 1e-5
    values = known.nominal + np.eye(len(known))[k] * 0.0033
    at = each.balance.misclosure(each.readings, each.readings.values, values)
    high, low = (each.balance.misclosure(each.readings, each.readings.values, values + sign * step * np.eye(
        len(known))[k]).value for sign in (1, -1))
    slope = (high - low) / (2 * step)
    np.testing.assert_allclose(at.by_theta[:, :, k], slope, atol=1e-4 * np.max(np.abs(slope)))
    np.testing.assert_allclose(at.by_delay, at.by_theta[:, :, k])
    assert np.max(np.abs(slope)) > 0


def test_without_noise_a_delay_comes_back(problem: HydraulicProblem) -> None:
    """At 200 Hz: pressures count as straight between samples, which at 100 Hz moves it by 1.4 ms."""
    found = solve(problem)
    assert found.parameters[NAME].value == pytest.approx(0.0172, abs=3e-4)
    assert not of_kind(found.diagnostics, "commands arrive at another time than stated", "delay taken as exact")
    assert found.machine.numbers[NAME].value == pytest.approx(found.parameters[NAME].value)
    assert found.machine.notes[found.machine.numbers[NAME].path].sigma == pytest.approx(found.parameters[NAME].std)


def test_a_delay_that_is_stated_wrong_without_a_sigma_is_named() -> None:
    log = driven(0.060)
    wrong = solve(hydraulic_problem(crane(0.010), [log]))
    (said,) = of_kind(wrong.diagnostics, "commands arrive at another time than stated")
    assert said.subject == ("jack",)
    assert said.evidence["sense"] == "later"
    assert wrong.status == "suspect"
    right = solve(hydraulic_problem(crane(0.060), [log]))
    assert not of_kind(right.diagnostics, "commands arrive at another time than stated")
    (exact,) = of_kind(right.diagnostics, "delay taken as exact")
    assert exact.subject == ("jack",)
    assert right.status == "ok"
