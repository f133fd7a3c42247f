"""IMUs read in wrong units, with wrong signs or axes are named; drifting biases and ends of ranges, too."""

import numpy as np
import pytest

import hydroopt as ho
from hydroopt.errors import HydrooptError, LogError
from hydroopt.estimation.motion.misread import examined_fit
from hydroopt.estimation.motion.problem import sensor_problem
from hydroopt.estimation.motion.sensed import sensed
from tests.estimation.motion.test_motion_fit import arm, simulated, truth


def scaled(log: ho.Log, unit: str, kind: str, factor: float) -> ho.Log:
    return ho.Log("drive", log.t, {name: x * factor if name.startswith(f"{unit}.{kind}") else x
                                   for name, x in log.channels.items()})


def turned(log: ho.Log) -> ho.Log:
    channels = dict(log.channels)
    for kind in ("gyro", "accel"):
        channels[f"stick_imu.{kind}_x"] = -log.channel(f"stick_imu.{kind}_y")
        channels[f"stick_imu.{kind}_y"] = log.channel(f"stick_imu.{kind}_x")
    return ho.Log("drive", log.t, channels)


@pytest.fixture(scope="module")
def drive():
    machine = arm()
    return machine, simulated(truth(machine, 1), 2)[1]


@pytest.mark.parametrize(("made", "said"), [
    pytest.param(lambda log: scaled(log, "boom_imu", "gyro", 180 / np.pi), "boom_imu.*rates in deg/s, not in rad/s",
                 marks=pytest.mark.slow),
    pytest.param(lambda log: scaled(log, "stick_imu", "accel", 1 / 9.80665), "stick_imu.*specific forces in g",
                 marks=pytest.mark.slow),
    pytest.param(lambda log: scaled(log, "stick_imu", "accel", -1), "stick_imu.*the other sign of gravity",
                 marks=pytest.mark.slow),
    pytest.param(turned, "stick_imu.*axes turned: x = y, y = -x, z = z", marks=pytest.mark.slow)])
def test_a_misread_unit_is_named(drive, made, said):
    machine, log = drive
    with pytest.raises(HydrooptError, match=said):
        sensed(machine, made(log))


@pytest.mark.slow
def test_all_units_in_g_are_named(drive):
    machine, log = drive
    with pytest.raises(HydrooptError, match=r"boom_imu, stick_imu.*specific forces in g"):
        sensed(machine, scaled(scaled(log, "boom_imu", "accel", 1 / 9.80665), "stick_imu", "accel", 1 / 9.80665))


def test_a_sound_log_is_not_examined_further(drive):
    machine, log = drive
    assert examined_fit(sensor_problem(machine, [log]))[1] is None


def test_a_drifting_bias_is_named(drive):
    machine, log = drive
    drifting = {**log.channels, "boom_imu.gyro_z": log.channel("boom_imu.gyro_z") + np.radians(0.02) * log.t}
    kinds = {found.kind: found for found in ho.solve(sensor_problem(machine, [ho.Log("drive", log.t, drifting)])
                                                     ).diagnostics}
    assert "boom_imu.gyro_z" in kinds["bias drifts"].subject
    assert "bias drifts" not in {found.kind for found in ho.solve(sensor_problem(machine, [log])).diagnostics}


def test_places_of_units_far_beyond_their_sigmas_are_named():
    machine = arm('[[sensors]]\nchannels = ["boom.q", "stick.q"]\naccuracy = "0.1 deg"\n')
    kinds = []
    for factor in (0.5, 3.0):
        rng = np.random.default_rng(3)
        off = {number.name: number.value + factor * rng.choice((-1, 1)) * machine.notes[number.path].sigma
               for number in machine.geometry_numbers if number.name in machine.imu_numbers}
        answer = ho.solve(sensor_problem(machine, [simulated(machine.with_values(off), 2)[1]], geometry=False))
        kinds.append({found.kind: found for found in answer.diagnostics})
    assert "stated numbers contradicted" not in kinds[0]
    found = kinds[1]["stated numbers contradicted"]
    assert set(found.subject) <= machine.imu_numbers
    assert found.evidence["group"] == "places of the IMUs"
    assert answer.status is ho.Status.SUSPECT


def test_the_end_of_a_range_does_not_count_and_is_named(drive):
    machine, log = drive
    limit = machine.imus[0].gyroscope.range
    high = np.where(np.arange(log.size) % 50 < 5, limit, log.channel("boom_imu.gyro_z"))
    answer = ho.solve(sensor_problem(machine, [ho.Log("drive", log.t, {**log.channels, "boom_imu.gyro_z": high})]))
    assert [found.subject for found in answer.diagnostics if found.kind == "sensor saturated"] == [("boom_imu.gyro_z",)]
    assert answer.status is ho.Status.OK


def test_a_joint_that_nobody_measures_is_named():
    machine = arm()
    _, log = simulated(machine, 2, duration=5.0)
    only = ho.Log("drive", log.t, {name: x for name, x in log.channels.items() if name.startswith("boom_imu")})
    with pytest.raises(LogError, match="no reading depends on the joint 'stick'"):
        sensed(machine, only)
