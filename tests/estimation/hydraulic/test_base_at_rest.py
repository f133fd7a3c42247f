"""Valves of a machine whose base may move: identified at rest on a slope, and refused where the base moves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fixtures.drives import sloping
from hydroopt.errors import LogError, ProblemError
from hydroopt.estimation.hydraulic.problem import hydraulic_problem
from hydroopt.logs.log import Log
from hydroopt.machine.links import Note
from hydroopt.machine.machine import Machine
from hydroopt.model.model import Model
from hydroopt.model.plant import Plant
from hydroopt.simulation.drive_valves import commands_for, drive
from hydroopt.simulation.simulate import Trajectory
from hydroopt.solving import solve

SLOPE = np.array([0.1, -0.05])
"""Pitch and roll [rad]."""
FLOW = "boom_left.rated_flow"


def crane() -> Machine:
    """With sensors of the base, and with one flow in doubt."""
    machine = sloping()
    lengths = tuple(f"{each.name}.length" for each in machine.cylinders)
    sensors = [*machine.model_dump()["sensors"], {"channels": ("base_pitch.q", "base_roll.q"), "accuracy": 2e-4},
               {"channels": lengths, "accuracy": 1e-3}]
    machine = Machine.model_validate(machine.model_dump(exclude={"notes"}) | {"sensors": sensors})
    known = machine.numbers[FLOW]
    return machine.with_values({FLOW: known.value}, {FLOW: Note(sigma=0.2, relative=True)})


@pytest.fixture(scope="module")
def plant() -> Plant:
    return Plant(Model(crane()))


@pytest.fixture(scope="module")
def log(plant: Plant) -> Log:
    t = np.arange(150) / 50
    q = np.tile([*SLOPE, 0.1, 0.3, -1.2, 0.0], (len(t), 1))
    q[:, 3] += 0.05 * np.sin(2 * t)
    qd = np.gradient(q, t, axis=0)
    theta = plant.parameters.nominal.copy()
    theta[plant.parameters.index(FLOW)] *= 1.1
    commands = commands_for(plant, Trajectory(t, q, qd, np.gradient(qd, t, axis=0)))
    return drive(plant, t, commands, q[0], theta=theta, seed=1)


@pytest.mark.slow
def test_a_flow_is_found_on_a_slope(plant: Plant, log: Log) -> None:
    estimate = solve(hydraulic_problem(plant.machine, [log]))
    found = estimate.parameters[FLOW]
    assert found.value == pytest.approx(1.1 * plant.machine.numbers[FLOW].value, abs=4 * found.std)
    assert found.std < 0.02 * found.value
    assert np.all(estimate.adjustment.misfit < 1.2)


def test_a_log_in_which_the_base_moves_is_refused(plant: Plant, log: Log) -> None:
    rolls = log.channels["base_roll.q"] + 0.05 * np.sin(log.t)
    with pytest.raises(LogError, match=r"the base moves: base_roll\.q scatters by 0\.0\d+ rad; give logs in which it"):
        hydraulic_problem(plant.machine, [replace(log, channels={**log.channels, "base_roll.q": rolls})])


def test_a_motion_in_which_the_base_moves_drives_no_valves(plant: Plant) -> None:
    t = np.arange(3) / 50
    q = np.tile([*SLOPE, 0.1, 0.3, -1.2, 0.0], (len(t), 1))
    qd = np.zeros_like(q)
    qd[:, 1] = 0.1
    with pytest.raises(ProblemError, match="the base moves in this motion; let it stand still"):
        commands_for(plant, Trajectory(t, q, qd, 0 * qd))
