"""Directions and angles in the plane of a loop."""

from __future__ import annotations

from typing import Any

import casadi as ca

from hydroopt.spatial.poses import rotation_z


def unit(vector: ca.SX) -> ca.SX:
    """Direction of a vector (2,)."""
    # of a bar along x this is exact, and costs no operations later
    return vector / ca.norm_2(vector) if not (along := _along_x(vector)) else ca.DM([along, 0])


def _along_x(vector: ca.SX) -> int:
    if not isinstance(vector, ca.DM) or float(vector[1]) != 0:
        return 0
    return 1 if float(vector[0]) > 0 else -1


def turned_to(bar: ca.SX, theta: Any) -> ca.SX:
    """Direction of a bar (3,) of a link whose joint stands at zero, seen from the joint's seat."""
    return unit(rotation_z(theta)[:2, :2] @ bar[:2])


def product(a: ca.SX, b: ca.SX) -> ca.SX:
    """Of two vectors (2,) the one whose angle is the sum of theirs."""
    return ca.vertcat(a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0])


def conjugate(a: ca.SX) -> ca.SX:
    """The vector (2,) with the opposite angle."""
    return ca.vertcat(a[0], -a[1])


def angle_between(zero: ca.SX, vector: ca.SX) -> ca.SX:
    """Angle [rad] from a direction to a vector, both (2,)."""
    turned = product(conjugate(zero), vector)
    return ca.atan2(turned[1], turned[0])
