"""Loops that the pins of a robot file close, as a machine file states them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from hydroopt.errors import MachineError
from hydroopt.machine.closures import closures
from hydroopt.machine.links import Link
from hydroopt.machine.loops import Coupling, Loop
from hydroopt.machine.quantity import ImpossibleError
from hydroopt.machine.robot_formats.tree import RobotTree, TreeJoint, TreePin
from hydroopt.spatial.inertia import Array

_PARALLEL = 1e-9


class Placed(NamedTuple):
    """The moving joint that carries something, and its pose (4, 4) in that joint's frame."""

    carrier: str
    pose: Array


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
        loops.append({"name": _unused(pin.name, {*names.values(), *(each["name"] for each in loops)}),
                      "link": link, "pin": _lengths(at), "to": {"link": to, "pin": _lengths(there)},
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
    return f"{tree.posture.get(joint.name, 0.0)!r} {'m' if joint.kind == 'prismatic' else 'rad'}"


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
    return bool(turning) and all(np.linalg.norm(np.cross(each, turning[0])) < _PARALLEL for each in turning) and all(
        abs(each @ turning[0]) < _PARALLEL for each in sliding)


def _lengths(point: Array) -> list[str]:
    return [f"{float(value)!r} m" for value in point[:3]]


def _unused(name: str, taken: set[str]) -> str:
    stem = "".join(c if c.isalnum() and c.isascii() else "_" for c in name)
    stem = stem if stem[:1].isalpha() else f"loop_{stem}"
    return stem if stem not in taken else f"{stem}_loop"
