"""Which motions the pump sustains."""

import control
import numpy as np
import pytest

from hydroopt import Model, Plant, load_machine
from hydroopt.control.comparison import refuse_unstable
from hydroopt.control.linear_plant import sampled
from hydroopt.control.loops import Loops
from hydroopt.control.reference import SPARE, flow_demand, steady_speeds
from hydroopt.errors import ProblemError
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


@pytest.mark.parametrize(("duration", "refused"), [(30.0, False), (50.0, True)])
def test_a_loop_is_refused_if_its_errors_grow_to_e_times_within_the_motion(duration: float, refused: bool) -> None:
    """A pendulum that grows by exp(t/40): an undamped hook may, while a motion passes a posture."""
    growing, period = np.array([[1 / 40, 3.0], [-3.0, 1 / 40]]), 0.01
    plant = sampled(control.ss(growing, [[0.0], [1.0]], np.eye(2)[:1], 0), np.zeros(1), period)
    none = control.ss([], [], [], 0, period)
    found = Loops("motion at 1.0 s", ["loop"], plant, none, (0,)).margins
    assert found[0].growth == pytest.approx(1 / 40, rel=1e-6)
    if refused:
        with pytest.raises(ProblemError, match=r"'loop' is unstable with PI in the posture of the motion at 1\.0 s"):
            refuse_unstable("PI", found, duration)
    else:
        refuse_unstable("PI", found, duration)
