"""The fitted motion: its derivatives by finite differences, its errors against simulated truth."""

from dataclasses import replace

import numpy as np
import pytest

import hydroopt as ho
from hydroopt.estimation.motion.motion_fit import MotionFit
from hydroopt.estimation.motion.observations import Common
from hydroopt.estimation.motion.paths import motion
from hydroopt.estimation.motion.problem import fit_motion, sensor_problem
from hydroopt.machine.machine_file import read_machine
from hydroopt.machine.parameter_kind import ParameterKind

ARM = '''
name = "arm"
bandwidth = "2 Hz"
[[links]]
name = "boom"
joint = { type = "revolute", a = "3 m", alpha = "0 deg", lower = "-60 deg", upper = "60 deg", max_speed = "40 deg/s" }
[[links]]
name = "stick"
joint = { type = "revolute", a = "2 m", lower = "-120 deg", upper = "0 deg", max_speed = "60 deg/s" }
[[drives]]
name = "boom_drive"
joint = "boom"
[[drives]]
name = "stick_drive"
joint = "stick"
[[imus]]
name = "boom_imu"
link = "boom"
position = { value = ["1.5 m", "0.2 m", "0 m"], sigma = "3 cm" }
orientation = { value = ["0 deg", "0 deg", "0 deg"], sigma = "2 deg" }
rate = "50 Hz"
gyroscope = { noise = "0.02 deg/s/Hz^0.5", bias = "0.3 deg/s", range = "200 deg/s" }
accelerometer = { noise = "2e-3 m/s^2/Hz^0.5", bias = "0.03 m/s^2" }
[[imus]]
name = "stick_imu"
link = "stick"
position = { value = ["1.0 m", "0.1 m", "0 m"], sigma = "3 cm" }
orientation = { value = ["0 deg", "0 deg", "0 deg"], sigma = "2 deg" }
rate = "50 Hz"
gyroscope = { noise = "0.02 deg/s/Hz^0.5", bias = "0.3 deg/s", range = "200 deg/s" }
accelerometer = { noise = "2e-3 m/s^2/Hz^0.5", bias = "0.03 m/s^2" }
'''
"""A planar arm whose plane is level: gravity along −z of the base, across the joints' axes."""


def arm(more: str = "") -> ho.Machine:
    return read_machine("orientation = [\"90 deg\", \"0 deg\", \"0 deg\"]\n" + ARM + more)


def truth(machine: ho.Machine, seed: int) -> ho.Machine:
    """The machine with its IMUs elsewhere, within what the file states."""
    rng = np.random.default_rng(seed)
    return machine.with_values({number.name: number.value + rng.normal() * machine.notes[number.path].sigma
                                for number in machine.geometry_numbers if number.name in machine.imu_numbers})


def simulated(machine: ho.Machine, seed: int, duration: float = 20.0):
    model = ho.Model(machine)
    course = ho.random_trajectory(model, duration=duration, rate=50.0, seed=seed)
    return course, ho.simulate(model, course, seed=seed + 1000)


def angles(found, log):
    path = found.fit.stretches[0].path
    support = path.support(log.t)
    return motion(path, support), found.std(0, support)


def test_steps_are_those_of_the_objective_differentiated_numerically():
    machine = arm('[[sensors]]\nchannels = ["boom.q"]\naccuracy = "0.2 deg"\n')
    _, log = simulated(truth(machine, 1), 2, duration=4.0)
    fit = fit_motion(sensor_problem(machine, [log])).fit
    rng = np.random.default_rng(0)
    fit = replace(fit, value=fit.value + 0.3 * fit.sigma * rng.normal(size=len(fit.value)),
                  stretches=(fit.stretches[0].moved(0.01 * rng.normal(size=fit.stretches[0].path.coefficients.shape)),))
    (equations,), *_ = fit.linearised()
    prior = np.array([each.prior for each in fit.common])
    by_common = equations.right_corner - (fit.value - prior) / fit.sigma**2
    for place in (0, 3, 8, len(fit.value) - 1):
        step = np.zeros_like(fit.value)
        step[place] = 1e-4 * fit.sigma[place]
        numeric = (replace(fit, value=fit.value - step).linearised().objective
                   - replace(fit, value=fit.value + step).linearised().objective)
        assert numeric / (4 * step[place]) == pytest.approx(by_common[place], rel=1e-4, abs=1e-3)
    size = fit.stretches[0].path.coefficients.shape
    for place in (0, 7, 20):
        step = np.zeros(size)
        step.flat[place] = 1e-6
        numeric = (replace(fit, stretches=(fit.stretches[0].moved(-step),)).linearised().objective
                   - replace(fit, stretches=(fit.stretches[0].moved(step),)).linearised().objective)
        assert numeric / 4e-6 == pytest.approx(equations.right[place], rel=1e-4, abs=1.0)


def test_imus_alone_tell_angles_and_where_they_sit():
    machine = arm()
    true = truth(machine, 5)
    course, log = simulated(true, 6, duration=40.0)
    assert not [channel for channel in log.channels if channel.endswith(".q")]
    found = fit_motion(sensor_problem(machine, [log]))
    (q, qd, _, _), std = angles(found, log)
    # of a joint whose link carries another one, both ends are seen; the last link's own angle stays with its mounting
    assert np.sqrt(np.mean((q[:, 0] - course.q[:, 0]) ** 2)) < np.radians(0.05)
    assert np.all(np.abs(q - course.q) < 4 * std)
    assert np.sqrt(np.mean((qd - course.qd) ** 2)) < 2e-3
    spread = np.sqrt(np.diag(found.covariance))
    for k, each in enumerate(found.fit.common):
        if each.name in true.imu_numbers:
            assert abs(found.fit.value[k] - true.numbers[each.name].value) < 4 * spread[k], each.name


def test_gyroscopes_beside_coarse_angles_make_speeds_and_accelerations_far_better():
    coarse = '[[sensors]]\nchannels = ["boom.q", "stick.q"]\naccuracy = "0.1 deg"\n'
    machine = arm(coarse)
    course, log = simulated(machine, 3, duration=30.0)
    only = ho.Log("angles", log.t, {name: x for name, x in log.channels.items() if name.endswith(".q")})
    with_gyros, without = (fit_motion(sensor_problem(machine, [each], geometry=False)) for each in (log, only))
    errors = [[np.sqrt(np.mean((found - true) ** 2)) for found, true in zip(angles(fit, log)[0][:3], (
        course.q, course.qd, course.qdd), strict=True)] for fit in (with_gyros, without)]
    assert np.all(np.array(errors[1]) > [2, 4, 4] * np.array(errors[0]))


def test_a_common_number_without_a_reading_keeps_its_prior():
    numbers = (Common("a", ParameterKind.LENGTH, "m", 1.0, 0.1),)
    fit = MotionFit({}, (), numbers, np.array([1.0]), np.ones(1), np.zeros(1), np.ones(1))
    _, matrix, right, total = fit.linearised()
    assert (matrix.item(), right.item(), total) == (pytest.approx(100.0), 0.0, 0.0)


@pytest.mark.slow
def test_intervals_hold_the_truth():
    machine = arm('[[sensors]]\nchannels = ["stick.q"]\naccuracy = "0.2 deg"\ndistribution = "gaussian"\n')
    held, count, positions = 0, 0, []
    for seed in range(60):
        true = truth(machine, seed)
        course, log = simulated(true, 500 + seed, duration=15.0)
        found = fit_motion(sensor_problem(machine, [log]))
        spread = np.sqrt(np.diag(found.covariance))
        for k, each in enumerate(found.fit.common):
            if each.name in true.imu_numbers and spread[k] < 0.7 * each.sigma:
                held += abs(found.fit.value[k] - true.numbers[each.name].value) < 1.96 * spread[k]
                count += 1
        (q, *_), std = angles(found, log)
        positions.append(np.mean(np.abs(q - course.q) < 1.96 * std))
    assert 0.92 < held / count < 0.98
    assert 0.91 < np.mean(positions) < 0.99
