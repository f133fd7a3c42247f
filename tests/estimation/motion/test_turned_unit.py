"""A turned unit on a swing, whose misfit in the short log is hardly above what counts, is named like any other."""

import numpy as np
import pytest

import hydroopt as ho
from hydroopt.estimation.motion.misread import examined_fit
from hydroopt.estimation.motion.problem import sensor_problem


@pytest.mark.slow
def test_a_turned_unit_that_hardly_misfits_is_named_where_all_agree_otherwise():
    machine = ho.load_machine("excavator_imu")
    rng = np.random.default_rng(0)
    true = machine.with_values({number.name: number.value + 0.5 * rng.normal() * machine.notes[number.path].sigma
                                for number in machine.geometry_numbers if number.name in machine.imu_numbers})
    model = ho.Model(true)
    log = ho.simulate(model, ho.random_trajectory(model, duration=15.0, rate=50.0, seed=400), seed=0)
    channels = {name: x for name, x in log.channels.items() if "_imu." in name}
    for kind in ("gyro", "accel"):
        x, y = channels[f"swing_imu.{kind}_x"], channels[f"swing_imu.{kind}_y"]
        channels |= {f"swing_imu.{kind}_x": -y, f"swing_imu.{kind}_y": x}
    cause = examined_fit(sensor_problem(machine, [ho.Log("drive", log.t, channels)], geometry=False))[1]
    assert cause is not None
    assert cause.subject == ("swing_imu",)
    assert "x = y, y = -x, z = z" in cause.text
