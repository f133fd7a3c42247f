"""Joints from lengths as expressions: which joints, and that the posture comes back from its own lengths."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from fixtures.drives import BENT, crane, crossing
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import load_machine
from hydroopt.model.joints_from_readings import slides, together
from hydroopt.model.model import Model
from oracles.subjects import machine as machine_of
from oracles.subjects import states


def told(machine: Machine) -> list[tuple[set[str], set[str], set[str]]]:
    """Joints, cylinders, and joints that must be known, of each group."""
    names = [each.name for each in machine.cylinders]
    return [({machine.joints[k] for k in each.joints}, {names[k] for k in each.cylinders},
             {machine.joints[k] for k in each.given}) for each in together(Model(machine))]


def test_groups_are_joints_that_share_cylinders() -> None:
    swing = ({"swing"}, {"swing_left", "swing_right"}, set())
    boom = ({"boom"}, {"boom_left", "boom_right"}, set())
    assert told(crane()) == [swing, boom]
    assert told(crossing(grapple=BENT)) == [swing, boom, ({"grapple"}, {"grab"}, {"stick"})]
    assert told(load_machine("cat215b")) == []


def test_lengths_on_both_sides_of_a_dead_point_tell_nothing() -> None:
    assert "grapple" not in {joint for joints, _, _ in told(crossing()) for joint in joints}


def test_one_length_does_not_tell_two_joints() -> None:
    data = crossing(grapple=BENT).model_dump()
    data["cylinders"] = [each for each in data["cylinders"] if each["name"] != "reach"]
    data["motors"] = [{"name": "stick_motor", "joint": "stick", "torque_per_pressure": 1e-4}]
    data["sensors"] = ()
    assert "grapple" not in {joint for joints, _, _ in told(Machine.model_validate(data)) for joint in joints}


@pytest.mark.parametrize("machine", [crossing(grapple=BENT), load_machine("wheel_loader")], ids=["crossing", "loader"])
def test_postures_come_back_from_their_lengths(machine: Machine) -> None:
    model = Model(machine)
    q, qd, qdd = states(machine, np.random.default_rng(5), 50)
    lengths = model.over(model.cylinder_kinematics, q, qd, qdd)[0][:, :, 0]
    for group in together(model):
        given, length = ca.SX.sym("q", len(machine.joints)), ca.SX.sym("length", len(group.cylinders))
        known = ca.SX(given)
        known[list(group.joints)] = 0
        found, step, _ = group.solved(model.dynamics, known, length)
        function = ca.Function("solved", [given, length], [found, step])
        for posture, measured in zip(q, lengths[:, list(group.cylinders)], strict=True):
            back, last = (np.array(each).ravel() for each in function(posture, measured))
            np.testing.assert_allclose(back, posture[list(group.joints)], rtol=0, atol=1e-11)
            assert np.max(np.abs(last)) < 1e-6
            assert not np.max(np.abs(np.array(function(posture, measured + 0.5)[1]))) < 1e-5


@pytest.mark.parametrize(("name", "joint"), [("tampere_manipulator", "telescope"), ("made_up", "slide")])
def test_slides_come_back_from_their_lengths(name: str, joint: str) -> None:
    model = Model(machine_of(name))
    (slide,) = slides(model)
    assert model.machine.joints[slide.joint] == joint
    length = ca.SX.sym("length")
    function = ca.Function("slide", [length], [*slide.solved(model.geometry, length)])
    q, qd, qdd = states(model.machine, np.random.default_rng(6), 20)
    measured = model.over(model.cylinder_kinematics, q, qd, qdd)[0][:, slide.cylinder, 0]
    for posture, one in zip(q, measured, strict=True):
        assert float(function(one)[0]) == pytest.approx(posture[slide.joint], abs=1e-12)
    # a cylinder beside the slide is longer than its distance from it
    assert float(function(0.0)[1]) < 0 or name == "tampere_manipulator"
