"""The joint of q that one cylinder moves, from the cylinder's length: by its triangle, and by the linkage it drives.

A cylinder that drives a linkage turns a dependent joint, whose angle its triangle gives (Eq. 3.27). The linkage, taken
with this joint moving by itself and the one that the cylinder drives following it, then gives the joint of q.
"""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca
import numpy as np

from hydroopt.machine.actuators import Cylinder
from hydroopt.machine.geometry import Geometry
from hydroopt.machine.mechanism import Mechanism
from hydroopt.spatial.cylinder_triangle import Triangle, triangle_angle, triangle_length


class JointFromLength(NamedTuple):
    """A cylinder in one triangle, in the numbers or symbols of a `geometry`.

    Attributes:
        geometry: where pins and links are.
        joint: the joint of q that the cylinder moves, `turns` the one of its triangle: the same without a linkage.
        sides: the triangle.
        branch, near: see `triangle_angle`.
        middle: middle of the joint's range [rad].
        forward, backward: the machine's mechanism, and the one in which `joint` follows `turns`.
    """

    geometry: Geometry
    joint: str
    turns: str
    sides: Triangle
    branch: int
    near: float
    middle: float
    forward: Mechanism
    backward: Mechanism | None

    def turn(self, length: ca.SX) -> ca.SX:
        """Angle [rad] of the triangle's joint at a length [m]; NaN where the triangle cannot close."""
        return triangle_angle(self.sides, length, self.branch, self.near)

    def angle(self, length: ca.SX) -> ca.SX:
        """Position [rad] of the joint at a length [m]; NaN where triangle or linkage cannot close."""
        return self.driven(self.turn(length))

    def driven(self, turn: ca.SX) -> ca.SX:
        """Position [rad] of the joint at an angle of the triangle's joint: the same without a linkage."""
        if self.backward is None:
            return turn
        away = self.backward.positions(self.geometry, {self.turns: turn})[self.joint] - self.middle
        return self.middle + ca.atan2(ca.sin(away), ca.cos(away))

    def sines(self, turn: ca.SX) -> list[ca.SX]:
        """Sines of the angles between the bars of the linkage, see `Mechanism.sines`; none without a linkage."""
        return [] if self.backward is None else self.backward.sines(self.geometry, {self.turns: turn})

    def length(self, angle: ca.SX) -> ca.SX:
        """Distance of the pins [m] at a position [rad] of the joint."""
        return triangle_length(self.sides, self.forward.positions(self.geometry, {self.joint: angle})[self.turns])


def joint_from_length(geometry: Geometry, cylinder: Cylinder) -> JointFromLength | None:
    """The joint that follows from a cylinder's length alone; None where it takes more, or other, than a length.

    Beside other actuators a cylinder may pass a dead point, on both sides of which its lengths are the same.
    """
    machine, nominal = geometry.machine, Geometry(geometry.machine)
    found, stated, moved = geometry.triangle(cylinder), nominal.triangle(cylinder), machine.moved_by(cylinder)
    if found is None or stated is None or len(moved) != 1:
        return None
    (joint,), (turns, sides), forward = moved, found, Mechanism(machine)
    lower, upper = (limit + float(stated[1].offset) for limit in machine.link(joint).joint.range)
    if len(machine.drivers[joint]) > 1 and (turns != joint or np.ceil(lower / np.pi) * np.pi <= upper):
        return None
    middle = sum(machine.link(joint).joint.range) / 2
    backward = None if turns == joint else forward.turned_round(nominal, joint, turns, middle)
    if turns != joint and backward is None:
        return None
    near = middle if turns == joint else float(forward.positions(nominal, {joint: ca.DM(middle)})[turns])
    branch = int(np.sign(np.sin(near + float(stated[1].offset))))
    return JointFromLength(geometry, joint, turns, sides, branch, near, middle, forward, backward)
