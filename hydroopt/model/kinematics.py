"""Where every link is and how it moves: poses, velocities and accelerations down the tree, in SX."""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca

from hydroopt.geometry import far_end
from hydroopt.machine import BASE, Machine
from hydroopt.parts import Joint
from hydroopt.spatial import Pose, identity, joint_pose, roll_pitch_yaw

UP = ca.DM([0, 0, 1])


class Coordinates(NamedTuple):
    """Joint variables q, their rates and accelerations, each (n,): [rad] or [m], per s, per s²."""

    q: ca.SX
    qd: ca.SX
    qdd: ca.SX


class Motion(NamedTuple):
    """Motion of a frame P fixed to a body; all vectors (3,) are written in P itself.

    `acceleration` is that of the origin minus gravity, p̈ − g, as it stands in Eq. 4.14.
    """

    pose: Pose
    velocity: ca.SX
    acceleration: ca.SX
    rotation: ca.SX
    rotation_rate: ca.SX

    def of_point(self, local: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Position, velocity and acceleration minus gravity, in the base frame, of a point fixed to the body."""
        velocity = self.velocity + ca.cross(self.rotation, local)
        acceleration = (self.acceleration + ca.cross(self.rotation_rate, local)
                        + ca.cross(self.rotation, ca.cross(self.rotation, local)))
        turn = self.pose.rotation
        return self.pose.point(local), turn @ velocity, turn @ acceleration


def coordinates(machine: Machine) -> Coordinates:
    """Fresh symbols for the joint variables and their derivatives."""
    n = len(machine.joints)
    return Coordinates(ca.SX.sym("q", n), ca.SX.sym("qd", n), ca.SX.sym("qdd", n))


def gravity_in_base(machine: Machine) -> ca.DM:
    """Gravity vector (3,) [m/s²] in the base frame."""
    return ca.DM(roll_pitch_yaw(machine.orientation).T @ (-machine.gravity * UP))


def base_motion(machine: Machine) -> Motion:
    """Motion of the base: at rest, which counts as accelerated upwards by g."""
    zero = ca.DM.zeros(3)
    return Motion(identity(), zero, -gravity_in_base(machine), zero, zero)


def link_motions(machine: Machine, at: Coordinates) -> dict[str, Motion]:
    """Motion of the frame P_i of every link, and of the base, by the outward recursion of Newton and Euler."""
    motions = {BASE: base_motion(machine)}
    for link in machine.links:
        parent = motions[link.parent]
        start = identity() if link.parent == BASE else far_end(machine.link(link.parent).joint)
        index = machine.joints.index(link.name) if link.name in machine.joints else None
        motions[link.name] = _step(parent, start, link.joint, at, index)
    return motions


def _step(parent: Motion, start: Pose, joint: Joint, at: Coordinates, index: int | None) -> Motion:
    q, qd, qdd = (0, 0, 0) if index is None else (at.q[index], at.qd[index], at.qdd[index])
    sliding = joint.type == "prismatic"
    relative = start @ joint_pose(joint.theta + (0 if sliding else q), joint.d + (q if sliding else 0))
    back, r = relative.rotation.T, relative.origin
    rotation = back @ parent.rotation
    rotation_rate = back @ parent.rotation_rate
    velocity = back @ (parent.velocity + ca.cross(parent.rotation, r))
    acceleration = back @ (parent.acceleration + ca.cross(parent.rotation_rate, r)
                           + ca.cross(parent.rotation, ca.cross(parent.rotation, r)))
    if sliding:
        velocity += UP * qd
        acceleration += UP * qdd + 2 * ca.cross(rotation, UP * qd)
    else:
        rotation_rate += UP * qdd + ca.cross(rotation, UP * qd)
        rotation += UP * qd
    return Motion(parent.pose @ relative, velocity, acceleration, rotation, rotation_rate)
