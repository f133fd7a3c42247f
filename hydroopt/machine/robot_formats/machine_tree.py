"""From a machine to the tree of links and joints that robot formats describe."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Literal

import casadi as ca
import numpy as np

from hydroopt.machine.actuators import Cylinder, Drive, Motor, TorqueFriction
from hydroopt.machine.closures import closures
from hydroopt.machine.geometry import Geometry
from hydroopt.machine.links import Body, JointFriction, Link
from hydroopt.machine.loops import Coupling, Loop
from hydroopt.machine.machine import BASE, Machine
from hydroopt.machine.mechanism import Mechanism
from hydroopt.machine.range_checks import over, sampled
from hydroopt.machine.robot_formats.frames import APART, from_roll_pitch_yaw, inverse, pose, turn
from hydroopt.machine.robot_formats.tree import Mimic, RobotTree, Spring, TreeJoint, TreePin
from hydroopt.spatial import inertia
from hydroopt.spatial.inertia import Array

WORLD = "machine.world"
"""Link that carries a machine's tilted base."""
Way = tuple[str, Literal["revolute", "prismatic"], int]
"""Suffix of a joint's name, its kind, and its axis: x, y or z."""
FLOATING: tuple[Way, ...] = (("barrel_x", "prismatic", 0), ("barrel_y", "prismatic", 1), ("barrel_z", "prismatic", 2),
                             ("barrel_turn", "revolute", 2), ("barrel", "revolute", 1))
"""The joints of a barrel that no link carries."""


def machine_tree(machine: Machine, *, floating: bool = False) -> RobotTree:
    """Links, barrels and rods of a machine, cut open where it is no tree.

    A link's frame is its frame P, a barrel's and a rod's are theirs; ``boom_cylinder.barrel`` turns about the barrel's
    pin, in ``boom_cylinder.rod`` the position is the cylinder's length. Of a cylinder in no plane the barrel turns
    about two axes. What holds the cut ends together are the tree's `pins`. The tip is a link of its own.

    Args:
        machine: the machine.
        floating: whether barrels that turn about no axis of what carries them float, held by pins alone; otherwise they
            turn about the two axes that they have while all joints stand at zero.
    """
    return _Tree(machine, floating).tree()


class _Tree:
    def __init__(self, machine: Machine, floating: bool) -> None:
        self.machine, self.floating, self.geometry = machine, floating, Geometry(machine)
        self.masses: dict[str, Array | None] = {}
        self.joints: list[TreeJoint] = []
        self.pins: list[TreePin] = []
        self.posture = posture(machine)

    def tree(self) -> RobotTree:
        machine = self.machine
        root = BASE
        if any(machine.orientation):
            root, self.masses[WORLD] = WORLD, None
            self.joints.append(TreeJoint(name=BASE, kind="fixed", parent=WORLD, child=BASE,
                                         origin=pose(from_roll_pitch_yaw(machine.orientation))))
        self.masses[BASE] = None
        for link in machine.links:
            self._link(link)
        tip = "tip" if "tip" not in self.masses else "machine.tip"  # no name of a machine's part has a dot
        self.joints.append(TreeJoint(name=tip, kind="fixed", parent=machine.tip, child=tip,
                                     origin=self.geometry.far_end(machine.tip).matrix()))
        self.masses[tip] = None
        for loop in machine.loops:
            own, other = (np.asarray(ca.DM(end)).ravel() for end in self.geometry.loop_ends(loop))
            self.pins.append(TreePin(loop.name, (loop.link, loop.to.link), (own, other), loop.length))
        for cylinder in machine.cylinders:
            self._cylinder(cylinder)
        joints = {joint.name: joint for joint in self.joints}
        return RobotTree(machine.name, machine.name, root, self.masses, joints,
                         {joint.child: joint for joint in joints.values()}, tuple(self.pins), self.posture,
                         gravity=machine.gravity)

    def _link(self, link: Link) -> None:
        j = link.joint
        self.masses[link.name] = _mass(link.body)
        made = TreeJoint(name=link.name, kind="fixed" if j.type == "locked" else j.type, parent=link.parent,
                         child=link.name,
                         origin=(self.geometry.seat(link.name) @ self.geometry.joint(link.name, 0.0)).matrix())
        if j.moving:
            made = self._moving(link, made)
        self.joints.append(made)

    def _moving(self, link: Link, made: TreeJoint) -> TreeJoint:
        """Limits, friction, spring and drive of a joint."""
        machine, j = self.machine, link.joint
        made = replace(made, lower=j.lower, upper=j.upper, max_speed=j.max_speed, driven=False)
        rubs: list[JointFriction | TorqueFriction] = [j.friction]
        for actuator in machine.drivers.get(link.name, ()):
            if isinstance(actuator, Motor | Drive):
                made = replace(made, driven=True)
                rubs.append(actuator.friction)
            if isinstance(actuator, Drive):
                made = replace(made, gear=actuator.gear, max_effort=actuator.max_torque,
                               rotor_inertia=actuator.rotor_inertia or 0.0)
        made = replace(made, viscous=sum(each.viscous or 0.0 for each in rubs),
                       coulomb=sum(each.coulomb or 0.0 for each in rubs))
        if (spring := j.spring) is not None and spring.stiffness:
            made = replace(made, spring=Spring(spring.stiffness,
                                               spring.reference - (spring.preload or 0.0) / spring.stiffness))
        if j.dependent:
            made = replace(made, mimic=self._mimic(link.name), endless=j.type == "revolute")
            if j.type == "prismatic":
                lower, upper = dependent_range(machine, link.name)
                made = replace(made, lower=lower, upper=upper)
        return made

    def _mimic(self, joint: str) -> Mimic | None:
        """What a dependent joint mimics; None where a loop determines it, or a coupling of several joints."""
        coupling = mimicking(self.machine).get(joint)
        if coupling is None:
            return None
        ((other, ratio),) = coupling.ratios.items()
        if coupling.joint == joint:
            return Mimic(other, ratio, coupling.offset)
        return Mimic(coupling.joint, 1 / ratio, -coupling.offset / ratio)

    def _cylinder(self, cylinder: Cylinder) -> None:
        axis = self.machine.link(self.machine.axis_of(cylinder))
        frame = self.geometry.seat(axis.name).matrix()
        if axis.joint.type == "prismatic":  # a cylinder may lie along the axis: then the x axis takes its place
            frame = frame @ pose(turn(2, axis.joint.theta) @ np.array([[0.0, 0, 1], [0, -1, 0], [1, 0, 0]]))
        carrier, name = cylinder.barrel.link, f"{cylinder.name}.barrel"
        planar, fixed = self._planar(cylinder, axis.parent, frame)
        rest = link_poses(self.machine, {})
        turned = (inverse(rest[carrier]) @ rest[axis.parent] @ frame)[:3, :3]
        ways: tuple[Way, ...] = FLOATING[3:]
        origin = pose(turned, cylinder.barrel.pin)
        if planar:
            ways = (("barrel", "revolute", 2),)
        elif self.floating and not fixed:
            ways, origin, carrier = FLOATING, frame, axis.parent
            self.pins.append(TreePin(name, (name, cylinder.barrel.link), (np.zeros(3), np.array(cylinder.barrel.pin))))
        for suffix, kind, about in ways:
            own = f"{cylinder.name}.{suffix}"
            self.joints.append(TreeJoint(name=own, kind=kind, parent=carrier,
                                         child=own, origin=origin, axis=np.eye(3)[about], driven=False,
                                         endless=kind == "revolute"))
            self.masses[own] = None
            carrier, origin = own, np.eye(4)
        rod, friction = f"{cylinder.name}.rod", cylinder.friction
        effort = cylinder.relief_pressure * cylinder.areas[0] if cylinder.relief_pressure else None
        self.joints.append(TreeJoint(
            name=rod, kind="prismatic", parent=name, child=rod, origin=np.eye(4), axis=np.array([1.0, 0, 0]),
            lower=cylinder.dead_length, upper=cylinder.dead_length + cylinder.stroke, max_speed=cylinder.max_speed,
            max_effort=effort, viscous=friction.viscous or 0.0, coulomb=friction.coulomb or 0.0))
        self.masses |= {name: _mass(cylinder.barrel.body), rod: _mass(cylinder.rod.body)}
        self.pins.append(TreePin(rod, (rod, cylinder.rod.link), (np.zeros(3), np.array(cylinder.rod.pin))))
        self._aim(cylinder, ways)

    def _planar(self, cylinder: Cylinder, carrier: str, frame: Array) -> tuple[bool, bool]:
        """Whether both pins move in one plane across the axis, and whether the axis is fixed to the barrel's link."""
        rng = np.random.default_rng(1)
        planar, axes = True, []
        for _ in range(4):
            places = link_poses(self.machine, dict.fromkeys(self.machine.tree_joints, 0.0)
                                | {name: rng.uniform(-1, 1) for name in self.machine.tree_joints})
            seat = places[carrier] @ frame
            ends = [(inverse(seat) @ places[end.link] @ np.append(end.pin, 1.0))[2]
                    for end in (cylinder.barrel, cylinder.rod)]
            planar = planar and abs(ends[1] - ends[0]) < APART
            axes.append((inverse(places[cylinder.barrel.link]) @ seat)[:3, :3])
        across = all(np.max(np.abs(each[:, 2] - axes[0][:, 2])) < APART for each in axes)
        fixed = all(np.max(np.abs(each - axes[0])) < APART for each in axes)
        return planar and across, fixed

    def _aim(self, cylinder: Cylinder, ways: tuple[Way, ...]) -> None:
        """Where a cylinder's joints stand in the tree's posture."""
        places = link_poses(self.machine, self.posture)
        first = next(joint for joint in self.joints if joint.name == f"{cylinder.name}.{ways[0][0]}")
        seat = inverse(places[first.parent] @ first.origin)
        begin, end = (seat @ places[at.link] @ np.append(at.pin, 1.0) for at in (cylinder.barrel, cylinder.rod))
        x, y, z = (end - begin)[:3]
        values = {"barrel_x": begin[0], "barrel_y": begin[1], "barrel_z": begin[2], "barrel_turn": math.atan2(y, x),
                  "barrel": -math.atan2(z, math.hypot(x, y)) if len(ways) > 1 else math.atan2(y, x)}
        self.posture |= {f"{cylinder.name}.{suffix}": float(values[suffix]) for suffix, *_ in ways}
        self.posture[f"{cylinder.name}.rod"] = math.sqrt(x * x + y * y + z * z)


def mimicking(machine: Machine) -> dict[str, Coupling]:
    """The couplings of two joints, by the joint that each determines."""
    found = ((closure.joints[0], closure.statements[0])
             for closure in closures(machine.links, machine.loops, machine.couplings))
    return {joint: each for joint, each in found if isinstance(each, Coupling) and len(each.ratios) == 1}


def link_poses(machine: Machine, q: Mapping[str, float]) -> dict[str, Array]:
    """Frames P (4, 4) of all links in the base frame at positions of the tree's joints; those left out are zero."""
    geometry, moving = Geometry(machine), {joint: q.get(joint, 0.0) for joint in machine.tree_joints}
    return {link: geometry.relative_pose(BASE, link, moving).matrix()
            for link in (BASE, *(each.name for each in machine.links))}


def posture(machine: Machine) -> dict[str, float]:
    """Positions of all joints of the tree at which loops are closed: as the loops state it, else mid-range."""
    q = dict(zip(machine.joints, machine.ranges.mean(axis=1).tolist(), strict=True))
    stated = {joint: value for loop in machine.loops for joint, value in loop.posture.items() if joint in q}
    return _positions(machine, q | stated)


def _positions(machine: Machine, q: Mapping[str, float]) -> dict[str, float]:
    found = Mechanism(machine).positions(Geometry(machine), {joint: ca.DM(value) for joint, value in q.items()})
    return {joint: float(found[joint]) for joint in machine.tree_joints}


def dependent_range(machine: Machine, joint: str) -> tuple[float, float]:
    """Least and greatest position [m or rad] of a dependent joint over the range of those that it follows, and a tenth
    more on each side."""
    follows = machine.followed[joint]
    (values,) = sampled(Geometry(machine), follows, over(machine, follows), lambda _, at: [at[joint]]).values
    least, most = float(np.nanmin(values)), float(np.nanmax(values))
    margin = 0.1 * (most - least) or 0.1
    return least - margin, most + margin


def without_body(tree: RobotTree) -> tuple[str, ...]:
    """Moving links for which the machine states no body."""
    moved = {joint.child for joint in tree.joints.values() if joint.kind != "fixed"}
    return tuple(link for link, mass in tree.masses.items() if mass is None and link in moved)


def _mass(body: Body | None) -> Array | None:
    return None if body is None else inertia.pseudo_inertia(body.phi)


def open_statements(machine: Machine) -> tuple[Loop | Coupling, ...]:
    """Loops and couplings that no mimicking joint can state."""
    return (*machine.loops, *(each for each in machine.couplings if len(each.ratios) > 1))
