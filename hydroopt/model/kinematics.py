"""Poses, velocities and accelerations of all links along the kinematic tree, in SX."""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca

from hydroopt.machine.geometry import Geometry
from hydroopt.machine.links import Link
from hydroopt.machine.machine import BASE, Machine
from hydroopt.spatial.poses import Pose, identity, roll_pitch_yaw, skew

UP = ca.SX(ca.DM([0, 0, 1]))
STILL = ca.SX(3, 1)


class Coordinates(NamedTuple):
    """Joint variables, their rates and accelerations, each (n,): [rad] or [m], per s, per s²."""

    q: ca.SX
    qd: ca.SX
    qdd: ca.SX


class Motion(NamedTuple):
    """Motion of a frame P fixed to a body; all vectors (3,) are expressed in P.

    `acceleration` is that of the origin minus gravity, p̈ − g, as it stands in Eq. 4.14.
    """

    pose: Pose
    velocity: ca.SX
    acceleration: ca.SX
    rotation: ca.SX
    rotation_rate: ca.SX

    def carry(self, inner: Pose, velocity: ca.SX, acceleration: ca.SX, rotation: ca.SX, rotation_rate: ca.SX) -> Motion:
        """Motion of a frame that moves relative to this one; its relative motion is expressed in that frame."""
        back, r = inner.rotation.T, inner.origin
        turning = back @ self.rotation
        return Motion(
            self.pose @ inner,
            back @ (self.velocity + ca.cross(self.rotation, r)) + velocity,
            back @ (self.acceleration + self.spread @ r) + 2 * ca.cross(turning, velocity) + acceleration,
            turning + rotation,
            back @ self.rotation_rate + ca.cross(turning, rotation) + rotation_rate)

    @property
    def spread(self) -> ca.SX:
        """(3, 3) [1/s²]: p̈ of a point of the body is that of the origin + spread · (its place in P)."""
        turn = skew(self.rotation)
        return skew(self.rotation_rate) + turn @ turn

    def fixed(self, inner: Pose) -> Motion:
        """Motion of another frame fixed to the same body."""
        return self.carry(inner, STILL, STILL, STILL, STILL)


def coordinates(machine: Machine) -> Coordinates:
    """Fresh symbols for the joint variables and their derivatives."""
    n = len(machine.joints)
    return Coordinates(ca.SX.sym("q", n), ca.SX.sym("qd", n), ca.SX.sym("qdd", n))


def rate(expression: ca.SX, tree: Coordinates) -> ca.SX:
    """Time derivative of an expression in joint variables and their rates."""
    flat = ca.vec(expression)
    found = ca.jtimes(flat, ca.vertcat(tree.q, tree.qd), ca.vertcat(tree.qd, tree.qdd))
    return ca.reshape(found, expression.shape)


def gravity_in_base(machine: Machine) -> ca.DM:
    """Gravity vector (3,) [m/s²] in the base frame."""
    return ca.DM(roll_pitch_yaw(machine.orientation).T @ (-machine.gravity * UP))


def base_motion(machine: Machine) -> Motion:
    """Motion of the base: at rest, which counts as accelerated upwards by g."""
    return Motion(identity(), STILL, -gravity_in_base(machine), STILL, STILL)


def link_motions(geometry: Geometry, tree: Coordinates, links: tuple[Link, ...] | None = None) -> dict[str, Motion]:
    """Motion of the frame P_i of every link, and of the base, by the outward recursion of Newton and Euler.

    `tree` holds all moving joints of `links`, in their order; by default those of the machine without its calibrator.
    """
    links = geometry.machine.links if links is None else links
    joints = [link.name for link in links if link.joint.moving]
    motions = {BASE: base_motion(geometry.machine)}
    for link in links:
        q, qd, qdd = (0.0, 0.0, 0.0)
        if link.name in joints:
            q, qd, qdd = (column[joints.index(link.name)] for column in tree)
        step = geometry.seat(link.name) @ geometry.joint(link.name, q)
        slide, turn = (UP, STILL) if link.joint.type == "prismatic" else (STILL, UP)
        motions[link.name] = motions[link.parent].carry(step, slide * qd, slide * qdd, turn * qd, turn * qdd)
    return motions
