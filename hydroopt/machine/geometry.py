"""Where a machine's parts sit on one another: its geometric numbers by name, as floats or as symbols."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from hydroopt.machine.actuators import Pinned
from hydroopt.machine.addresses import AXES, TURNS
from hydroopt.machine.loops import Loop
from hydroopt.machine.machine import BASE, Machine
from hydroopt.spatial.cylinder_triangle import Triangle, triangle
from hydroopt.spatial.poses import Pose, identity, joint_pose, link_pose


class Geometry:
    """Links and pins of a machine and of its calibrator.

    Attributes:
        links: all links, the calibrator's last.
        numbers: all numbers of the geometry as the machine file states them.
        value: values by name: the file's numbers where no symbol replaces them.

    Joint variables are given as a mapping from the names of joints, dependent ones too; a joint left out is zero.
    """

    def __init__(self, machine: Machine, symbols: Mapping[str, ca.SX] | Mapping[str, float] | None = None) -> None:
        self.machine = machine
        self.links = (*machine.links, *(machine.calibrator.links if machine.calibrator else ()))
        self.numbers = machine.geometry_numbers
        self.value: dict[str, ca.SX | float] = {number.name: number.value for number in self.numbers}
        self.value |= symbols or {}
        self._link = {link.name: link for link in self.links}

    def point(self, name: str) -> ca.SX:
        """Coordinates (3,) [m] of a named point: ``boom_cylinder.rod``, ``tip``, ``tracker``."""
        return ca.vertcat(*(self.value[f"{name}.{axis}"] for axis in AXES))

    def turn(self, name: str) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Roll, pitch and yaw [rad] of a named frame: ``tracker``."""
        roll, pitch, yaw = (self.value[f"{name}.{axis}"] for axis in TURNS)
        return roll, pitch, yaw

    def far_end(self, link: str) -> Pose:
        """Frame at a link's far end relative to its P_i; that of the base is the base frame."""
        if link == BASE:
            return identity()
        return link_pose(*(self.value[f"{link}.{key}"] for key in ("a", "alpha", "beta")))

    def seat(self, link: str) -> Pose:
        """Frame about or along whose z axis a link's joint moves, relative to its parent's P_i or to the base frame."""
        if self._link[link].pin is None:
            return self.far_end(self._link[link].parent)
        return Pose(identity().rotation, self.point(f"{link}.pin"))

    def joint(self, link: str, variable: ca.SX | float) -> Pose:
        """A link's P_i relative to its joint's seat."""
        theta, d = self.value[f"{link}.theta"], self.value[f"{link}.d"]
        if self._link[link].joint.type == "prismatic":
            return joint_pose(theta, d + variable)
        return joint_pose(theta + variable, d)

    def relative_pose(self, viewer: str, link: str, q: Mapping[str, ca.SX]) -> Pose:
        """Pose of a link's P_i relative to the *far end* of another, or to the base; only joints between them enter."""
        chains = self._ancestry(viewer), self._ancestry(link)
        shared = next(name for name in chains[0] if name in chains[1])
        own = (self.far_end(link).inverse() if link == shared else
               self._from_far_end(chains[1][: chains[1].index(shared)], q))
        if viewer == shared:
            return own
        return (self._from_far_end(chains[0][: chains[0].index(shared)], q) @ self.far_end(viewer)).inverse() @ own

    def from_seat(self, joint: str, link: str, q: Mapping[str, ca.SX]) -> Pose:
        """Pose of a link's P_i, or of the base frame, seen from the seat of a joint; only joints between them enter."""
        viewer = self._link[joint].parent
        chain = self._ancestry(link)
        if self._link[joint].pin is None:
            return self.relative_pose(viewer, link, q)
        if joint in chain:
            return self._down(chain[: chain.index(joint) + 1], q)
        return (self.far_end(viewer).inverse() @ self.seat(joint)).inverse() @ self.relative_pose(viewer, link, q)

    def between(self, viewer: str, link: str) -> Pose:
        """Pose of a link's P_i relative to that of another one, where no joint between them moves."""
        return identity() if link == viewer else self.far_end(viewer) @ self.relative_pose(viewer, link, {})

    def loop_ends(self, loop: Loop) -> tuple[ca.SX, ca.SX]:
        """Both ends (3,) [m] of a loop, each in P_i of the link that it names."""
        own = self.far_end(loop.link).origin if loop.pin is None else self.point(f"{loop.name}.pin")
        return own, self.point(loop.name)

    def loop_axis(self, loop: Loop) -> str:
        """The first joint between a loop's ends that turns, or the first one."""
        joints = self.machine.joints_between(loop.link, loop.to.link)
        return next((joint for joint in joints if self._link[joint].joint.type == "revolute"), joints[0])

    def loop_gap(self, loop: Loop, q: Mapping[str, ca.SX]) -> ca.SX:
        """From one end of a loop to the other (3,) [m], in the seat of its first joint that turns."""
        own, target = self.loop_ends(loop)
        first = self.loop_axis(loop)
        return self.from_seat(first, loop.to.link, q).point(target) - self.from_seat(first, loop.link, q).point(own)

    def triangle(self, cylinder: Pinned) -> tuple[str, Triangle] | None:
        """Joint of the tree and triangle of a cylinder that spans one revolute joint; None for any other cylinder."""
        between = self.machine.joints_between(cylinder.barrel.link, cylinder.rod.link)
        if len(between) != 1 or self._link[between[0]].joint.type != "revolute":
            return None
        pins = {name: self.pin(cylinder, name, {}) for name in ("barrel", "rod")}
        moving = "barrel" if between[0] in self._ancestry(cylinder.barrel.link) else "rod"
        fixed = "rod" if moving == "barrel" else "barrel"
        return between[0], triangle(pins[fixed], pins[moving])

    def pin(self, cylinder: Pinned, end: str, q: Mapping[str, ca.SX]) -> ca.SX:
        """A pin (3,) [m] in the axis frame of the joint that orients the cylinder: the far end of the link before."""
        pose = self.from_seat(self.machine.axis_of(cylinder), getattr(cylinder, end).link, q)
        return pose.point(self.point(f"{cylinder.name}.{end}"))

    def _from_far_end(self, chain: tuple[str, ...], q: Mapping[str, ca.SX]) -> Pose:
        """Pose of the first link of a chain seen from the far end of the last one's parent."""
        outermost, pose = self._link[chain[-1]], self._down(chain, q)
        if outermost.pin is None:
            return pose
        return self.far_end(outermost.parent).inverse() @ self.seat(outermost.name) @ pose

    def _down(self, chain: tuple[str, ...], q: Mapping[str, ca.SX]) -> Pose:
        """Pose of the first link of a chain seen from the seat of the last one."""
        pose = self.joint(chain[-1], q.get(chain[-1], 0.0))
        for name in reversed(chain[:-1]):
            pose = pose @ self.seat(name) @ self.joint(name, q.get(name, 0.0))
        return pose

    def _ancestry(self, name: str) -> tuple[str, ...]:
        chain = [name]
        while chain[-1] != BASE:
            chain.append(self._link[chain[-1]].parent)
        return tuple(chain)
