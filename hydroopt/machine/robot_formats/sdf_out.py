"""Machines to SDF."""

from __future__ import annotations

from xml.etree import ElementTree

from hydroopt.machine.robot_formats.bodies import central
from hydroopt.machine.robot_formats.frames import roll_pitch_yaw
from hydroopt.machine.robot_formats.tree import RobotTree, TreeJoint, renamed
from hydroopt.machine.robot_formats.urdf_out import numbers, xml_text
from hydroopt.spatial.inertia import Array

VERSION = "1.11"
"""The first that states what a joint mimics."""


def sdf_text(tree: RobotTree) -> str:
    """SDF of a tree; its pins are left out. Each link stands in the frame of the joint that carries it.

    Links and joints share no names in SDF: a link that has a joint's becomes ``NAME.link``.
    """
    tree = renamed(tree, {link: f"{link}.link" for link in tree.masses if link in tree.joints})
    root = ElementTree.Element("sdf", version=VERSION)
    model = ElementTree.SubElement(root, "model", name=tree.name)
    for link, mass in tree.masses.items():
        element = ElementTree.SubElement(model, "link", name=link)
        if link in tree.before:
            ElementTree.SubElement(element, "pose", relative_to=tree.before[link].name).text = numbers([0] * 6)
        if mass is not None:
            _inertial(element, mass)
    for joint in tree.joints.values():
        _joint(model, joint)
    return xml_text(root)


def _inertial(link: ElementTree.Element, mass: Array) -> None:
    found = central(mass)
    inertial = ElementTree.SubElement(link, "inertial")
    ElementTree.SubElement(inertial, "pose").text = numbers((*found.com, 0, 0, 0))
    ElementTree.SubElement(inertial, "mass").text = repr(found.m)
    inertia = ElementTree.SubElement(inertial, "inertia")
    for key, value in zip(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), found.six, strict=True):
        ElementTree.SubElement(inertia, key).text = repr(float(value))


def _joint(model: ElementTree.Element, joint: TreeJoint) -> None:
    endless = joint.endless and joint.kind == "revolute"
    element = ElementTree.SubElement(model, "joint", name=joint.name, type="continuous" if endless else joint.kind)
    ElementTree.SubElement(element, "pose", relative_to=joint.parent).text = numbers(
        (*joint.origin[:3, 3], *roll_pitch_yaw(joint.origin[:3, :3])))
    ElementTree.SubElement(element, "parent").text = joint.parent
    ElementTree.SubElement(element, "child").text = joint.child
    if joint.kind == "fixed":
        return
    axis = ElementTree.SubElement(element, "axis")
    ElementTree.SubElement(axis, "xyz").text = numbers(joint.axis)
    _values(axis, "limit", {"lower": None if endless else joint.lower, "upper": None if endless else joint.upper,
                            "effort": joint.max_effort, "velocity": joint.max_speed})
    spring = joint.spring
    _values(axis, "dynamics", {"damping": joint.viscous or None, "friction": joint.coulomb or None,
                               "spring_reference": spring.reference if spring else None,
                               "spring_stiffness": spring.stiffness if spring else None})
    if joint.mimic is not None:
        mimic = ElementTree.SubElement(axis, "mimic", joint=joint.mimic.master)
        for key, value in {"multiplier": joint.mimic.ratio, "offset": joint.mimic.offset, "reference": 0.0}.items():
            ElementTree.SubElement(mimic, key).text = repr(float(value))


def _values(axis: ElementTree.Element, tag: str, values: dict[str, float | None]) -> None:
    """An element of those values that are known."""
    element = ElementTree.SubElement(axis, tag)
    for key, value in values.items():
        if value is not None:
            ElementTree.SubElement(element, key).text = repr(float(value))
