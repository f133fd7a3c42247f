"""How barrels and rods move: carried by two pins, turning about neither's own accord (Section 4.3.3)."""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca

from hydroopt.machine import Machine
from hydroopt.model.kinematics import Coordinates, Motion
from hydroopt.parts import Cylinder, GasCylinder
from hydroopt.spatial import Pose, unskew


class CylinderMotion(NamedTuple):
    """Length, its rates, and the two bodies of a cylinder.

    `barrel_turn` and `rod_turn` [rad/s] are the rates at which the pins turn about the bodies' z axes, relative to
    the links that carry them.
    """

    length: ca.SX
    speed: ca.SX
    acceleration: ca.SX
    barrel: Motion
    rod: Motion
    barrel_turn: ca.SX
    rod_turn: ca.SX


def cylinder_motion(machine: Machine, cylinder: Cylinder | GasCylinder, links: dict[str, Motion],
                    at: Coordinates) -> CylinderMotion:
    """Motion of a cylinder between its pins, from the motions of the links that carry them."""
    carriers = links[cylinder.barrel.link], links[cylinder.rod.link]
    ends = [carrier.of_point(ca.DM(end.pin))
            for carrier, end in zip(carriers, (cylinder.barrel, cylinder.rod), strict=True)]
    (from_p, from_v), (to_p, to_v) = (end[:2] for end in ends)
    length = ca.norm_2(to_p - from_p)
    x = (to_p - from_p) / length
    speed = ca.dot(x, to_v - from_v)
    # the axis of the driven joint, made perpendicular to the centre line: in a planar triangle it is so already; a
    # cylinder may lie along the axis of a sliding joint, whose x axis serves instead
    driven = machine.axis_of(cylinder)
    axis = links[driven].pose.rotation[:, 0 if machine.link(driven).joint.type == "prismatic" else 2]
    y = ca.cross(axis, x)
    y = y / ca.norm_2(y)
    turn = ca.horzcat(x, y, ca.cross(x, y))
    rotation = unskew(turn.T @ _rate(turn, at))
    rotation_rate = _rate(rotation, at)
    barrel, rod = (Motion(Pose(turn, p), turn.T @ v, turn.T @ a, rotation, rotation_rate)
                   for p, v, a in ends)
    pins = [rotation[2] - ca.dot(turn[:, 2], carrier.pose.rotation @ carrier.rotation) for carrier in carriers]
    return CylinderMotion(length, speed, _rate(speed, at), barrel, rod, *pins)


def _rate(expression: ca.SX, at: Coordinates) -> ca.SX:
    """Time derivative of an expression in q and q̇."""
    flat = ca.vec(expression)
    rate = ca.jtimes(flat, ca.vertcat(at.q, at.qd), ca.vertcat(at.qd, at.qdd))
    return ca.reshape(rate, expression.shape)
