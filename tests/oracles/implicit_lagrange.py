"""Lagrange's equations in independent coordinates, where pins are closed by Newton's method and not by a formula.

Bodies are pseudo-inertias J (4, 4), so that with a pose X (3, 4) the kinetic energy is tr(Ẋ·J·Ẋᵀ)/2 and

    d/dt ∂T/∂q̇ − ∂T/∂q + ∂V/∂q = Σ ⟨∂X/∂q, Ẍ·J − g·(J·e₄)ᵀ⟩.

All joints of the tree are coordinates z of poses; what closes the loops, c(z) = 0, gives ż and z̈ of dependent joints
from those of the independent ones by its own derivatives. Poses are written here a second time, from the numbers alone.
"""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import casadi as ca
import numpy as np
from scipy.spatial.transform import Rotation

from hydroopt.machine.actuators import Cylinder, GasCylinder
from hydroopt.machine.links import Link
from hydroopt.machine.loops import Loop
from hydroopt.machine.machine import BASE, Machine

STEPS = 12
FARTHEST = 0.3
"""Largest change of a dependent joint [rad, m] from one posture to the next: beside a toggle Newton's method would lead
farther ones onto the other branch."""


class Pose(NamedTuple):
    """Rotation (3, 3) and origin (3,), in the frame of the base."""

    turn: ca.SX
    origin: ca.SX

    def then(self, turn: ca.SX, shift: ca.SX) -> Pose:
        return Pose(self.turn @ turn, self.point(shift))

    def point(self, local: ca.SX) -> ca.SX:
        return self.origin + self.turn @ ca.DM(local) if isinstance(local, tuple) else self.origin + self.turn @ local


class Solution(NamedTuple):
    """What holds at one motion.

    Attributes:
        z: positions of all joints of the tree.
        joint_forces: (n,) generalised forces at the independent joints.
        actuator_rates: (m, n) rates of all actuators per rate of the independent joints.
        lengths: of all cylinders [m].
    """

    z: np.ndarray
    joint_forces: np.ndarray
    actuator_rates: np.ndarray
    lengths: np.ndarray


class ImplicitLagrange:
    """Links, barrels and rods with the bodies `clouds` (owner → φ)."""

    def __init__(self, machine: Machine, clouds: dict[str, np.ndarray]) -> None:
        self.machine = machine
        self.names = machine.tree_joints
        z, zd, zdd = (ca.SX.sym(name, len(self.names)) for name in ("z", "zd", "zdd"))
        self.at = dict(zip(self.names, ca.vertsplit(z), strict=True))
        self.frames = {BASE: Pose(ca.SX.eye(3), ca.SX.zeros(3))}
        for link in machine.links:
            self.frames[link.name] = self._link(link)
        cylinders = machine.cylinders
        lengths = ca.vertcat(*(ca.norm_2(self._line(each)) for each in cylinders))
        bodies = {owner: self._body(owner) for owner in clouds}
        poses = ca.vertcat(*(ca.vec(ca.horzcat(*pose)) for pose in bodies.values()))
        up = Rotation.from_euler("xyz", machine.orientation).inv().apply([0, 0, 1.0])
        rate = ca.jtimes(poses, z, zd)
        second = ca.jtimes(rate, z, zd) + ca.jtimes(poses, z, zdd)
        loads = []
        for k, phi in enumerate(clouds.values()):
            pseudo = ca.DM(_pseudo_inertia(phi))
            moved = ca.reshape(second[12 * k:12 * k + 12], 3, 4) @ pseudo
            loads.append(ca.vec(moved + machine.gravity * ca.DM(up) @ pseudo[:, 3].T))
        forces = ca.jtimes(poses, z, ca.vertcat(*loads), True) if clouds else ca.SX.zeros(len(self.names))
        closed = ca.vertcat(*self._closures(), ca.SX(0, 1))
        drift = ca.jtimes(ca.jtimes(closed, z, zd), z, zd)
        self.closed = ca.Function("closed", [z], [closed, ca.jacobian(closed, z)])
        self.of = ca.Function("of", [z, zd, zdd], [drift, forces, lengths, ca.jacobian(lengths, z)])
        self.given = [self.names.index(joint) for joint in machine.joints]
        self.free = [k for k in range(len(self.names)) if k not in self.given]
        self.start: np.ndarray | None = None

    def _link(self, link: Link) -> Pose:
        j = link.joint
        at = self.at.get(link.name, ca.SX(0))
        if link.pin is not None:
            seat = self.frames[link.parent].then(ca.SX.eye(3), ca.DM(link.pin))
        elif link.parent == BASE:
            seat = self.frames[BASE]
        else:
            before = self.machine.link(link.parent).joint
            seat = self.frames[link.parent].then(_about(0, before.alpha) @ _about(1, before.beta),
                                                 ca.DM([before.a, 0, 0]))
        turn, slide = (0, at) if j.type == "prismatic" else (at, 0)
        return seat.then(_about(2, j.theta + turn), ca.vertcat(0, 0, j.d + slide))

    def _pin(self, link: str, pin: tuple[float, ...]) -> ca.SX:
        return self.frames[link].point(ca.DM(pin))

    def _line(self, cylinder: Cylinder | GasCylinder) -> ca.SX:
        ends = (self._pin(end.link, end.pin) for end in (cylinder.rod, cylinder.barrel))
        return next(ends) - next(ends)

    def _body(self, owner: str) -> Pose:
        """Frame of a link, or of a barrel or rod: x along the centre line, z normal to it, next to the joint's axis."""
        if owner in self.frames:
            return self.frames[owner]
        name, _, end = owner.partition(".")
        cylinder = next(each for each in self.machine.pinned if each.name == name)
        held = getattr(cylinder, end)
        line = self._line(cylinder)
        x = line / ca.norm_2(line)
        joint = self.machine.axis_of(cylinder)
        axis = self.frames[joint].turn[:, 0 if self.machine.link(joint).joint.type == "prismatic" else 2]
        y = ca.cross(axis, x)
        y /= ca.norm_2(y)
        return Pose(ca.horzcat(x, y, ca.cross(x, y)), self._pin(held.link, held.pin))

    def _closures(self) -> list[ca.SX]:
        """What is zero where all loops are closed."""
        found = []
        for loop in self.machine.loops:
            far = (self.machine.link(loop.link).joint.a, 0.0, 0.0) if loop.pin is None else loop.pin
            gap = self._pin(loop.link, far) - self._pin(loop.to.link, loop.to.pin)
            if loop.closed_by == "rod":
                gap = (ca.sumsqr(gap) - loop.length**2) / (2 * loop.length)
            elif loop.closed_by == "pin":
                gap = ca.vertcat(*(ca.dot(axis, gap) for axis in ca.horzsplit(self._plane(loop))))
            found.append(gap)
        for coupling in self.machine.couplings:
            found.append(self.at[coupling.joint] - coupling.offset
                         - sum(ratio * self.at[joint] for joint, ratio in coupling.ratios.items()))
        return found

    def _plane(self, loop: Loop) -> ca.SX:
        """Two axes of the plane in which a loop moves: normal to the axis of a joint in it that turns."""
        turning = next(joint for joint in self.machine.joints_between(loop.link, loop.to.link)
                       if self.machine.link(joint).joint.type == "revolute")
        return self.frames[turning].turn[:, :2]

    def _close(self, z: np.ndarray) -> bool:
        """Newton's method on dependent joints, in place."""
        for _ in range(40):
            gap, jacobian = (np.array(each) for each in self.closed(z))
            try:
                step = np.linalg.solve(jacobian[:, self.free], -gap[:, 0])
            except np.linalg.LinAlgError:
                return False
            z[self.free] += step
            if np.max(np.abs(step), initial=0.0) < 1e-15:
                break
        return bool(np.max(np.abs(np.array(self.closed(z)[0])), initial=0.0) < 1e-12)

    def _side(self, z: np.ndarray) -> float:
        """Sign that changes where a loop passes a toggle."""
        return float(np.linalg.slogdet(np.array(self.closed(z)[1])[:, self.free])[0])

    def _begin(self) -> np.ndarray:
        """All joints in the stated postures, with closed loops."""
        known = {name: sum(self.machine.link(name).joint.range) / 2 for name in self.machine.joints}
        for loop in self.machine.loops:
            known |= loop.posture
        stated = [k for k in self.free if self.names[k] in known]
        unknown = [k for k in self.free if self.names[k] not in known]
        found: list[tuple[float, np.ndarray]] = []
        for guess in product(np.linspace(-3, 3, 7), repeat=len(unknown)):
            z = np.array([known.get(name, 0.0) for name in self.names])
            z[unknown] = guess
            about = z.copy()
            if self._close(z):
                found.append((float(np.max(np.abs(_wrapped((z - about)[stated])), initial=0.0)), z))
        away, nearest = min(found, key=lambda each: each[0], default=(np.inf, np.empty(0)))
        assert away < 0.4, "no posture closes the loops near the stated one"
        return nearest

    def solve(self, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> Solution:
        if self.start is None:
            self.start = self._begin()
        z, begin = self.start.copy(), self.start[self.given]
        share, step, side = 0.0, 1 / STEPS, self._side(z)
        while share < 1:
            step = min(step, 1 - share)
            trial = z.copy()
            trial[self.given] = begin + (share + step) * (q - begin)
            if (self._close(trial) and np.max(np.abs(trial - z)[self.free], initial=0.0) < FARTHEST
                    and self._side(trial) == side):
                z, share, step = trial, share + step, 2 * step
            else:
                step /= 2
                assert step > 1e-9, "the loops cannot be followed to this posture"
        jacobian = np.array(self.closed(z)[1])
        through = np.zeros((len(z), len(q)))
        through[self.given] = np.eye(len(q))
        through[self.free] = np.linalg.solve(jacobian[:, self.free], -jacobian[:, self.given])
        zd = through @ qd
        drift = np.array(self.of(z, zd, 0)[0])[:, 0]
        zdd = through @ qdd
        zdd[self.free] -= np.linalg.solve(jacobian[:, self.free], drift)
        _, forces, lengths, slopes = (np.array(each) for each in self.of(z, zd, zdd))
        names = [each.name for each in self.machine.cylinders]
        rates = [slopes[names.index(each.name)] if isinstance(each, Cylinder) else
                 np.eye(len(z))[self.names.index(each.joint)] for each in self.machine.actuators]
        return Solution(z, through.T @ forces[:, 0], np.array(rates) @ through, lengths[:, 0])


def _wrapped(angle: np.ndarray) -> np.ndarray:
    return np.angle(np.exp(1j * angle))


def _about(axis: int, angle: ca.SX | float) -> ca.SX:
    c, s = ca.cos(angle), ca.sin(angle)
    made = ca.SX.eye(3)
    i, j = ((1, 2), (2, 0), (0, 1))[axis]
    made[i, i], made[i, j], made[j, i], made[j, j] = c, -s, s, c
    return made


def _pseudo_inertia(phi: np.ndarray) -> np.ndarray:
    m, x, y, z, xx, xy, xz, yy, yz, zz = phi
    about = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    made = np.zeros((4, 4))
    made[:3, :3] = np.trace(about) / 2 * np.eye(3) - about
    made[:3, 3] = made[3, :3] = x, y, z
    made[3, 3] = m
    return made
