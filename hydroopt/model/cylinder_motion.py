"""Motion of barrels and rods, which their two pins determine (Section 4.3.3)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import casadi as ca

from hydroopt.machine.actuators import Pinned
from hydroopt.machine.geometry import Geometry
from hydroopt.model.kinematics import STILL, UP, Coordinates, Motion, rate
from hydroopt.spatial.poses import Pose

SHORTEST_LEVER = 1e-4
"""Lever arm [m] below which a cylinder is at its dead point."""


class CylinderMotion(NamedTuple):
    """Length, its rates, and the two bodies of a cylinder.

    `along` is the cosine of the angle between its centre line and the axis that orients it, 0 in a planar triangle;
    parallel to that axis its bodies could be turned in any way.
    `barrel_turn` and `rod_turn` [rad/s] are the rotation rates of the bodies about their z axes,
    relative to the links that carry the pins.
    """

    length: ca.SX
    speed: ca.SX
    acceleration: ca.SX
    along: ca.SX
    barrel: Motion
    rod: Motion
    barrel_turn: ca.SX
    rod_turn: ca.SX


class CentreLine(NamedTuple):
    """A cylinder's pins (3,) [m], their distance [m], `along` as of its motion, and its bodies' axes (3, 3), all in the
    axis frame of the joint that orients it."""

    pins: tuple[ca.SX, ca.SX]
    length: ca.SX
    along: ca.SX
    turn: ca.SX


def centre_line(geometry: Geometry, cylinder: Pinned, q: Mapping[str, ca.SX]) -> CentreLine:
    """How a cylinder stands between its pins, at positions of the joints by name."""
    driven = geometry.machine.axis_of(cylinder)
    barrel, rod = (geometry.pin(cylinder, end, q) for end in ("barrel", "rod"))
    d = rod - barrel
    length = ca.norm_2(d)
    x = d / length
    # the axis of the driven joint, made perpendicular to the centre line: in a planar triangle it already is; a
    # cylinder may be parallel to the axis of a prismatic joint, whose x axis is used instead
    axis = UP
    if geometry.machine.link(driven).joint.type == "prismatic":
        axis = ca.SX(geometry.joint(driven, 0.0).rotation[:, 0])
    along = ca.dot(axis, x)
    across = 1.0 if along.is_zero() else ca.sqrt(1 - along**2)
    return CentreLine((barrel, rod), length, along, ca.horzcat(x, ca.cross(axis, x) / across,
                                                               (axis - along * x) / across))


def cylinder_motion(geometry: Geometry, cylinder: Pinned, links: dict[str, Motion],
                    tree: Coordinates) -> CylinderMotion:
    """Motion of a cylinder between its pins, computed in the axis frame of the joint that orients it.

    In this frame only the joints between the pins move the cylinder; the frame's own motion is added last. With
    d = l·x from pin to pin, y·ḋ = l·ω_z and z·ḋ = −l·ω_y; the axis stays in the plane of x and z, which gives ω_x.
    `tree` holds all moving joints, in the order of ``machine.tree_joints``.
    """
    machine = geometry.machine
    driven = machine.axis_of(cylinder)
    before = machine.link(driven).parent
    q = {joint: tree.q[k] for k, joint in enumerate(machine.tree_joints)}
    line = centre_line(geometry, cylinder, q)
    pins, length, along, x, y, z = line.pins, line.length, line.along, *(line.turn[:, k] for k in range(3))
    across = 1.0 if along.is_zero() else ca.sqrt(1 - along**2)
    speeds = [rate(pin, tree) for pin in pins]
    accelerations = [rate(speed, tree) for speed in speeds]
    dd, ddd = (rod - barrel for barrel, rod in (speeds, accelerations))
    speed = ca.dot(x, dd)
    turn_y, turn_z = -ca.dot(z, dd) / length, ca.dot(y, dd) / length
    lean = along / across
    turn_x = lean * turn_z
    rate_z = (ca.dot(y, ddd) - 2 * speed * turn_z) / length - turn_x * turn_y
    rate_y = turn_x * turn_z - (2 * speed * turn_y + ca.dot(z, ddd)) / length
    rate_x = lean * rate_z - turn_y * turn_z / across**2
    acceleration = ca.dot(x, ddd) + length * (turn_y**2 + turn_z**2)
    frame, turn = links[before].fixed(geometry.seat(driven)), line.turn
    rotation, rotation_rate = ca.vertcat(turn_x, turn_y, turn_z), ca.vertcat(rate_x, rate_y, rate_z)
    bodies = [frame.carry(Pose(turn, pins[k]), turn.T @ speeds[k], turn.T @ accelerations[k], rotation, rotation_rate)
              for k in (0, 1)]
    pin_turns = [turn_z - ca.dot(z, _rotation(geometry, driven, end.link, q, tree))
                 for end in (cylinder.barrel, cylinder.rod)]
    return CylinderMotion(length, speed, acceleration, along, *bodies, *pin_turns)


def _rotation(geometry: Geometry, seat: str, link: str, q: dict[str, ca.SX], tree: Coordinates) -> ca.SX:
    """Rotation rate (3,) [rad/s] of a link relative to the seat of a joint, in the frame there."""
    machine = geometry.machine
    total = STILL
    for joint in machine.joints_between(machine.link(seat).parent, link):
        if machine.link(joint).joint.type == "revolute":
            axis = geometry.from_seat(seat, joint, q).rotation[:, 2]
            sign = 1 if joint in machine.ancestry(link) else -1
            total = total + sign * axis * tree.qd[machine.tree_joints.index(joint)]
    return total
