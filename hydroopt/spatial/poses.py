"""Poses and modified Denavit-Hartenberg transforms, symbolic (SX) or numeric (DM).

All functions take and return CasADi matrices, so that the same lines serve expressions and numbers.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import casadi as ca
import numpy as np

from hydroopt.spatial.inertia import Array

RIGHT = 1e-15
"""What a cosine of a right angle in floating point may differ from zero by, a few turns off the first."""


class Pose(NamedTuple):
    """A frame relative to another one: `rotation` (3, 3) and `origin` (3,) [m]."""

    rotation: ca.SX
    origin: ca.SX

    def __matmul__(self, other: Pose) -> Pose:
        """Pose of a frame that is `other` relative to this one."""
        return Pose(self.rotation @ other.rotation, self.origin + self.rotation @ other.origin)

    def inverse(self) -> Pose:
        """The outer frame relative to this one."""
        return Pose(self.rotation.T, -(self.rotation.T @ self.origin))

    def point(self, local: ca.SX) -> ca.SX:
        """Coordinates (3,) in the outer frame of a point given in this frame."""
        return self.origin + self.rotation @ local

    def matrix(self) -> Array:
        """Homogeneous matrix (4, 4) of a pose in numbers."""
        made = np.eye(4)
        made[:3] = np.asarray(ca.horzcat(ca.evalf(ca.SX(self.rotation)), ca.evalf(ca.SX(self.origin))))
        return made


def identity() -> Pose:
    """The pose of a frame in itself."""
    return Pose(ca.DM.eye(3), ca.DM.zeros(3))


def _cos_sin(angle: ca.SX | float) -> tuple[ca.SX, ca.SX]:
    """Cosine and sine; those of a number that is a right angle are exact, so that no 6e-17 ties what is apart."""
    if isinstance(angle, float | int):
        c, s = math.cos(angle), math.sin(angle)
        return (c, s) if min(abs(c), abs(s)) > RIGHT else (float(round(c)), float(round(s)))
    return ca.cos(angle), ca.sin(angle)


def rotation_x(angle: ca.SX) -> ca.SX:
    """Rotation matrix (3, 3) about x by `angle` [rad]."""
    c, s = _cos_sin(angle)
    return ca.blockcat([[1, 0, 0], [0, c, -s], [0, s, c]])


def rotation_y(angle: ca.SX) -> ca.SX:
    """Rotation matrix (3, 3) about y by `angle` [rad]."""
    c, s = _cos_sin(angle)
    return ca.blockcat([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def rotation_z(angle: ca.SX) -> ca.SX:
    """Rotation matrix (3, 3) about z by `angle` [rad]."""
    c, s = _cos_sin(angle)
    return ca.blockcat([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def roll_pitch_yaw(angles: tuple[ca.SX, ca.SX, ca.SX] | tuple[float, float, float]) -> ca.SX:
    """Rotation matrix Rot(z, yaw)·Rot(y, pitch)·Rot(x, roll) (3, 3)."""
    roll, pitch, yaw = angles
    return rotation_z(yaw) @ rotation_y(pitch) @ rotation_x(roll)


def joint_pose(theta: ca.SX, d: ca.SX) -> Pose:
    """Trans(z, d)·Rot(z, θ): the frame P_i of a link, origin on its joint's axis, z along it (Eq. 4.14)."""
    return Pose(rotation_z(theta), ca.vertcat(0, 0, d))


def link_pose(a: ca.SX, alpha: ca.SX, beta: ca.SX) -> Pose:
    """Trans(x, a)·Rot(x, α)·Rot(y, β): from P_i to the frame at the link's far end (Eq. 3.8)."""
    return Pose(rotation_x(alpha) @ rotation_y(beta), ca.vertcat(a, 0, 0))


def skew(v: ca.SX) -> ca.SX:
    """Matrix (3, 3) of the cross product [v×] (Eq. 4.11)."""
    return ca.skew(v)


def unskew(m: ca.SX) -> ca.SX:
    """Vector (3,) of a skew-symmetric matrix."""
    return ca.vertcat(m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]) / 2
