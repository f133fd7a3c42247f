"""Frames and bodies in numbers: homogeneous matrices (4, 4), Denavit-Hartenberg numbers (Eq. 3.8), central inertias."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from hydroopt.spatial import inertia
from hydroopt.spatial.inertia import Array
from hydroopt.spatial.poses import rotation_x, rotation_y, rotation_z

ORIGIN = (0.0, 0.0, 0.0)
APART = 1e-9
"""By how much [m or rad, or as a part of a number] places and numbers differ that are not the same."""
_NEARLY_PARALLEL = math.sin(math.radians(2))


def pose(rotation: Array, origin: Sequence[float] | Array = ORIGIN) -> Array:
    """Pose of a rotation (3, 3) and an origin (3,) [m]."""
    made = np.eye(4)
    made[:3, :3], made[:3, 3] = rotation, origin
    return made


def shift(origin: Sequence[float] | Array) -> Array:
    """Pose that only moves, to an origin (3,) [m]."""
    return pose(np.eye(3), origin)


def inverse(of: Array) -> Array:
    """The outer frame as seen from this one."""
    return pose(of[:3, :3].T, -of[:3, :3].T @ of[:3, 3])


def turn(about: int, angle: float) -> Array:
    """Rotation matrix (3, 3) about x, y or z by an angle [rad]; right angles are exact."""
    return np.asarray((rotation_x, rotation_y, rotation_z)[about](float(angle)))


def from_roll_pitch_yaw(angles: Sequence[float] | Array) -> Array:
    """Rotation matrix Rot(z, yaw)·Rot(y, pitch)·Rot(x, roll) (3, 3) of roll, pitch and yaw [rad]."""
    roll, pitch, yaw = angles
    return turn(2, yaw) @ turn(1, pitch) @ turn(0, roll)


def roll_pitch_yaw(rotation: Array) -> tuple[float, float, float]:
    """Roll, pitch and yaw [rad] of a rotation matrix (3, 3), exact to rounding at and near a pitch of 90° too.

    >>> [round(angle, 12) for angle in roll_pitch_yaw(from_roll_pitch_yaw((0.3, math.pi / 2, 0.0)))]
    [0.3, 1.570796326795, 0.0]
    """
    upright = math.hypot(rotation[0, 0], rotation[1, 0]) < 1e-15
    yaw = 0.0 if upright else math.atan2(rotation[1, 0], rotation[0, 0])
    rest = turn(2, -yaw) @ rotation  # what is lost of an ill-determined yaw goes into roll
    pitch = math.atan2(-rest[2, 0], rest[0, 0])
    rest = turn(1, -pitch) @ rest
    return math.atan2(rest[2, 1], rest[1, 1]), pitch, yaw


def from_quaternion(parts: Sequence[float] | Array) -> Array:
    """Rotation matrix (3, 3) of a quaternion w, x, y, z."""
    return np.asarray(Rotation.from_quat(np.roll(parts, -1)).as_matrix())


def to_quaternion(rotation: Array) -> Array:
    """Unit quaternion w, x, y, z (4,) of a rotation matrix (3, 3)."""
    return np.roll(Rotation.from_matrix(rotation).as_quat(), 1)


def turn_about(axis: Array, angle: float) -> Array:
    """Rotation matrix (3, 3) about a unit vector (3,) by an angle [rad]."""
    return np.asarray(Rotation.from_rotvec(angle * axis).as_matrix())


def frame_about(axis: Array) -> Array:
    """Rotation (4, 4) to a frame whose z is a unit vector (3,) and whose x is near one of the old axes."""
    x = np.eye(3)[0 if abs(axis[0]) < 0.9 else 1]
    x = x - (x @ axis) * axis
    x /= np.linalg.norm(x)
    return pose(np.column_stack([x, np.cross(axis, x), axis]))


def tidy(value: float) -> float:
    """The number without rounding errors about zero."""
    return 0.0 if abs(value) < 1e-14 else float(value)


class Numbers(NamedTuple):
    """Eq. 3.8 from a joint's frame at rest onwards: the frame whose z is the joint's axis [m, rad]."""

    d: float
    theta: float
    a: float = 0.0
    alpha: float = 0.0
    beta: float = 0.0

    def near_end(self) -> Array:
        """The link's frame P (4, 4), in which its body stands."""
        return pose(turn(2, self.theta), (0, 0, self.d))

    def far_end(self) -> Array:
        """The frame (4, 4) at the link's far end."""
        return self.near_end() @ pose(turn(0, self.alpha) @ turn(1, self.beta), (self.a, 0, 0))


def onto(frame: Array) -> Numbers:
    """Numbers whose far end has its z on that of a `frame` (4, 4), seen from the joint's frame.

    They follow the common normal of the two axes. Where that runs away, for nearly parallel ones, they reach for the
    frame's origin and tilt there by `alpha` and `beta`, so that they change no more than the axes do.
    """
    point, axis = frame[:3, 3], frame[:3, 2]
    across = math.hypot(axis[0], axis[1])
    if across < _NEARLY_PARALLEL:
        reach = reaching(point)
        x, y, z = turn(2, -reach.theta) @ axis
        return reach._replace(alpha=tidy(math.atan2(-y, z)), beta=tidy(math.atan2(x, math.hypot(y, z))))
    foot = point - axis * (point[:2] @ axis[:2]) / across**2
    normal = np.array([-axis[1], axis[0]]) / across
    if normal[0] < -1e-9 or (normal[0] < 1e-9 and normal[1] < 0):  # of both directions, the one nearer to the own x
        normal = -normal
    theta = tidy(math.atan2(normal[1], normal[0]))
    return Numbers(tidy(foot[2]), theta, tidy(float(normal @ foot[:2])),
                   math.atan2(-(turn(2, -theta) @ axis)[1], axis[2]))


def reaching(point: Array) -> Numbers:
    """Numbers whose far end lies in a point (3,) of the joint's frame."""
    x, y, z = (tidy(value) for value in point)
    return Numbers(z, math.atan2(y, x), math.hypot(x, y))


class CentralInertia(NamedTuple):
    """Mass [kg], centre of mass (3,) [m] and moments of inertia ``xx…zz`` (6,) [kg·m²] about it, along the frame."""

    m: float
    com: Array
    six: Array

    def pseudo(self) -> Array:
        """The pseudo-inertia (4, 4) about the frame's origin."""
        return inertia.pseudo_inertia(inertia.from_centre_of_mass(self.m, self.com, self.six))


def central(pseudo: Array) -> CentralInertia:
    """What a pseudo-inertia (4, 4) is about the centre of mass; that of no mass is the origin."""
    m = float(pseudo[3, 3])
    com = pseudo[:3, 3] / (m or 1.0)
    about = np.zeros((4, 4))
    about[:3, :3], about[3, 3] = pseudo[:3, :3] - m * np.outer(com, com), m
    return CentralInertia(m, com, inertia.from_pseudo_inertia(about)[4:])
