"""Clocks of groups of channels, estimated with the motion."""

import numpy as np
import pytest

import hydroopt as ho
from hydroopt.estimation.motion.problem import fit_motion, sensor_problem
from hydroopt.estimation.motion.sensed import sensed
from hydroopt.logs.clock import Clock
from hydroopt.logs.recording import Recording
from tests.estimation.motion.test_motion_fit import arm

LATE, FAST = 0.02, 0.003


def recording(seed: int, late: float = LATE, fast: float = FAST, duration: float = 30.0):
    """Angles and torques by another clock than the IMUs, and at another rate."""
    machine = arm('[[sensors]]\nchannels = ["boom.q", "stick.q"]\naccuracy = "0.1 deg"\n'
                  '[[sensors]]\nchannels = ["boom.tau", "stick.tau"]\naccuracy = "5 N*m"\n')
    model = ho.Model(machine)
    course = ho.random_trajectory(model, duration=duration, rate=100.0, seed=seed)
    log = ho.simulate(model, course, seed=seed + 1)
    units, bus = ({name: x for name, x in log.channels.items() if ("imu" in name) is imu} for imu in (True, False))
    stamps = log.t[::2] * (1 + fast) + late
    groups = (ho.Log("imu", log.t, units),
              ho.Log("bus", stamps, {name: x[::2] for name, x in bus.items()}))
    return machine, course, Recording("drive", groups, clocks={"bus": Clock(0.0, 0.05, 0.0, 0.01)})


@pytest.mark.parametrize(("late", "fast"), [
    (LATE, FAST), pytest.param(-0.05, 0.0, marks=pytest.mark.slow)])
def test_delay_and_drift_are_recovered_within_their_intervals(late, fast):
    machine, _, made = recording(3, late, fast)
    found = fit_motion(sensor_problem(machine, [made], geometry=False))
    spread = np.sqrt(np.diag(found.covariance))
    for name, true, fine in (("drive bus: delay", late, 2e-3), ("drive bus: drift", fast, 2e-4)):
        place = found.fit.places[name]
        assert abs(found.fit.value[place] - true) < 3 * spread[place]
        assert spread[place] < fine


def test_the_motion_is_given_when_forces_were_read():
    machine, course, made = recording(5)
    log, motion, _ = sensed(machine, made.log())
    true = (log.t - LATE) / (1 + FAST)
    for joint in range(2):
        expected = np.interp(true, course.t, course.qd[:, joint])
        inner = (true > 1) & (true < course.t[-1] - 1)
        assert np.sqrt(np.mean((motion.qd[inner, joint] - expected[inner]) ** 2)) < 2e-3


@pytest.mark.slow
def test_intervals_of_clocks_hold_the_truth():
    held = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        late, fast = 0.05 * rng.normal(), 0.01 * rng.normal()
        machine, _, made = recording(100 + seed, late, fast, duration=15.0)
        found = fit_motion(sensor_problem(machine, [made], geometry=False))
        spread = np.sqrt(np.diag(found.covariance))
        for name, true in (("drive bus: delay", late), ("drive bus: drift", fast)):
            place = found.fit.places[name]
            held.append(abs(found.fit.value[place] - true) < 1.96 * spread[place])
    assert np.mean(held) > 0.89


def test_sensors_are_calibrated_by_all_samples_of_a_merged_log():
    """Not by those that merging leaves, and with the clocks of the groups."""
    machine, _, made = recording(5)
    merged, whole = (sensor_problem(machine, [each]) for each in (made.log(), made))
    assert [group.size for group in merged.logs[0].groups] == [group.size for group in whole.logs[0].groups]
    assert merged.logs[0].clocks == whole.logs[0].clocks


def other_clock(model: ho.Model, seed: int, duration: float) -> tuple[ho.Log, np.ndarray, np.ndarray]:
    """Angles, and pressures by another clock; parameters; delay at the beginning, and growth to the end [s]."""
    truth = ho.random_truth(model, seed)
    course = ho.random_trajectory(model, duration=duration, rate=50.0, seed=seed)
    log = ho.simulate(model, course, truth, seed=seed)
    pressures, others = ({name: x for name, x in log.channels.items() if (".p_" in name) is kind}
                         for kind in (True, False))
    groups = (ho.Log("angles", log.t, others), ho.Log("can", log.t * (1 + FAST) + LATE, pressures))
    merged = Recording("drive", groups).log()
    late = merged.t - (merged.t - LATE) / (1 + FAST)
    return merged, truth, np.array([late[0], late[-1] - late[0]])


def test_forces_alone_tell_delay_and_drift_together():
    model = ho.Model(ho.load_machine("cat215b"))
    log, truth, true = other_clock(model, 2, 60.0)
    estimate = ho.solve(ho.identification_problem(model, [log]).free("delay", "clock"), intervals=False)
    std = np.sqrt(np.diag(estimate.freed.covariance))
    assert np.all(np.abs(estimate.freed.size - true) < 3 * std)
    assert np.all(std < 0.003)
    off = model.over(model.inverse_dynamics, *estimate.problem.experiments[0].inputs(), estimate.psi)[0] - model.over(
        model.inverse_dynamics, *estimate.problem.experiments[0].inputs(), truth)[0]
    assert np.sqrt(np.mean(off**2)) < 0.01 * np.sqrt(np.mean(estimate.problem.experiments[0].force**2))


@pytest.mark.slow
def test_intervals_by_forces_hold_the_truth_though_channels_are_interpolated():
    model, z = ho.Model(ho.load_machine("cat215b")), []
    for seed in range(20):
        log, _, true = other_clock(model, seed, 60.0)
        freed = ho.solve(ho.identification_problem(model, [log]).free("delay", "clock"), intervals=False).freed
        z.append((freed.size - true) / np.sqrt(np.diag(freed.covariance)))
    assert np.mean(np.abs(z) < 1.96) > 0.85
