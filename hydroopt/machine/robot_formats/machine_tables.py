"""From the tree of a robot file to the tables of a machine file.

What moves with a joint is described in the *joint's frame*: the robot joint's frame, moved along with the joint and
turned so that its z is the axis.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hydroopt.errors import MachineError
from hydroopt.machine.closures import closures
from hydroopt.machine.links import Link
from hydroopt.machine.loops import Coupling, Loop
from hydroopt.machine.machine import BASE
from hydroopt.machine.quantity import ImpossibleError
from hydroopt.machine.robot_formats.frames import (
    APART,
    ORIGIN,
    Numbers,
    central,
    frame_about,
    inverse,
    onto,
    reaching,
    roll_pitch_yaw,
    tidy,
)
from hydroopt.machine.robot_formats.tree import RobotTree, TreeJoint, TreePin, like
from hydroopt.spatial.inertia import Array
from hydroopt.units import SMALLEST

_NONE = ""  # stands for the joint that carries the root; a robot's joint may well be called "base"


class Placed(NamedTuple):
    """The moving joint that carries something, and its pose (4, 4) in that joint's frame."""

    carrier: str
    pose: Array


FRAMES = "Frames of the machine's links in those of the robot file's links"
"""What heads the table of frames."""
FRAME = ("x [m]", "y [m]", "z [m]", "roll [deg]", "pitch [deg]", "yaw [deg]")
"""What states a frame, with its units."""


class RobotFile(NamedTuple):
    """What a robot file and its sidecar say.

    Attributes:
        tables: a machine file's.
        lost: what the robot file says and a machine file cannot, in sentences.
        links: each link of the robot with the machine's link that it is part of, and its pose in that link's frame P.
        beside: whether there is a sidecar, from which the tables are.
    """

    tables: dict[str, Any]
    lost: tuple[str, ...]
    links: dict[str, Placed]
    beside: bool = False

    @property
    def frames(self) -> list[dict[str, str | float]]:
        """Of each of the robot's links the machine's link that it is part of, and where that link's frame P is in the
        robot link's frame: origin ``x``, ``y``, ``z`` [m], and roll, pitch and yaw [deg]: Rot(z)·Rot(y)·Rot(x)."""
        found: list[dict[str, str | float]] = []
        for link, at in self.links.items():
            seen = inverse(at.pose)
            numbers = (*seen[:3, 3], *np.degrees(roll_pitch_yaw(seen[:3, :3])))
            found.append({"robot link": link, "machine link": at.carrier} | dict(
                zip(FRAME, map(tidy, numbers), strict=True)))
        return found


def machine_tables(tree: RobotTree, *, tip: str | None = None) -> RobotFile:
    """Tables of a robot's links, drives and couplings.

    The base is the root link, its z points up; a locked link leads to an axis that does not lie on the z of what
    carries it. Each moving joint becomes a link of its name (made of letters, digits and _) whose variable is the
    robot joint's position. Its body is all that moves with it, links behind fixed joints included; it has none where
    the file states none.

    Args:
        tree: the robot.
        tip: the link at the end of the one chain to read; the last far end lies in its origin. Joints that are not on
            the way from the root to it stand at zero, with what they carry.

    Raises:
        MachineError: there is no such tip, nothing moves, or limits are missing or contradictory.
    """
    if tip is not None and tip not in tree.masses:
        raise MachineError(f"there is no link '{tip}'", where=tree.file, remedy=f"use {like(tip, tree.masses)}")
    return _Conversion(tree, tip).tables()


class _Conversion:
    def __init__(self, tree: RobotTree, tip: str | None) -> None:
        self.tree, self.tip = tree, tip
        candidates = [*tree.joints.values()] if tip is None else tree.way(tip)
        self.moving = {joint.name for joint in candidates if joint.kind != "fixed" and joint.mimic is None}
        if not self.moving:
            raise MachineError("no joint moves" + (f" between '{tree.root}' and '{tip}'" if tip else ""),
                               where=tree.file, remedy="name a tip behind a moving joint" if tip else
                               "add a moving joint")
        followers = [joint for joint in candidates if joint.kind != "fixed" and joint.mimic is not None]
        while more := [joint for joint in followers if joint.mimic and joint.mimic.master in self.moving
                       and joint.name not in self.moving]:
            self.moving |= {joint.name for joint in more}
        self.looped = set() if tip else {
            joint.name for pin in tree.pins for joint in around(tree, pin) if not joint.driven and joint.mimic is None}
        self.held = [joint for joint in followers if joint.name not in self.moving]
        self.names: dict[str, str] = {_NONE: BASE}
        self.taken = {BASE}
        self.poses = {tree.root: Placed(_NONE, np.eye(4))}
        self.axes: dict[str, Placed] = {}

    def tables(self) -> RobotFile:
        self._place()
        links: list[dict[str, Any]] = []
        self.starts, self.ends = {_NONE: np.eye(4)}, {_NONE: Numbers(0.0, 0.0)}
        self.used: set[str] = set()  # whose far end leads to a joint already
        self.joints = [self.tree.joints[name] for name in self.axes]
        for name in self.axes:
            self.names[name] = _named(name, self.taken)
        for name in self.axes:
            links += self._link(name)
        tree, tip = self.tree, self.tip
        held = ", ".join(joint.name for joint in self.held)
        description = (f"from {Path(tree.file).name}, '{tree.root}'" + (f" to '{tip}'" if tip else "")
                       + (f"; held: {held}" if held else ""))
        tables: dict[str, Any] = {"name": _named(tree.name, set(), "machine"), "links": links,
                                  "description": description}
        if tree.gravity is not None:
            tables["gravity"] = _quantity(tree.gravity, "m/s^2")
        tables |= {key: parts for key, parts in (("drives", self._drives()), ("couplings", self._couplings())) if parts}
        inside = {link: Placed(self.names[at.carrier], inverse(self.ends[at.carrier].near_end()) @ at.pose)
                  for link, at in self.poses.items()}
        if tree.pins and not tip:
            tables["loops"] = stated_loops(tree, tables, self.names, inside, self.axes)
        still = [link for link, at in self.poses.items() if at.carrier == _NONE and tree.masses[link] is not None]
        lost = [*tree.lost, *(f"the loop '{pin.name}' is open" for pin in tree.pins if tip)]
        lost += [f"the mass of {', '.join(still)} is left out: it stands still"] if still else []
        lost += [f"'{joint.name}' stands still: it mimics '{joint.mimic.master}', which does not move"
                 for joint in self.held if joint.mimic]
        lost += [f"the rotor's inertia of '{joint.name}' is left out: nothing drives it" for joint in self.joints
                 if joint.rotor_inertia and joint.mimic is None and not _driven(joint)]
        return RobotFile(tables, tuple(lost), inside)

    def _place(self) -> None:
        """Of each link, and of each moving joint's frame at rest, what carries it."""
        for joint in self.tree.joints.values():
            carrier, at = self.poses[joint.parent]
            turned = frame_about(joint.axis)
            at = at @ joint.origin @ turned
            if joint.name in self.moving:
                self.axes[joint.name] = Placed(carrier, at)
                self.poses[joint.child] = Placed(joint.name, turned.T)
            else:
                value, slides = self._rests_at(joint), joint.kind == "prismatic"
                moved = Numbers(value if slides else 0.0, 0.0 if slides else value)
                self.poses[joint.child] = Placed(carrier, at @ moved.near_end() @ turned.T)

    def _rests_at(self, joint: TreeJoint) -> float:
        """Position [rad or m] of a joint that does not move."""
        if joint.mimic is None or joint.kind == "fixed":
            return 0.0
        return joint.mimic.offset + joint.mimic.ratio * self._rests_at(self.tree.joints[joint.mimic.master])

    def _link(self, name: str) -> list[dict[str, Any]]:
        """The machine's link that a joint moves, behind a locked one that leads to its axis if need be."""
        joint, (carrier, axis), own = self.tree.joints[name], self.axes[name], self.names[name]
        made: list[dict[str, Any]] = []
        link: dict[str, Any] = {"name": own, "parent": self.names[carrier]}
        start = self.starts[carrier]
        if carrier == _NONE or carrier in self.used:
            near = self.ends[carrier].near_end()
            lead = onto(inverse(near) @ axis)
            if carrier != _NONE or any(lead[2:]):
                link["parent"] = _named(f"{own}_mount", self.taken)
                made.append({"name": link["parent"], "parent": self.names[carrier],
                             "joint": {"type": "locked"} | _denavit_hartenberg(lead)})
                made[0] |= {"pin": _quantities(ORIGIN, "m")} if carrier != _NONE else {}
                start = near @ lead.far_end()
        self.used.add(carrier)
        children = [child for child, at in self.axes.items() if at.carrier == name]
        moved = {each: at.pose for each, at in self.poses.items() if at.carrier == name}
        end = onto(self.axes[children[0]].pose) if children else reaching(
            moved[self.tip if self.tip in moved else list(moved)[-1]][:3, 3])
        self.starts[name], self.ends[name] = end.far_end(), end
        rest = inverse(start) @ axis  # d and θ lead to the joint's frame first, then on to the end
        link["joint"] = self._joint(joint) | _denavit_hartenberg(Numbers(
            tidy(rest[2, 3] + end.d), tidy(math.remainder(math.atan2(rest[1, 0], rest[0, 0]) + end.theta, math.tau)),
            end.a, end.alpha, end.beta))
        to_body = inverse(end.near_end())
        masses = [to_body @ at @ mass @ at.T @ to_body.T for each, at in moved.items()
                  if (mass := self.tree.masses[each]) is not None]
        if masses:
            link["body"] = _body(np.sum(masses, axis=0))
        return [*made, link]

    def _joint(self, joint: TreeJoint) -> dict[str, Any]:
        """Type, limits and friction of a joint; of a driven one the friction is the drive's."""
        unit = "m" if joint.kind == "prismatic" else "rad"
        found: dict[str, Any] = {"type": joint.kind}
        if joint.mimic is not None or joint.name in self.looped:
            found["dependent"] = True
        else:
            found |= dict(zip(("lower", "upper"), (_quantity(value, unit) for value in self._limits(joint)),
                              strict=True))
            if joint.max_speed is not None:
                found["max_speed"] = _quantity(joint.max_speed, f"{unit}/s")
            if not joint.driven:
                found["passive"] = True
        if not _driven(joint) and (friction := _friction(joint)):
            found["friction"] = friction
        if joint.spring is not None and joint.spring.stiffness:
            effort = "N" if unit == "m" else "N*m"
            found["spring"] = {"stiffness": _quantity(joint.spring.stiffness, f"{effort}/{unit}"),
                               "reference": _quantity(joint.spring.reference, unit)}
        return found

    def _limits(self, joint: TreeJoint) -> tuple[float, float]:
        if joint.endless:
            return -math.pi, math.pi
        where = f"{self.tree.file}: joint '{joint.name}'"
        if joint.lower is None or joint.upper is None:
            raise MachineError("its limits are missing", where=where, remedy="add <limit lower=\"...\" upper=\"...\"/>")
        if joint.lower >= joint.upper:
            raise MachineError(f"the lower limit, {joint.lower:g}, is not below the upper one, {joint.upper:g}",
                               where=where, remedy="exchange or correct them, or make the joint fixed")
        return joint.lower, joint.upper

    def _drives(self) -> list[dict[str, Any]]:
        found = []
        for joint in self.joints:
            if not _driven(joint):
                continue
            own, slides = self.names[joint.name], joint.kind == "prismatic"
            drive: dict[str, Any] = {"name": _named(f"{own}_drive", self.taken), "joint": own}
            if joint.gear != 1.0:
                drive["gear"] = joint.gear
            if joint.max_effort is not None:
                drive["max_torque"] = _quantity(joint.max_effort, "N" if slides else "N*m")
            if rotor := self._rotors(joint):
                drive["rotor_inertia"] = _quantity(rotor / joint.gear**2, "kg*m^2")
            if friction := _friction(joint):
                drive["friction"] = friction
            found.append(drive)
        return found

    def _rotors(self, joint: TreeJoint) -> float:
        """Inertia of a joint's rotor, and of those of the joints that mimic it, as the joint feels them."""
        own = joint.rotor_inertia * joint.gear**2
        return own + sum(each.mimic.ratio**2 * self._rotors(each) for each in self.joints
                         if each.mimic is not None and each.mimic.master == joint.name)

    def _couplings(self) -> list[dict[str, Any]]:
        found = []
        for joint in self.joints:
            if joint.mimic is None:
                continue
            own, master = self.tree.joints[joint.name], self.tree.joints[joint.mimic.master]
            unit, other = ("m" if each.kind == "prismatic" else "rad" for each in (own, master))
            name = self.names[joint.name]
            ratio = _quantity(joint.mimic.ratio, f"{unit}/{other}") if unit != other else joint.mimic.ratio
            found.append({"name": _named(f"{name}_coupling", self.taken), "joint": name,
                          "ratios": {self.names[master.name]: ratio}, "offset": _quantity(joint.mimic.offset, unit)})
        return found


def _driven(joint: TreeJoint) -> bool:
    """Whether a drive of its own moves it."""
    return joint.driven and joint.mimic is None


def _friction(joint: TreeJoint) -> dict[str, str]:
    slides = joint.kind == "prismatic"
    stated = {"coulomb": (joint.coulomb, "N" if slides else "N*m"),
              "viscous": (joint.viscous, "N*s/m" if slides else "N*m*s/rad")}
    return {key: _quantity(value, unit) for key, (value, unit) in stated.items() if value}


def _denavit_hartenberg(numbers: Numbers) -> dict[str, str]:
    units: Mapping[str, str] = {"theta": "rad", "d": "m", "a": "m", "alpha": "rad", "beta": "rad"}
    return {key: _quantity(value, unit) for key, unit in units.items() if (value := getattr(numbers, key))}


def _quantity(value: float, unit: str) -> str:
    return f"{float(value) if abs(value) >= SMALLEST else 0.0!r} {unit}"  # what is smaller is rounding


def _quantities(values: Any, unit: str) -> list[str]:
    return [_quantity(value, unit) for value in values]


def _body(pseudo: Array) -> dict[str, Any]:
    """Body of a pseudo-inertia (4, 4)."""
    m, com, about_com = central(pseudo)
    return {"m": _quantity(m, "kg"), "com": _quantities(com, "m"), "inertia_com": _quantities(about_com, "kg*m^2")}


def _named(name: str, taken: set[str], prefix: str = "joint") -> str:
    """A name that a machine's part may have and none of those `taken` has yet; it is added to them."""
    name = re.sub(r"\W", "_", name, flags=re.ASCII)
    stem = name = name if name[:1].isalpha() else f"{prefix}_{name}"
    count = 1
    while name in taken:
        name = f"{stem}_{(count := count + 1)}"
    taken.add(name)
    return name


def around(tree: RobotTree, pin: TreePin) -> list[TreeJoint]:
    """The joints that move in a loop: those of the tree between its two links."""
    ways = [{joint.name: joint for joint in tree.way(link)} for link in pin.links]
    return [joint for name, joint in (ways[0] | ways[1]).items()
            if (name in ways[0]) != (name in ways[1]) and joint.kind != "fixed"]


def stated_loops(tree: RobotTree, tables: Mapping[str, Any], names: Mapping[str, str], inside: Mapping[str, Placed],
                 axes: Mapping[str, Placed]) -> list[dict[str, Any]]:
    """Tables of loops; each states where the joints that determine it, and those that it determines, stand.

    Args:
        tree: the robot.
        tables: of the machine's links and couplings.
        names: of the machine's links by joint.
        inside: the machine's link that each link of the tree is part of, with its pose in that link's frame P.
        axes: of each joint what carries it, and its frame there; all of it is used with every joint at zero.

    Raises:
        MachineError: the joints that nothing drives are not those that the loops determine.
    """
    loops: list[dict[str, Any]] = []
    for pin in tree.pins:
        joints = [joint for joint in around(tree, pin) if joint.name in names]
        (link, at), (to, there) = ((inside[each].carrier, inside[each].pose @ np.append(point, 1.0))
                                   for each, point in zip(pin.links, pin.points, strict=True))
        if link == "base":
            link, at, to, there = to, there, link, at
        loops.append({"name": _named(pin.name, {*names.values(), *(each["name"] for each in loops)}, "loop"),
                      "link": link, "pin": _quantities(at[:3], "m"),
                      "to": {"link": to, "pin": _quantities(there[:3], "m")},
                      "closed_by": "pin" if _in_a_plane(joints, axes) else "ball",
                      "posture": {names[joint.name]: _place(tree, joint) for joint in joints}})
    joints_of = {names[joint.name]: joint for joint in tree.joints.values() if joint.name in names}
    file = {"from_file": True}
    try:
        found = closures([Link.model_validate(each, context=file) for each in tables["links"]],
                         [Loop.model_validate(each, context=file) for each in loops],
                         [Coupling.model_validate(each, context=file) for each in tables.get("couplings", ())])
        for closure in found:
            for loop in loops:
                if loop["name"] in {each.name for each in closure.statements}:
                    loop["posture"] = {name: _place(tree, joints_of[name])
                                       for name in (*closure.follows, *closure.joints)}
    except ImpossibleError as error:
        raise MachineError(error.what, where=tree.file, remedy=error.remedy) from None
    return loops


def _place(tree: RobotTree, joint: TreeJoint) -> str:
    """Where a joint stands as the loops are closed."""
    return _quantity(tree.posture.get(joint.name, 0.0), "m" if joint.kind == "prismatic" else "rad")


def _in_a_plane(joints: list[TreeJoint], axes: Mapping[str, Placed]) -> bool:
    """Whether a loop's joints turn about parallel axes and slide across them, as seen with all joints at zero."""
    def axis(name: str) -> Array:
        carrier, frame = axes[name]
        z: Array = frame[:3, 2]
        while carrier:
            carrier, outer = axes[carrier]
            z = outer[:3, :3] @ z
        return z

    turning = [axis(joint.name) for joint in joints if joint.kind == "revolute"]
    sliding = [axis(joint.name) for joint in joints if joint.kind == "prismatic"]
    return bool(turning) and all(np.linalg.norm(np.cross(each, turning[0])) < APART for each in turning) and all(
        abs(each @ turning[0]) < APART for each in sliding)
