"""The generated valve commands: what the model in Python says, and what the plant then does."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from fixtures.library import NO_SUPPLY, OK, Library, held, machine, over, subject
from fixtures.tiers import tiered
from hydroopt.control.valve_inversion import RAMP, Valves
from hydroopt.model.model import Model
from hydroopt.model.plant import Plant
from hydroopt.simulation.simulate import Trajectory, forces

COUNT = 60
TOLERANCE = {"double": 1e-12, "float": 2e-5}
"""Of openings, which are parts of a full one; within the ramp the commands are steeper by STEEP."""
STEEP = 0.1 / RAMP


@pytest.fixture(scope="module", params=tiered(
    ["cat215b", "patu655_lift", "backhoe", "forestry_crane", "stewart_platform", "unmeasured", "sloping"],
    lambda name: name in ("patu655_lift", "backhoe")))
def plant(request: pytest.FixtureRequest) -> Plant:
    return Plant(Model(machine(request.param)))


def states(plant: Plant) -> dict[str, np.ndarray]:
    rng, joints, valves = np.random.default_rng(3), len(plant.machine.joints), (COUNT, len(plant.actuators))
    lower, upper = plant.machine.ranges.T
    q = held(lower + (upper - lower) * rng.uniform(0.05, 0.95, (COUNT, joints)))
    relief = [each.actuator.relief_pressure for each in plant.actuators if each.actuator.relief_pressure]
    high = min([2e7, *(0.95 * each for each in relief)])
    some = {"q": q, "qd": rng.uniform(-0.15, 0.15, q.shape), "qdd": rng.uniform(-0.3, 0.3, q.shape),
            "speed_added": rng.uniform(-0.02, 0.02, valves), "force_rate": rng.uniform(-5e4, 5e4, valves),
            "pressure_a": rng.uniform(3e6, high, valves), "pressure_b": rng.uniform(3e6, high, valves),
            "supply": np.tile([2.5e7, 3e5], (COUNT, 1)), "factor_extending": np.ones(valves),
            "factor_retracting": np.ones(valves)}
    return {name: held(values) for name, values in some.items()}


def said(plant: Plant, given: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    length, speed = (part[:, :, 0] for part in over(plant.actuator_motion, given["q"], given["qd"]))
    pressure = np.stack([given["pressure_a"], given["pressure_b"]], axis=2)
    valves = Valves(plant, plant.parameters.nominal)
    rows = zip(speed + given["speed_added"], given["force_rate"], length, pressure, given["supply"], strict=True)
    command, opening = zip(*(valves.command(*row) for row in rows), strict=True)
    return np.array(command), np.array(opening)


@pytest.mark.parametrize("real", [pytest.param("double", marks=pytest.mark.slow), "float"])
def test_c_says_what_the_model_says(plant: Plant, real: str, tmp_path) -> None:
    made = subject(plant.machine.name, real, "valve_feedforward")
    library, given = Library(made, tmp_path / "c", "-O2"), states(plant)
    status, results = library.call("valve_feedforward", library.prepare(), given, COUNT)
    command, opening = said(plant, given)
    motion = Trajectory(np.arange(COUNT), given["q"], given["qd"], given["qdd"])
    own = [plant.machine.actuators.index(each) for each in plant.machine.powered]
    force = forces(plant.model, motion, plant.model.parameters.nominal)[:, own]
    assert np.all(status == OK)
    tolerance = TOLERANCE[real]
    assert_allclose(results["opening"], opening, rtol=0, atol=tolerance)
    assert_allclose(results["command"], command, rtol=0,
                    atol=STEEP * tolerance * max(abs(each.valve.span) for each in plant.actuators))
    assert_allclose(results["force"], force, rtol=0, atol=tolerance * np.abs(force).max())


@pytest.mark.slow
def test_forces_of_the_plant_change_as_demanded(plant: Plant, tmp_path) -> None:
    """With the spools where the commands want them, A_a·p_a' − A_b·p_b' of the plant is what was asked for."""
    library = Library(subject(plant.machine.name, "double", "valve_feedforward"), tmp_path / "c", "-O1")
    given = states(plant)
    given["speed_added"][:] = 0.0
    _, results = library.call("valve_feedforward", library.prepare(), given, COUNT)
    psi, theta, names = plant.model.parameters.nominal, plant.parameters.nominal, list(plant.states)
    off = []
    for k in range(COUNT):
        x = np.zeros(len(names))
        x[:2 * len(given["q"][k])] = *given["q"][k], *given["qd"][k]
        if names[-1] == "pump.p_supply":
            x[-1] = given["supply"][k, 0]
        for i, each in enumerate(plant.actuators):
            chambers = [names.index(name) for name in names if name.startswith(f"{each.actuator.name}.p_")]
            x[chambers] = given["pressure_a"][k, i], given["pressure_b"][k, i]
            if each.spool_states:
                spool = names.index(f"{each.actuator.name}.spool")
                # the spool's own rate is zero where the command wants it: found by its equation, linear in the place
                u = results["command"][k]
                rate = np.asarray(plant.rates(x, u, given["supply"][k], psi, theta)).ravel()
                omega = 2 * np.pi * theta[plant.parameters.index(f"{each.actuator.name}.natural_frequency")]
                x[spool] = rate[spool + 1] / omega**2
        rates = np.asarray(plant.rates(x, results["command"][k], given["supply"][k], psi, theta)).ravel()
        shut = np.where([name.endswith(".spool") for name in names], 0.0, x)
        without = np.asarray(plant.rates(shut, results["command"][k], given["supply"][k], psi, theta)).ravel()
        for i, each in enumerate(plant.actuators):
            # below the ramp the command is smoothed, and a fully open valve gives what it gives
            if not 0.05 < abs(results["opening"][k, i]) < 0.95:
                continue
            chambers = [names.index(name) for name in names if name.startswith(f"{each.actuator.name}.p_")]
            change, idle = (np.array([1, -1]) * each.areas @ part[chambers] for part in (rates, without))
            off.append(abs(change - given["force_rate"][k, i]) / abs((change - idle) / results["opening"][k, i]))
    # in parts of a full opening; the rounded edges on the other side, which are never quite shut, account for it
    assert len(off) > COUNT / 3
    assert np.median(off) < 1e-3
    assert np.max(off) < 5e-3


def test_without_supply_there_is_no_command(plant: Plant, tmp_path) -> None:
    library = Library(subject(plant.machine.name, "double", "valve_feedforward"), tmp_path / "c", "-O0")
    given = {name: values[:1] for name, values in states(plant).items()} | {"supply": np.array([[3e5, 3e5]])}
    status, _ = library.call("valve_feedforward", library.prepare(), given, 1)
    assert status[0] == NO_SUPPLY
