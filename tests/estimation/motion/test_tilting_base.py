"""A base that tilts, measured by an IMU on it alone."""

import numpy as np
import pytest

import hydroopt as ho
from hydroopt.estimation.motion.paths import motion
from hydroopt.estimation.motion.problem import fit_motion, sensor_problem
from hydroopt.machine.machine_file import read_machine

TILTING = '''
name = "tilting"
based_on = "excavator_imu"
[base_motion]
pitch = { lower = "-15 deg", upper = "15 deg" }
roll = { lower = "-15 deg", upper = "15 deg" }
[[imus]]
name = "base_imu"
link = "base"
position = ["0 m", "0.5 m", "0.3 m"]
rate = "100 Hz"
gyroscope = { noise = "0.01 deg/s/Hz^0.5", bias = "0.2 deg/s" }
accelerometer = { noise = "100e-6 g_0/Hz^0.5", bias = "5e-3 g_0" }
'''


@pytest.mark.slow
def test_roll_and_pitch_of_the_base_follow_sample_by_sample():
    machine = read_machine(TILTING)
    model = ho.Model(machine)
    course = ho.random_trajectory(model, duration=30.0, rate=100.0, seed=1)
    log = ho.simulate(model, course, seed=2)
    found = fit_motion(sensor_problem(machine, [log], geometry=False))
    path = found.fit.stretches[0].path
    support = path.support(log.t)
    error = motion(path, support)[0] - course.q
    assert machine.joints[:2] == ("base_pitch", "base_roll")
    assert np.all(np.sqrt(np.mean(error[:, :2] ** 2, axis=0)) < np.radians(0.03))
    assert np.all(np.abs(error[:, :2]) < 5 * found.std(0, support)[:, :2])
