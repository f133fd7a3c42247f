"""Modified Denavit-Hartenberg numbers (Eq. 3.8) from one joint's axis to the next."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hydroopt.machine.robot_formats.frames import pose, tidy, turn
from hydroopt.spatial.inertia import Array

_NEARLY_PARALLEL = math.sin(math.radians(2))


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
