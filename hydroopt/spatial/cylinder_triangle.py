"""The cylinder triangle: a cylinder's length from the joint's angle, and the angle from the length.

All functions take and return CasADi matrices, so that the same lines serve expressions and numbers.
"""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca


class Triangle(NamedTuple):
    """The triangle joint axis, barrel pin, rod pin, unrolled about the joint's axis (Figure 12).

    `fixed` and `moving` [m] are the distances of the two pins from the axis, `offset` [rad] turns the
    joint angle into the angle between them (Eq. 3.27), `lateral` [m] is the distance of the pins along
    the axis: zero in a planar triangle, and all that a pair of ball joints in space adds to Eq. 3.26.
    """

    fixed: ca.SX
    moving: ca.SX
    offset: ca.SX
    lateral: ca.SX


def triangle(fixed_pin: ca.SX, moving_pin: ca.SX) -> Triangle:
    """Triangle of a revolute joint from its pins.

    Args:
        fixed_pin: (3,) [m] pin on the link before the joint, in the joint's axis frame (z_{i-1}).
        moving_pin: (3,) [m] pin on the link after the joint, in P_i moved by d_i along z.
    """
    return Triangle(
        ca.hypot(fixed_pin[0], fixed_pin[1]), ca.hypot(moving_pin[0], moving_pin[1]),
        ca.atan2(moving_pin[1], moving_pin[0]) - ca.atan2(fixed_pin[1], fixed_pin[0]),
        moving_pin[2] - fixed_pin[2])


def triangle_length(sides: Triangle, theta: ca.SX) -> ca.SX:
    """Distance between the pins [m] at the joint angle θ [rad] (Eq. 3.26, without the dead length)."""
    inside = (sides.fixed**2 + sides.moving**2 + sides.lateral**2
              - 2 * sides.fixed * sides.moving * ca.cos(theta + sides.offset))
    return ca.sqrt(inside)


def triangle_angle(sides: Triangle, length: ca.SX, branch: int, near: float = 0.0) -> ca.SX:
    """Joint angle θ [rad] within half a turn of `near` at a pin distance [m]; NaN where the triangle cannot close.

    `branch` is +1 where the length grows with the angle and −1 where it shrinks.
    """
    cosine = ((sides.fixed**2 + sides.moving**2 + sides.lateral**2 - length**2)
              / (2 * sides.fixed * sides.moving))
    angle = branch * ca.acos(cosine) - sides.offset - near
    return near + ca.atan2(ca.sin(angle), ca.cos(angle))
