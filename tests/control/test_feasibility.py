"""Which motions the pump sustains."""

import numpy as np
import pytest

from hydroopt import Model, Plant, load_machine
from hydroopt.control.feasibility import SPARE, flow_demand, steady_speeds
from hydroopt.machine.environment import Pump

PLANT = Plant(Model(load_machine("cat215b")))
POSTURE = np.array([0.2, -0.4, 1.5])
LEAST = np.array([0.07, 0.05, 0.07])


def demand(qd: np.ndarray) -> float:
    return float(flow_demand(PLANT, POSTURE[None], qd[None])[0])


def most() -> float:
    pump = PLANT.machine.pump
    assert isinstance(pump, Pump)
    assert pump.max_flow is not None
    return pump.max_flow


def test_demand_is_what_growing_chambers_sweep() -> None:
    """Of the boom's cylinder alone: area times speed, by finite differences of its length."""
    qd, step = np.array([0.0, 0.1, 0.0]), 1e-6
    ends = [np.asarray(PLANT.actuator_motion(POSTURE + side * step * qd, qd)[0]).ravel()[1] for side in (-1, 1)]
    speed = (ends[1] - ends[0]) / (2 * step)
    a, b = PLANT.actuators[1].areas
    assert demand(qd) == pytest.approx((a if speed > 0 else b) * abs(speed), rel=1e-6)
    assert demand(-qd) == pytest.approx((b if speed > 0 else a) * abs(speed), rel=1e-6)


def test_speeds_that_the_pump_sustains_stay_and_slow_ones_are_raised() -> None:
    qd = np.array([-0.2, 0.01, 0.0])
    np.testing.assert_array_equal(steady_speeds(PLANT, POSTURE, qd, LEAST), [-0.2, 0.05, 0.07])


def test_faster_joints_are_slowed_until_the_flow_suffices() -> None:
    qd = np.array([0.6, -0.4, 0.01])
    assert demand(qd) > most()
    found = steady_speeds(PLANT, POSTURE, qd, LEAST)
    assert demand(found) == pytest.approx((1 - SPARE) * most(), rel=1e-6)
    assert found[0] / found[1] == pytest.approx(qd[0] / qd[1])
    assert found[2] == LEAST[2]
    PLANT.steady(POSTURE, found, PLANT.model.parameters.nominal, PLANT.parameters.nominal)
