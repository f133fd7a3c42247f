"""Forces that a motion demands of valves: those that brake, and loads that drag their actuator along."""

from __future__ import annotations

import numpy as np
import pytest

from hydroopt import Model, Plant, load_machine
from hydroopt.control.reference import Demands, Reference
from hydroopt.control.valve_inversion import Valves
from hydroopt.errors import ProblemError
from hydroopt.simulation.simulate import Trajectory

RATE = 100.0
POSTURE = np.array([0.0, -0.2, 1.4])


def demands(t: np.ndarray, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> tuple[Demands, Plant]:
    """Of the CAT 215B's motion."""
    plant = Plant(Model(load_machine("cat215b")))
    return Demands(Valves(plant, plant.parameters.nominal), Reference(Trajectory(t, q, qd, qdd)), t), plant


@pytest.mark.parametrize("brakes", [True, False])
def test_a_swing_may_brake_by_more_than_the_pump_gives(brakes: bool) -> None:
    """The valve holds back the oil that leaves: its pressure is not the pump's."""
    t = np.arange(0.0, 1.0, 1 / RATE)
    end, still = 0.3 * np.array([1.0, 0.0, 0.0]), np.zeros((len(t), 3))
    made, plant = demands(t, POSTURE + t[:, None] * end, np.tile(end, (len(t), 1)), still)
    (a, b), (pump, tank) = plant.actuators[0].areas, plant.supply
    force = np.tile(np.array([0.0, 1e5, 1e5]), (len(t), 1))
    force[:, 0] = (-1.1 if brakes else 1.1) * (a * pump - b * tank)
    speed = np.tile([0.3, 0.0, 0.0], (len(t), 1))
    if brakes:
        made._refuse_force(t, force, speed)
    else:
        with pytest.raises(ProblemError, match="bar cannot produce"):
            made._refuse_force(t, force, speed)


def test_a_load_that_drags_its_cylinder_begins_without_a_cavity() -> None:
    """Sharp edges would leave less than no pressure behind a piston that a heavy load pulls."""
    t = np.arange(0.0, 1.0, 1 / RATE)
    still = np.zeros((len(t), 3))
    made, plant = demands(t, POSTURE + still, still, still)
    length = np.tile(np.asarray(plant.actuator_motion(POSTURE, still[0])[0]).ravel(), (len(t), 1))
    tank = plant.supply[1]
    force, speed = np.tile([0.0, 1e5, -2e5], (len(t), 1)), np.tile([0.0, 0.0, 1e-4], (len(t), 1))
    assert float(np.asarray(made.valves.steady(speed[0], force[0], plant.supply)).ravel()[2]) < 0
    p_a, p_b = made._pressures(t, length, speed, force, 0 * force)
    assert p_a[0, 2] == tank
    assert np.min(p_a[:, 2]) > 0  # no cavity opens later either
    assert np.min(p_b[:, 2]) > tank
