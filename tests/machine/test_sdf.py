"""Exported SDF: its poses, bodies and joints, read by rules of SDF, make the same forces."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np
import pytest

from hydroopt.machine.machine import BASE
from hydroopt.machine.machine_file import load_machine
from hydroopt.machine.robot_formats.frames import CentralInertia, from_roll_pitch_yaw, pose
from hydroopt.machine.robot_formats.machine_tree import machine_tree
from hydroopt.machine.robot_formats.tree import Mimic, TreeJoint, one_tree
from hydroopt.machine.robot_formats.writing import robot_files


def tree_of(text: str):
    """Links and joints of an SDF, each link in the frame of the joint before it."""
    model = ElementTree.fromstring(text.partition("?>")[2].replace(".link<", "<").replace('.link"', '"')).find("model")

    def number(element, path):
        found = element.find(path)
        return None if found is None else float(found.text)

    masses, joints = {}, []
    for link in model.findall("link"):
        inertial = link.find("inertial")
        masses[link.get("name")] = None if inertial is None else CentralInertia(
            number(inertial, "mass"), np.array(inertial.findtext("pose").split()[:3], float),
            np.array([number(inertial, f"inertia/i{key}") for key in ("xx", "xy", "xz", "yy", "yz", "zz")])).pseudo()
        at = link.find("pose")
        assert at is None or not any(map(float, at.text.split()))
    for joint in model.findall("joint"):
        place, kind = joint.find("pose"), joint.get("type")
        assert place.get("relative_to") == joint.findtext("parent")
        assert model.find(f"link[@name='{joint.findtext('child')}']/pose").get("relative_to") == joint.get("name")
        values = np.array(place.text.split(), float)
        mimic = joint.find("axis/mimic")
        joints.append(TreeJoint(
            name=joint.get("name"), kind="revolute" if kind == "continuous" else kind, parent=joint.findtext("parent"),
            child=joint.findtext("child"), origin=pose(from_roll_pitch_yaw(values[3:]), values[:3]),
            axis=np.array((joint.findtext("axis/xyz") or "0 0 1").split(), float), endless=kind == "continuous",
            lower=number(joint, "axis/limit/lower"), upper=number(joint, "axis/limit/upper"),
            max_speed=number(joint, "axis/limit/velocity"), max_effort=number(joint, "axis/limit/effort"),
            viscous=number(joint, "axis/dynamics/damping") or 0.0,
            coulomb=number(joint, "axis/dynamics/friction") or 0.0,
            mimic=None if mimic is None else Mimic(mimic.get("joint"), number(mimic, "multiplier"),
                                                   number(mimic, "offset"))))
    return one_tree("x.sdf", model.get("name"), masses, joints)


@pytest.mark.parametrize("name", ["cat215b", "kr300", "forestry_crane", "scissor_lift"])
def test_it_says_what_the_machine_is(name: str) -> None:
    machine = load_machine(name)
    found, expected = tree_of(robot_files(machine, "x.sdf").files["x.sdf"]), machine_tree(machine)
    assert found.root == expected.root
    assert {BASE, *found.joints} >= set(expected.joints)
    for joint, own in expected.joints.items():
        other = found.joints[joint]
        assert (other.kind, other.parent, other.child, other.endless) == (own.kind, own.parent, own.child, own.endless)
        np.testing.assert_allclose(other.origin, own.origin, rtol=0, atol=1e-14)
        np.testing.assert_array_equal(other.axis, own.axis)
        assert (other.viscous, other.coulomb, other.max_speed, other.mimic) == (own.viscous, own.coulomb, own.max_speed,
                                                                                own.mimic)
        if not own.endless:
            assert (other.lower, other.upper) == (own.lower, own.upper)
    for link, mass in expected.masses.items():
        assert (found.masses[link] is None) == (mass is None)
        if mass is not None:
            np.testing.assert_allclose(found.masses[link], mass, rtol=0, atol=1e-12 * np.abs(mass).max())


def test_what_an_sdf_cannot_say_is_listed() -> None:
    written = robot_files(load_machine("cat215b"), "x.sdf")
    assert list(written.files) == ["x.sdf"]
    assert "the rod of 'stick_cylinder' hangs on no pin" in written.lost
