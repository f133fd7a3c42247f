"""Machines to MJCF: loops and couplings are equality constraints, cylinders bodies that slide in each other."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np

from hydroopt.errors import MachineError
from hydroopt.machine.actuators import Cylinder
from hydroopt.machine.loops import Coupling
from hydroopt.machine.machine import Machine
from hydroopt.machine.robot_formats.frames import central, to_quaternion
from hydroopt.machine.robot_formats.machine_tree import link_poses, machine_tree, open_statements
from hydroopt.machine.robot_formats.mjcf_in import NEGLIGIBLE
from hydroopt.machine.robot_formats.tree import TreeJoint, TreePin
from hydroopt.machine.robot_formats.xml_out import numbers, xml_text
from hydroopt.spatial.inertia import Array

_ROUNDING = 1e-9
_LEAST = 1e-14
"""Moment of inertia [kg*m^2] of a body that has none about an axis; MuJoCo takes no less than 1e-15."""


def mjcf_text(machine: Machine) -> str:
    """MJCF of a machine.

    Positions of its joints are the machine's; in ``boom_cylinder.rod`` it is the cylinder's length. Friction is the
    joints' damping and frictionloss; each actuator is a motor with the force or torque itself as control. The key frame
    is a posture in which all loops are closed.

    Raises:
        MachineError: a body has moments of inertia that no body can have; MuJoCo refuses it.
    """
    return _Mjcf(machine).text()


class _Mjcf:
    def __init__(self, machine: Machine) -> None:
        self.machine, self.tree = machine, machine_tree(machine, floating=True)
        self.children: dict[str, list[TreeJoint]] = {link: [] for link in self.tree.masses}
        for joint in self.tree.joints.values():
            self.children[joint.parent].append(joint)
        self.bodies: dict[str, ElementTree.Element] = {}
        self.order: list[str] = []

    def text(self) -> str:
        machine, tree = self.machine, self.tree
        root = ElementTree.Element("mujoco", model=machine.name)
        ElementTree.SubElement(root, "compiler", angle="radian", inertiafromgeom="false")
        ElementTree.SubElement(root, "option", gravity=numbers((0.0, 0.0, -machine.gravity)))
        world = ElementTree.SubElement(root, "worldbody")
        self.bodies[tree.root] = ElementTree.SubElement(world, "body", name=tree.root)
        for joint in self.children[tree.root]:
            self._body(joint, self.bodies[tree.root])
        self._equalities(root)
        actuators = ElementTree.SubElement(root, "actuator")
        for actuator in machine.actuators:
            joint_name = f"{actuator.name}.rod" if isinstance(actuator, Cylinder) else actuator.joint
            most = tree.joints[joint_name].max_effort
            limits = {"forcerange": numbers((-most, most)), "forcelimited": "true"} if most else {}
            ElementTree.SubElement(actuators, "motor", {"name": actuator.name, "joint": joint_name} | limits)
        at = [tree.posture[name] for name in self.order]
        ElementTree.SubElement(ElementTree.SubElement(root, "keyframe"), "key", name="closed", qpos=numbers(at))
        return xml_text(root)

    def _body(self, first: TreeJoint, parent: ElementTree.Element) -> None:
        """A body on its joint; joints between links without a body in one place are all the last one's."""
        joints, last = [first], first
        while "." in last.child and self.tree.masses[last.child] is None and self._through(last.child):
            last = self.children[last.child][0]
            joints.append(last)
        body = ElementTree.SubElement(parent, "body", name=last.child, pos=numbers(first.origin[:3, 3]),
                                      quat=numbers(to_quaternion(first.origin[:3, :3])))
        self.bodies[last.child] = body
        moves = [joint for joint in joints if joint.kind != "fixed"]
        self._inertial(body, last.child, needed=bool(moves))
        for joint in moves:
            self.order.append(joint.name)
            _joint(body, joint)
        for joint in self.children[last.child]:
            reach = joint.origin[:3, 3]
            if np.linalg.norm(reach) > 1e-3:
                ElementTree.SubElement(body, "geom", type="capsule", fromto=numbers((0.0, 0.0, 0.0, *reach)),
                                       size=repr(0.02 * float(np.linalg.norm(reach))), contype="0", conaffinity="0")
            self._body(joint, body)

    def _through(self, link: str) -> bool:
        inside = self.children[link]
        return len(inside) == 1 and np.array_equal(inside[0].origin, np.eye(4)) and link.endswith(
            ("barrel_x", "barrel_y", "barrel_z", "barrel_turn"))

    def _inertial(self, body: ElementTree.Element, link: str, *, needed: bool) -> None:
        mass = self.tree.masses[link]
        if mass is None or not np.any(mass):
            if needed:
                ElementTree.SubElement(body, "inertial", pos="0 0 0", mass=repr(NEGLIGIBLE),
                                       diaginertia=numbers([NEGLIGIBLE] * 3))
            return
        m, com, moments, axes = self._principal(mass, link)
        ElementTree.SubElement(body, "inertial", pos=numbers(com), quat=numbers(to_quaternion(axes)), mass=repr(m),
                               diaginertia=numbers(moments))

    def _principal(self, mass: Array, link: str) -> tuple[float, Array, Array, Array]:
        """Mass, centre of mass, principal moments of inertia and axes: MuJoCo's own are good to ten digits only."""
        found = central(mass)
        xx, xy, xz, yy, yz, zz = found.six
        moments, axes = np.linalg.eigh(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
        axes[:, 0] *= np.linalg.det(axes)
        size = max(float(moments[2]), NEGLIGIBLE)
        if found.m <= 0 or moments[0] < -_ROUNDING * size or moments[0] + moments[1] < (1 - _ROUNDING) * moments[2]:
            raise MachineError(f"no body has the principal moments of inertia "
                               f"{', '.join(f'{each:.4g}' for each in moments)} kg*m^2 with {found.m:.4g} kg, and "
                               "MuJoCo refuses it", where=f"machine '{self.machine.name}': the body of '{link}'",
                               remedy="correct it, or identify it under the condition that it exists")
        moments = np.maximum(moments, _LEAST)
        moments[2] = min(moments[2], moments[0] + moments[1])
        return found.m, found.com, moments, axes

    def _equalities(self, root: ElementTree.Element) -> None:
        equality, tendon = ElementTree.Element("equality"), ElementTree.Element("tendon")
        for pin in self.tree.pins:
            for body, point, end in zip(pin.links, pin.points, ("a", "b"), strict=True):
                self._site(body, f"{pin.name}.{end}", point)
            if pin.length is None:
                ElementTree.SubElement(equality, "connect", name=pin.name, site1=f"{pin.name}.a", site2=f"{pin.name}.b")
            else:
                self._between(tendon, pin.name)
                ElementTree.SubElement(equality, "tendon", name=pin.name, tendon1=pin.name,
                                       polycoef=numbers((pin.length - self._apart(pin), 0, 0, 0, 0)))
        for joint in self.tree.joints.values():
            if joint.mimic is not None:
                ElementTree.SubElement(equality, "joint", name=f"{joint.name}.mimic", joint1=joint.name,
                                       joint2=joint.mimic.master,
                                       polycoef=numbers((joint.mimic.offset, joint.mimic.ratio, 0, 0, 0)))
        for coupling in open_statements(self.machine):
            if isinstance(coupling, Coupling):
                fixed = ElementTree.SubElement(tendon, "fixed", name=coupling.name)
                for name, factor in {coupling.joint: 1.0, **{one: -r for one, r in coupling.ratios.items()}}.items():
                    ElementTree.SubElement(fixed, "joint", joint=name, coef=repr(float(factor)))
                ElementTree.SubElement(equality, "tendon", name=coupling.name, tendon1=coupling.name,
                                       polycoef=numbers((coupling.offset, 0, 0, 0, 0)))
        for spring in self.machine.springs:
            if spring.stiffness:
                for end, at in (("a", spring.barrel), ("b", spring.rod)):
                    self._site(at.link, f"{spring.name}.{end}", np.array(at.pin))
                self._between(tendon, spring.name, stiffness=repr(float(spring.stiffness)), springlength=repr(
                    float(spring.reference_length - (spring.preload or 0.0) / spring.stiffness)))
        root.extend(each for each in (tendon, equality) if len(each))

    def _site(self, body: str, name: str, point: Array) -> None:
        ElementTree.SubElement(self.bodies[body], "site", name=name, pos=numbers(point))

    @staticmethod
    def _between(tendon: ElementTree.Element, name: str, **more: str) -> None:
        spatial = ElementTree.SubElement(tendon, "spatial", {"name": name} | more)
        for end in ("a", "b"):
            ElementTree.SubElement(spatial, "site", site=f"{name}.{end}")

    def _apart(self, pin: TreePin) -> float:
        """Distance [m] of a rod's ends with all joints at zero, from which MuJoCo counts."""
        places = link_poses(self.machine, {})
        ends = [(places[link] @ np.append(point, 1.0))[:3] for link, point in zip(pin.links, pin.points, strict=True)]
        return float(np.linalg.norm(ends[1] - ends[0]))


def _joint(body: ElementTree.Element, joint: TreeJoint) -> None:
    element = ElementTree.SubElement(body, "joint", name=joint.name, axis=numbers(joint.axis),
                                     type="slide" if joint.kind == "prismatic" else "hinge")
    dependent = joint.mimic is not None or joint.endless
    if joint.lower is not None and joint.upper is not None and not dependent:
        element.set("limited", "true")
        element.set("range", numbers((joint.lower, joint.upper)))
    said = {"damping": joint.viscous, "frictionloss": joint.coulomb,
            "armature": joint.rotor_inertia * joint.gear**2}
    for key, value in said.items():
        if value:
            element.set(key, repr(float(value)))
    if joint.spring is not None:
        element.set("stiffness", repr(float(joint.spring.stiffness)))
        element.set("springref", repr(float(joint.spring.reference)))
