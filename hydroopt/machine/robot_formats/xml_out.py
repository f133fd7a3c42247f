"""Machines to URDF and SDF: the trees of their links and joints as XML."""

from __future__ import annotations

from collections.abc import Mapping
from xml.etree import ElementTree

from hydroopt.machine.robot_formats.frames import ORIGIN, central, roll_pitch_yaw
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


def _kind(joint: TreeJoint) -> str:
    return "continuous" if joint.endless and joint.kind == "revolute" else joint.kind


def urdf_text(tree: RobotTree) -> str:
    """URDF of a tree; its pins are left out, since a URDF has no loops.

    Effort and velocity are zero where the machine file states none, as in most files.
    """
    links = [node("link", *([] if mass is None else [_urdf_inertial(mass)]), name=link)
             for link, mass in tree.masses.items()]
    geared = [node("transmission", node("type", text="transmission_interface/SimpleTransmission"),
                   node("joint", name=joint.name),
                   node("actuator", node("mechanicalReduction", text=repr(float(joint.gear))),
                        name=f"{joint.name}_motor"), name=f"{joint.name}_transmission")
              for joint in tree.joints.values() if joint.gear != 1.0]
    return xml_text(node("robot", *links, *map(_urdf_joint, tree.joints.values()), *geared, name=tree.name))


def _urdf_inertial(mass: Array) -> ElementTree.Element:
    m, com, six = central(mass)
    return node("inertial", node("origin", xyz=numbers(com), rpy=numbers(ORIGIN)), node("mass", value=repr(m)),
                node("inertia", **{key: repr(float(value)) for key, value in zip(MOMENTS, six, strict=True)}))


def _urdf_joint(joint: TreeJoint) -> ElementTree.Element:
    inner = [node("origin", xyz=numbers(joint.origin[:3, 3]), rpy=numbers(roll_pitch_yaw(joint.origin[:3, :3]))),
             node("parent", link=joint.parent), node("child", link=joint.child)]
    if joint.kind != "fixed":
        limits = {"effort": repr(joint.max_effort or 0.0), "velocity": repr(joint.max_speed or 0.0)}
        if joint.lower is not None and joint.upper is not None and _kind(joint) != "continuous":
            limits |= {"lower": repr(float(joint.lower)), "upper": repr(float(joint.upper))}
        inner += [node("axis", xyz=numbers(joint.axis)), node("limit", **limits)]
    if joint.kind != "fixed" and (joint.viscous or joint.coulomb):
        inner.append(node("dynamics", damping=repr(joint.viscous), friction=repr(joint.coulomb)))
    if joint.kind != "fixed" and joint.mimic is not None:
        inner.append(node("mimic", joint=joint.mimic.master, multiplier=repr(float(joint.mimic.ratio)),
                          offset=repr(float(joint.mimic.offset))))
    return node("joint", *inner, name=joint.name, type=_kind(joint))


def sdf_text(tree: RobotTree) -> str:
    """SDF of a tree; its pins are left out. Each link stands in the frame of the joint that carries it.

    Links and joints share no names in SDF: a link that has a joint's becomes ``NAME.link``.
    """
    tree = renamed(tree, {link: f"{link}.link" for link in tree.masses if link in tree.joints})
    links = []
    for link, mass in tree.masses.items():
        inner = [node("pose", text=numbers([0] * 6), relative_to=tree.before[link].name)] if link in tree.before else []
        links.append(node("link", *inner, *([] if mass is None else [_sdf_inertial(mass)]), name=link))
    return xml_text(node("sdf", node("model", *links, *map(_sdf_joint, tree.joints.values()), name=tree.name),
                         version=VERSION))


def _sdf_inertial(mass: Array) -> ElementTree.Element:
    m, com, six = central(mass)
    return node("inertial", node("pose", text=numbers((*com, 0, 0, 0))), node("mass", text=repr(m)),
                _values("inertia", dict(zip(MOMENTS, six.tolist(), strict=True))))


def _sdf_joint(joint: TreeJoint) -> ElementTree.Element:
    inner = [node("pose", text=numbers((*joint.origin[:3, 3], *roll_pitch_yaw(joint.origin[:3, :3]))),
                  relative_to=joint.parent), node("parent", text=joint.parent), node("child", text=joint.child)]
    if joint.kind != "fixed":
        endless, spring, mimic = _kind(joint) == "continuous", joint.spring, joint.mimic
        axis = [node("xyz", text=numbers(joint.axis)),
                _values("limit", {"lower": None if endless else joint.lower, "upper": None if endless else joint.upper,
                                  "effort": joint.max_effort, "velocity": joint.max_speed}),
                _values("dynamics", {"damping": joint.viscous or None, "friction": joint.coulomb or None,
                                     "spring_reference": spring.reference if spring else None,
                                     "spring_stiffness": spring.stiffness if spring else None})]
        if mimic is not None:
            axis.append(_values("mimic", {"multiplier": mimic.ratio, "offset": mimic.offset, "reference": 0.0},
                                joint=mimic.master))
        inner.append(node("axis", *axis))
    return node("joint", *inner, name=joint.name, type=_kind(joint))


def _values(tag: str, values: Mapping[str, float | None], **stated: str) -> ElementTree.Element:
    """An element of those values that are known."""
    return node(tag, *(node(key, text=repr(float(value))) for key, value in values.items() if value is not None),
                **stated)
