"""Integration of driven machines against CVODES at a relative tolerance of 1e-11, where oil cavitates, relief valves
open, commands stop at once and the tip hits a wall."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import casadi as ca
import numpy as np
import pytest

from hydroopt import load_machine
from hydroopt.model.hydraulics import AMBIENT, VACUUM
from hydroopt.model.model import Model
from hydroopt.model.plant import Plant, Wall
from hydroopt.spatial.inertia import Array

PERIOD = 0.02
FRICTION = 2000.0
"""Dry friction [N or N·m] of every actuator."""
COARSE, FINE = 5e-6, 1e-7
"""Errors at the tolerances 1e-7 and 1e-10 in typical sizes of states: 5e-6 rad and 50 Pa, 1e-7 rad and 1 Pa.
CVODES at 1e-7 errs by up to 8e-5 on these drives."""


class Drive(NamedTuple):
    """A machine in the middle of its range, its valves opened and shut at random by at most a part of their range; and
    what happens on the way."""

    machine: str
    seconds: float
    part: float
    seed: int
    happens: tuple[str, ...] = ()


CAVITATION, RELIEF, WALL = "oil cavitates", "a relief valve opens", "the tip hits a wall"
DRIVES = [
    Drive("patu655_lift", 1.0, 0.8, 0), Drive("cat215b", 0.4, 0.3, 2, (WALL,)),
    *(pytest.param(drive, marks=pytest.mark.slow) for drive in (
        Drive("cat215b", 0.4, 0.9, 1), Drive("cat215b", 3.0, 0.5, 3, (RELIEF,)),
        Drive("cat215b", 3.0, 1.0, 4, (RELIEF,)), Drive("cat215b", 2.0, 0.4, 5, (RELIEF, WALL)),
        Drive("tampere_manipulator", 2.0, 0.6, 6, (CAVITATION, RELIEF)),
        Drive("cat215b_bucket", 2.0, 0.5, 7, (RELIEF,)), Drive("backhoe", 2.0, 0.4, 8, (RELIEF,)),
        Drive("forestry_crane", 2.0, 0.3, 9)))]


def driven(plant: Plant, drive: Drive) -> tuple[Array, Array, Array]:
    """First state, commands (N, a) and dynamic parameters."""
    psi = plant.model.parameters.nominal.copy()
    for k, name in enumerate(plant.model.parameters.names):
        if name.endswith(("f_coulomb", "tau_coulomb")):
            psi[k] = FRICTION
    ranges = plant.machine.ranges
    at = plant.steady(np.mean(ranges, axis=1), np.zeros(len(ranges)), psi, plant.parameters.nominal)
    rng = np.random.default_rng(drive.seed)
    held = np.repeat(rng.choice([-1.0, 0.0, 1.0], (round(drive.seconds / 0.2), len(at.u))), 10, axis=0)
    span = np.array([abs(each.valve.span) for each in plant.actuators])
    return at.x, at.u + drive.part * span * held, psi


def by_cvodes(plant: Plant, x: Array, commands: Array, psi: Array, tolerance: float) -> Array:
    """States (N, nx) behind each period, by CVODES on CasADi's machine."""
    z, u, scale = ca.SX.sym("z", len(x)), ca.SX.sym("u", commands.shape[1]), plant.scale
    rates = plant.rates(z * scale, u, plant.supply, psi, plant.parameters.nominal) / scale
    step = ca.integrator("reference", "cvodes", {"x": z, "p": u, "ode": rates}, 0.0, PERIOD,
                         {"reltol": tolerance, "abstol": tolerance / 100, "max_num_steps": 100000})
    states = [x / scale]
    for given in commands:
        states.append(np.asarray(step(x0=states[-1], p=given)["xf"]).ravel())
    return np.array(states[1:]) * scale


def plant_of(drive: Drive) -> Plant:
    model = Model(load_machine(drive.machine))
    if WALL not in drive.happens:
        return Plant(model)
    plant = Plant(model)
    x, _, _ = driven(plant, drive)
    tip = np.asarray(model.forward_kinematics(x[:len(model.machine.joints)])[-1])[:3, 3]
    return Plant(model, Wall(tuple(tip - [0.0, 0.0, 0.005]), (0.0, 0.0, 1.0), stiffness=2e6, damping=0.3, friction=0.3))


@pytest.mark.parametrize("drive", DRIVES, ids=lambda drive: f"{drive.machine} {drive.seed}")
def test_integration_of_a_driven_machine_agrees_with_a_reference(drive: Drive) -> None:
    plant = plant_of(drive)
    x, commands, psi = driven(plant, drive)
    supplies = np.tile(plant.supply, (len(commands), 1))
    reference = by_cvodes(plant, x, commands, psi, 1e-11)

    def error(states: Array) -> float:
        return float(np.max(np.abs(states - reference) / plant.scale))

    def found(tolerance: float) -> Array:
        integrator = plant.integrator(psi, plant.parameters.nominal, tolerance=tolerance)
        return integrator.along(x, np.full(len(commands), PERIOD), commands, supplies)

    states = found(1e-7)
    assert error(states) < COARSE
    assert error(found(1e-10)) < FINE
    assert happened(plant, states) == drive.happens


def happened(plant: Plant, states: Array) -> tuple[str, ...]:
    n = len(plant.machine.joints)
    pressure = np.array([states[:, [plant.states.index(name) for name in each.chambers]] for each in plant.actuators])
    relief = np.array([each.actuator.relief_pressure or np.inf for each in plant.actuators])
    contact = [np.linalg.norm(np.asarray(plant.contact(x[:n], x[n:2 * n]))) for x in states]
    found = {CAVITATION: np.min(pressure) < VACUUM + 4e3 - AMBIENT, RELIEF: np.any(pressure > relief[:, None, None]),
             WALL: np.max(contact) > 0}
    return tuple(name for name, true in found.items() if true)


def test_a_pump_with_hardly_any_line_is_integrated_by_implicit_steps(tmp_path: Path) -> None:
    """10 mL instead of 10 L between pump and valves: the line's rate is 5e5 1/s, far beyond what is of interest."""
    text = (Path(__file__).parents[2] / "models" / "cat215b.toml").read_text()
    stiff = tmp_path / "stiff.toml"
    stiff.write_text(text.replace('volume = { value = "10 L"', 'volume = { value = "10 mL"'))
    plant, drive = Plant(Model(load_machine(str(stiff)))), Drive("cat215b", 0.4, 0.3, 2)
    x, commands, psi = driven(plant, drive)
    integrator = plant.integrator(psi, plant.parameters.nominal)
    found = integrator.along(x, np.full(len(commands), PERIOD), commands, np.tile(plant.supply, (len(commands), 1)))
    assert integrator.stiff
    assert integrator.steps < 40 * len(commands)  # explicit steps would be more than 2000 in each period
    reference = by_cvodes(plant, x, commands, psi, 1e-10)
    assert np.max(np.abs(found - reference) / plant.scale) < COARSE
