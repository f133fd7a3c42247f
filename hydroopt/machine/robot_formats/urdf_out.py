"""Machines to URDF."""

from __future__ import annotations

from xml.etree import ElementTree

from hydroopt.machine.robot_formats.bodies import central
from hydroopt.machine.robot_formats.frames import ORIGIN, roll_pitch_yaw
from hydroopt.machine.robot_formats.tree import RobotTree, TreeJoint
from hydroopt.spatial.inertia import Array


def urdf_text(tree: RobotTree) -> str:
    """URDF of a tree; its pins are left out, since a URDF has no loops.

    Effort and velocity are zero where the machine file states none, as in most files.
    """
    robot = ElementTree.Element("robot", name=tree.name)
    for link, mass in tree.masses.items():
        element = ElementTree.SubElement(robot, "link", name=link)
        if mass is not None:
            _inertial(element, mass)
    for joint in tree.joints.values():
        _joint(robot, joint)
    for joint in tree.joints.values():
        if joint.gear != 1.0:
            _transmission(robot, joint)
    return xml_text(robot)


def xml_text(root: ElementTree.Element) -> str:
    """An XML document, indented."""
    ElementTree.indent(root)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def numbers(values: object) -> str:
    """Numbers as they are in memory, so that reading them gives the same ones."""
    return " ".join(repr(float(value) + 0.0) for value in values)  # type: ignore[attr-defined]


def _inertial(link: ElementTree.Element, mass: Array) -> None:
    m, com, six = central(mass)
    inertial = ElementTree.SubElement(link, "inertial")
    ElementTree.SubElement(inertial, "origin", xyz=numbers(com), rpy=numbers(ORIGIN))
    ElementTree.SubElement(inertial, "mass", value=repr(m))
    keys = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    ElementTree.SubElement(inertial, "inertia", {key: repr(float(value)) for key, value in zip(keys, six, strict=True)})


def _joint(robot: ElementTree.Element, joint: TreeJoint) -> None:
    endless = joint.endless and joint.kind == "revolute"
    element = ElementTree.SubElement(robot, "joint", name=joint.name, type="continuous" if endless else joint.kind)
    ElementTree.SubElement(element, "origin", xyz=numbers(joint.origin[:3, 3]),
                           rpy=numbers(roll_pitch_yaw(joint.origin[:3, :3])))
    ElementTree.SubElement(element, "parent", link=joint.parent)
    ElementTree.SubElement(element, "child", link=joint.child)
    if joint.kind == "fixed":
        return
    ElementTree.SubElement(element, "axis", xyz=numbers(joint.axis))
    limits = {"effort": repr(joint.max_effort or 0.0), "velocity": repr(joint.max_speed or 0.0)}
    if joint.lower is not None and joint.upper is not None and not endless:
        limits |= {"lower": repr(float(joint.lower)), "upper": repr(float(joint.upper))}
    ElementTree.SubElement(element, "limit", limits)
    if joint.viscous or joint.coulomb:
        ElementTree.SubElement(element, "dynamics", damping=repr(joint.viscous), friction=repr(joint.coulomb))
    if joint.mimic is not None:
        ElementTree.SubElement(element, "mimic", joint=joint.mimic.master, multiplier=repr(float(joint.mimic.ratio)),
                               offset=repr(float(joint.mimic.offset)))


def _transmission(robot: ElementTree.Element, joint: TreeJoint) -> None:
    element = ElementTree.SubElement(robot, "transmission", name=f"{joint.name}_transmission")
    ElementTree.SubElement(element, "type").text = "transmission_interface/SimpleTransmission"
    ElementTree.SubElement(element, "joint", name=joint.name)
    actuator = ElementTree.SubElement(element, "actuator", name=f"{joint.name}_motor")
    ElementTree.SubElement(actuator, "mechanicalReduction").text = repr(float(joint.gear))
