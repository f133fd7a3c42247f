"""Machines to URDF and SDF: the trees of their links and joints as XML."""

from __future__ import annotations

from collections.abc import Mapping
from xml.etree import ElementTree

import numpy as np

from hydroopt.machine.robot_formats.frames import central, roll_pitch_yaw
from hydroopt.machine.robot_formats.tree import RobotTree, TreeJoint, renamed
from hydroopt.spatial.inertia import Array

VERSION = "1.11"
"""Of SDF: the first that states what a joint mimics."""
MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


def node(tag: str, *inner: ElementTree.Element, text: str | None = None, **stated: str) -> ElementTree.Element:
    """An element with its attributes, its text or the elements in it."""
    made = ElementTree.Element(tag, stated)
    made.text = text
    made.extend(inner)
    return made


def xml_text(root: ElementTree.Element) -> str:
    """An XML document, indented."""
    ElementTree.indent(root)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def numbers(values: object) -> str:
    """Numbers as they are in memory, so that reading them gives the same ones."""
    return " ".join(repr(float(value) + 0.0) for value in values)  # type: ignore[attr-defined]


def urdf_text(tree: RobotTree) -> str:
    """URDF of a tree; its pins are left out, since a URDF has no loops.

    Effort and velocity are zero where the machine file states none, as in most files.
    """
    links = [node("link", *([] if mass is None else [_inertial(mass, sdf=False)]), name=link)
             for link, mass in tree.masses.items()]
    geared = [node("transmission", node("type", text="transmission_interface/SimpleTransmission"),
                   node("joint", name=joint.name),
                   node("actuator", node("mechanicalReduction", text=repr(float(joint.gear))),
                        name=f"{joint.name}_motor"), name=f"{joint.name}_transmission")
              for joint in tree.joints.values() if joint.gear != 1.0]
    return xml_text(node("robot", *links, *(_joint(each, sdf=False) for each in tree.joints.values()), *geared,
                         name=tree.name))


def sdf_text(tree: RobotTree) -> str:
    """SDF of a tree; its pins are left out. Each link stands in the frame of the joint that carries it.

    Links and joints share no names in SDF: a link that has a joint's becomes ``NAME.link``.
    """
    tree = renamed(tree, {link: f"{link}.link" for link in tree.masses if link in tree.joints})
    links = []
    for link, mass in tree.masses.items():
        inner = [node("pose", text=numbers([0] * 6), relative_to=tree.before[link].name)] if link in tree.before else []
        links.append(node("link", *inner, *([] if mass is None else [_inertial(mass, sdf=True)]), name=link))
    return xml_text(node("sdf", node("model", *links, *(_joint(each, sdf=True) for each in tree.joints.values()),
                                     name=tree.name), version=VERSION))


def _place(origin: Array, rotation: Array, *, sdf: bool, **stated: str) -> ElementTree.Element:
    """What states an origin (3,) and a rotation matrix (3, 3)."""
    turned = roll_pitch_yaw(rotation)
    if sdf:
        return node("pose", text=numbers((*origin, *turned)), **stated)
    return node("origin", xyz=numbers(origin), rpy=numbers(turned))


def _values(tag: str, values: Mapping[str, float | None], *, sdf: bool, **stated: str) -> ElementTree.Element:
    """An element with those values that are known: of SDF in elements, of URDF in attributes."""
    known = {key: repr(float(value)) for key, value in values.items() if value is not None}
    if sdf:
        return node(tag, *(node(key, text=text) for key, text in known.items()), **stated)
    return node(tag, **stated, **known)


def _inertial(mass: Array, *, sdf: bool) -> ElementTree.Element:
    m, com, six = central(mass)
    weight = node("mass", text=repr(m)) if sdf else node("mass", value=repr(m))
    return node("inertial", _place(com, np.eye(3), sdf=sdf), weight,
                _values("inertia", dict(zip(MOMENTS, six.tolist(), strict=True)), sdf=sdf))


def _joint(joint: TreeJoint, *, sdf: bool) -> ElementTree.Element:
    kind = "continuous" if joint.endless and joint.kind == "revolute" else joint.kind
    place = _place(joint.origin[:3, 3], joint.origin[:3, :3], sdf=sdf, relative_to=joint.parent)
    ends = [node(end, text=link) if sdf else node(end, link=link)
            for end, link in (("parent", joint.parent), ("child", joint.child))]
    if joint.kind == "fixed":
        return node("joint", place, *ends, name=joint.name, type=kind)
    usual, spring, mimic = None if sdf else 0.0, joint.spring, joint.mimic
    limits = {} if kind == "continuous" else {"lower": joint.lower, "upper": joint.upper}
    inner = [_values("limit", limits | {"effort": joint.max_effort or usual, "velocity": joint.max_speed or usual},
                     sdf=sdf)]
    dynamics = {"damping": joint.viscous or usual, "friction": joint.coulomb or usual}
    if spring and sdf:
        dynamics |= {"spring_reference": spring.reference, "spring_stiffness": spring.stiffness}
    if any(dynamics.values()):
        inner.append(_values("dynamics", dynamics, sdf=sdf))
    if mimic is not None:
        inner.append(_values("mimic", {"multiplier": mimic.ratio, "offset": mimic.offset}, sdf=sdf,
                             joint=mimic.master))
    axis = [node("axis", node("xyz", text=numbers(joint.axis)), *inner)] if sdf else [
        node("axis", xyz=numbers(joint.axis)), *inner]
    return node("joint", place, *ends, *axis, name=joint.name, type=kind)
