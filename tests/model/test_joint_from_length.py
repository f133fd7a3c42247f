"""Joints from lengths of cylinders that drive them, straight or through a linkage."""

import casadi as ca
import numpy as np
import pytest

from fixtures.closures import six_bar, telescope
from fixtures.loops import excavator, measured_at_the_rocker, z_bar
from hydroopt.codegen.routines import Interface
from hydroopt.codegen.symbols import STRAIGHT
from hydroopt.errors import LogError, ProblemError
from hydroopt.logs.joint_angles import angle_channels, angle_noise, measured_angles
from hydroopt.logs.log import Log
from hydroopt.machine.geometry import Geometry
from hydroopt.machine.machine import Machine
from hydroopt.machine.mechanism import Mechanism
from hydroopt.model.inverse_kinematics import inverse_kinematics
from hydroopt.model.model import Model
from hydroopt.model.path_difference import path_difference


@pytest.mark.parametrize(("machine", "covered"), [
    (excavator, ("boom_cylinder", "stick_cylinder", "bucket_cylinder")),
    (measured_at_the_rocker, ("boom_cylinder", "stick_cylinder", "bucket_cylinder")),
    (z_bar, ("boom_jack",))])  # the other one's length depends on two joints
def test_lengths_lead_back_to_the_joint_over_its_range(machine, covered):
    model = Model(machine())
    assert tuple(model.triangles) == covered
    for row, cylinder in enumerate(machine().cylinders):
        if cylinder.name not in covered:
            continue
        joint = machine().main_joint(cylinder)
        angles = np.linspace(*machine().link(joint).joint.range, 101)
        q = np.zeros((101, len(machine().joints))) + [sum(machine().link(name).joint.range) / 2
                                                      for name in machine().joints]
        q[:, machine().joints.index(joint)] = angles
        lengths = model.over(model.cylinder_kinematics, q, 0 * q, 0 * q)[0][:, row, 0]
        to_length, to_angle = model.triangles[cylinder.name]
        np.testing.assert_allclose(np.asarray(to_length(angles)).ravel(), lengths, rtol=1e-13)
        np.testing.assert_allclose(np.asarray(to_angle(lengths)).ravel(), angles, atol=1e-12)


def test_a_log_of_lengths_needs_no_sensor_on_the_bucket():
    model = Model(excavator())
    q = np.column_stack([np.zeros(5), np.linspace(-0.3, 0.3, 5), np.linspace(-2, -1, 5), np.linspace(-2, 0, 5)])
    lengths = model.over(model.cylinder_kinematics, q, 0 * q, 0 * q)[0][:, :, 0]
    log = Log("lengths", np.arange(5.0), {"swing.q": q[:, 0]} | {
        f"{c.name}.length": lengths[:, k] for k, c in enumerate(excavator().cylinders)})
    np.testing.assert_allclose(measured_angles(model, log), q, atol=1e-12)
    sensor = excavator().sensor("bucket_cylinder.length")
    lever = model.over(model.cylinder_kinematics, q, 0 * q, 0 * q)[3][:, 2, 3]
    assert angle_noise(model, log)[3] == pytest.approx(sensor.std / np.mean(np.abs(lever)), rel=1e-6)


def lengths_alone(machine, q, **channels):
    """A log of cylinder lengths at joint vectors (N, n), and of other channels."""
    model = Model(machine)
    lengths = model.over(model.cylinder_kinematics, q, 0 * q, 0 * q)[0][:, :, 0]
    return model, Log("lengths", np.arange(float(len(q))), channels | {
        f"{c.name}.length": lengths[:, k] for k, c in enumerate(machine.cylinders)})


def spread(machine, count=200, seed=4):
    """Joint vectors (N, n) all over the joints' ranges."""
    lower, upper = machine.ranges.T
    return lower + (upper - lower) * np.random.default_rng(seed).random((count, len(lower)))


def test_a_joint_whose_cylinder_spans_two_follows_from_both_lengths():
    q = spread(z_bar())
    model, log = lengths_alone(z_bar(), q, **{"frame.q": q[:, 0]})
    assert angle_channels(model, log) == {"frame.q", "boom_jack.length", "tilt_jack.length"}
    np.testing.assert_allclose(measured_angles(model, log), q, atol=1e-12)


def test_joints_that_slide_follow_from_lengths():
    q = spread(telescope())
    np.testing.assert_allclose(measured_angles(*lengths_alone(telescope(), q)), q, atol=1e-12)


def test_noise_of_joints_that_several_lengths_give_together():
    """As the spread of the joints that noisy lengths give."""
    sensors = [{"channels": [f"{name}_jack.length"], "accuracy": 1e-4, "distribution": "gaussian"}
               for name in ("boom", "tilt")]
    machine = Machine.model_validate(z_bar().model_dump() | {"sensors": sensors})
    q = spread(machine, 4000)
    model, log = lengths_alone(machine, q, **{"frame.q": q[:, 0]})
    rng = np.random.default_rng(6)
    noisy = Log("noisy", log.t, {"frame.q": q[:, 0]} | {
        f"{name}_jack.length": log.channel(f"{name}_jack.length") + 1e-4 * rng.standard_normal(len(q))
        for name in ("boom", "tilt")})
    stated, found = angle_noise(model, log), np.std(measured_angles(model, noisy) - q, axis=0)
    assert found[2] == pytest.approx(stated[2], rel=0.1)


def test_lengths_that_no_posture_has_are_named_with_their_sample():
    q = spread(z_bar(), 5)
    model, log = lengths_alone(z_bar(), q, **{"frame.q": q[:, 0]})
    channels = {name: log.channel(name).copy() for name in log.channels}
    channels["tilt_jack.length"][3] = 5.0
    with pytest.raises(LogError, match=r"no posture of bucket on the way from mid-range has the readings at sample \d"):
        measured_angles(model, Log("lengths", log.t, channels))
    del channels["tilt_jack.length"]
    with pytest.raises(LogError, match=r"bucket\.q"):
        measured_angles(model, Log("lengths", log.t, channels))


def closing(routine):
    """A routine's check that its loop closes, which comes after that of its joints' ranges."""
    return next(guard for guard in routine.guards if guard.status == "OPEN_TRIANGLE")


@pytest.mark.slow
def test_generated_code_checks_that_loops_close():
    """Every routine that stands on the loop has a check that holds in the range and fails where it cannot close."""
    interface = Interface(excavator())
    given = [interface.inputs["q"], interface.inputs["geometry"]]
    for name in ("forward_kinematics", "cylinder_state", "inverse_dynamics", "regressor", "gravity_forces"):
        guard = closing(interface.routines[name])
        sine, geometry = ca.Function("sine", given, [guard.value]), interface.values["geometry"]
        assert abs(float(sine([0, 0, -1, -1], geometry))) > STRAIGHT
        assert not abs(float(sine([0, 0, -1, 1.2], geometry))) > STRAIGHT  # not a number: the bars do not reach


@pytest.mark.slow
def test_generated_code_checks_that_newtons_steps_close_loops():
    interface = Interface(six_bar())
    assert "inverse_kinematics" not in interface.routines  # the lever, which is the tip, follows the crank
    guard, q = closing(interface.routines["inverse_dynamics"]), interface.inputs["q"]
    sine = ca.Function("sine", [q], [guard.value])
    assert abs(float(sine(1.0))) > STRAIGHT
    assert not abs(float(sine(4.0))) > STRAIGHT


@pytest.mark.slow
def test_a_sensor_on_the_rocker_leaves_the_bucket_where_it_is():
    """The same postures whether the bucket or the rocker counts: inverse kinematics and points of a path."""
    bucket, rocker = Model(excavator()), Model(measured_at_the_rocker())
    q = np.array([[0.3, 0.1, -1.2, -0.7]])
    at = Mechanism(excavator()).positions(Geometry(excavator()), dict(zip(excavator().joints, q[0], strict=True)))
    same = np.array([[*q[0, :3], float(at["rocker"])]])
    tips = [model.over(model.forward_kinematics, where)[-1] for model, where in ((bucket, q), (rocker, same))]
    np.testing.assert_allclose(*tips, atol=1e-12)
    found = inverse_kinematics(rocker, tips[0][0, :3, 3], held={"swing": 0.3, "boom": 0.1})
    assert any(np.allclose(one.q, same[0], atol=1e-6) for one in found)
    angles = {joint: same[:, k] for k, joint in enumerate(rocker.machine.joints)}
    path = path_difference(rocker.machine, rocker.machine, angles, point="bucket")
    np.testing.assert_allclose(path.first[0], tips[0][0, :3, 3], atol=1e-12)
    assert "inverse_kinematics" in Interface(rocker.machine).routines


def test_joints_held_where_a_linkage_cannot_close_are_refused():
    with pytest.raises(ProblemError, match="cannot close where its joints are held"):
        inverse_kinematics(Model(measured_at_the_rocker()), [7.0, 0.0, 1.0], held={"rocker": 2.95})
