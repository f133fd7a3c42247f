"""Rotation vectors, the axis of a turn times its angle: to rotation matrices and back, symbolic or numeric."""

from __future__ import annotations

import casadi as ca

SMALL = 1e-4
"""Square of the angle below which series replace quotients that are 0/0 at zero."""
TINY = 1e-18
"""Square of a sine that keeps the square root differentiable."""


def rotation_of(vector: ca.SX) -> ca.SX:
    """Rotation matrix (3, 3) of a rotation vector (3,) [rad], by Rodrigues; differentiable at zero.

    >>> rotation_of(ca.DM([0.0, 0.0, 1.0]))[1, 0] - ca.sin(1.0)
    DM(0)
    """
    x = ca.sumsqr(vector)
    near, angle = _below(x), ca.sqrt(_at_least(x, SMALL))
    first = near * (1 - x / 6 * (1 - x / 20 * (1 - x / 42))) + (1 - near) * ca.sin(angle) / angle
    second = (near * (1 - x / 12 * (1 - x / 30 * (1 - x / 56))) / 2
              + (1 - near) * (1 - ca.cos(angle)) / angle**2)
    cross = ca.skew(vector)
    return ca.DM.eye(3) + first * cross + second * (cross @ cross)


def vector_of(rotation: ca.SX) -> ca.SX:
    """Rotation vector (3,) [rad] of a rotation matrix (3, 3), shorter than π; differentiable but at half a turn.

    >>> vector_of(rotation_of(ca.DM([0.5, 0.0, 0.0])))
    DM([0.5, 0, 0])
    """
    sine = ca.vertcat(rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0],
                      rotation[1, 0] - rotation[0, 1]) / 2
    cosine = (ca.trace(rotation) - 1) / 2
    x = ca.sumsqr(sine)
    near, size = _below(x) * (1 + ca.sign(cosine)) / 2, ca.sqrt(_at_least(x, TINY))
    series = 1 + x / 6 * (1 + 9 * x / 20 * (1 + 25 * x / 42 * (1 + 49 * x / 72)))
    return (near * series + (1 - near) * ca.atan2(size, cosine) / size) * sine


def _below(x: ca.SX) -> ca.SX:
    """One where x is smaller than `SMALL`, else zero; no comparison, which compiled kernels do not have."""
    return (1 - ca.sign(x - SMALL)) / 2


def _at_least(x: ca.SX, least: float) -> ca.SX:
    """The larger one of two numbers, likewise."""
    return least + (x - least) * (1 + ca.sign(x - least)) / 2
