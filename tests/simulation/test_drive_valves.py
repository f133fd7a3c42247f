"""Machines driven by their valves: against the plant integrated by SciPy, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from hydroopt import Model, load_machine
from hydroopt.errors import ProblemError
from hydroopt.model.plant import Plant
from hydroopt.simulation.drive_valves import arrived, commands_for, drive, random_numbers
from hydroopt.simulation.simulate import Trajectory

CRANE = Path(__file__).parents[2] / "studies" / "actuator_coverage" / "crane.toml"


@pytest.fixture(scope="module")
def plant():
    return Plant(Model(load_machine(str(CRANE))))


def swing(seconds=2.0, rate=50):
    t = np.arange(round(seconds * rate)) / rate
    fade = np.sin(np.pi * t / seconds) ** 2
    q = np.radians(30) + fade * (np.radians(3) * np.sin(6 * t) + np.radians(1) * np.sin(16 * t))
    qd = np.gradient(q, t)
    return Trajectory(t, q[:, None], qd[:, None], np.gradient(qd, t)[:, None])


@pytest.mark.slow
def test_a_driven_machine_moves_as_scipy_says(plant):
    motion = swing()
    commands = commands_for(plant, motion)
    log = drive(plant, motion.t, commands, motion.q[0], noise=False)
    psi, theta = plant.model.parameters.nominal, plant.parameters.nominal
    x = plant.steady(motion.q[0], np.zeros(1), psi, theta).x
    for k in range(40):
        x = solve_ivp(lambda _, y, u=commands[k]: np.asarray(
            plant.rates(y * plant.scale, u, plant.supply, psi, theta)).ravel() / plant.scale,
            (0, 0.02), x / plant.scale, method="Radau", rtol=1e-9, atol=1e-11).y[:, -1] * plant.scale
    assert log.channels["lift.q"][40] == pytest.approx(x[0], abs=1e-7)
    assert log.channels["jack.p_head"][40] == pytest.approx(x[plant.states.index("jack.p_head")], rel=1e-6)
    assert log.channels["jack.p_rod"][40] == pytest.approx(x[plant.states.index("jack.p_rod")], rel=1e-6)
    assert np.ptp(log.channels["lift.q"]) > np.radians(2)


def test_sensors_err_as_stated_and_commands_do_not(plant):
    motion = swing()
    commands = commands_for(plant, motion)
    exact, noisy = (drive(plant, motion.t, commands, motion.q[0], noise=noise, seed=4) for noise in (False, True))
    off = noisy.channels["jack.p_head"] - exact.channels["jack.p_head"]
    assert 2e4 < np.std(off) < 4e4
    assert np.max(np.abs(off)) <= 5e4
    assert np.array_equal(noisy.channels["jack.u"], commands[:, 0])
    assert noisy.units["jack.u"] == "V"


def test_commands_arrive_late():
    t = np.arange(10) * 0.1
    assert arrived(t, np.arange(10.0), 0.2).tolist() == [0, 0, 0, 1, 2, 3, 4, 5, 6, 7]


def test_random_numbers_stay_within_bounds_and_leave_what_is_exact(plant):
    draws = np.array([random_numbers(plant, seed) for seed in range(200)])
    known = np.diag(plant.parameters.information) > 0
    assert np.all(draws >= plant.parameters.lower)
    assert np.all(np.ptp(draws[:, ~known], axis=0) == 0)
    k = plant.parameters.index("oil.bulk_modulus")
    assert np.std(draws[:, k]) == pytest.approx(plant.parameters.scale[k], rel=0.15)


def test_a_machine_that_leaves_its_range_is_refused(plant):
    t = np.arange(500) / 50
    with pytest.raises(ProblemError, match="drive lift out of its range after"):
        drive(plant, t, np.full((500, 1), 4.5), np.radians([30.0]))
    with pytest.raises(ProblemError, match="not evenly spaced"):
        drive(plant, t**2, np.full((500, 1), 5.7), np.radians([30.0]))
