"""A machine as Pinocchio sees it: links as a tree, barrels and rods as branches on ball joints at their pins.

Built from the numbers of the machine alone; poses, loops and projections are derived here a second time.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from hydroopt.machine.actuators import Cylinder, GasCylinder
from hydroopt.machine.machine import BASE, Machine

WORLD = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED


class Branch(NamedTuple):
    cylinder: Cylinder
    carrier: str


class Jet(NamedTuple):
    """A quantity with its first and second derivative in time."""

    value: np.ndarray
    rate: np.ndarray
    acceleration: np.ndarray

    def __sub__(self, other: Jet) -> Jet:
        return Jet(*(a - b for a, b in zip(self, other, strict=True)))

    def cross(self, other: Jet) -> Jet:
        return Jet(np.cross(self.value, other.value),
                   np.cross(self.rate, other.value) + np.cross(self.value, other.rate),
                   np.cross(self.acceleration, other.value) + 2 * np.cross(self.rate, other.rate)
                   + np.cross(self.value, other.acceleration))

    def unit(self) -> Jet:
        v, w, z = self
        size = np.linalg.norm(v)
        u = v / size
        grows = u @ w
        turns = (w - u * grows) / size
        return Jet(u, turns, (z - u * (turns @ w + u @ z) - 2 * turns * grows) / size)


class PinocchioTree:
    """Links, and barrels and rods as far as `clouds` (owner → φ) names them."""

    def __init__(self, machine: Machine, clouds: dict[str, np.ndarray]) -> None:
        self.machine = machine
        self.model = pin.Model()
        self.model.gravity.linear = np.array([0, 0, -machine.gravity])
        self.places = {BASE: (0, pin.SE3(pin.rpy.rpyToMatrix(*machine.orientation), np.zeros(3)))}
        self._links(clouds)
        self.joints = len(machine.joints)
        self.branches = [self._branch(cylinder, end, clouds) for cylinder in machine.cylinders
                         for end in ("barrel", "rod") if f"{cylinder.name}.{end}" in clouds]
        for cylinder in (*machine.cylinders, *machine.gas_cylinders):
            for end in ("barrel", "rod"):
                attachment = getattr(cylinder, end)
                joint, place = self.places[attachment.link]
                self._frame(f"{cylinder.name}.{end}", joint, place * _shift(attachment.pin))
        for name, (joint, place) in self.places.items():
            self._frame(name, joint, place)
        self.data = self.model.createData()

    def _frame(self, name: str, joint: int, place: pin.SE3) -> None:
        self.model.addFrame(pin.Frame(f"at {name}", joint, 0, place, pin.FrameType.OP_FRAME))

    def _links(self, clouds: dict[str, np.ndarray]) -> None:
        ends = dict(self.places)
        for link in self.machine.links:
            j = link.joint
            parent, end = ends[link.parent]
            start = end * _shift((0, 0, j.d)) * _turn(j.theta, 2)
            if j.type == "locked":
                joint, place = parent, start
            else:
                kind = pin.JointModelPZ() if j.type == "prismatic" else pin.JointModelRZ()
                joint, place = self.model.addJoint(parent, kind, start, link.name), pin.SE3.Identity()
            self.places[link.name] = joint, place
            ends[link.name] = joint, place * _shift((j.a, 0, 0)) * _turn(j.alpha, 0) * _turn(j.beta, 1)
            if link.name in clouds:
                self.model.appendBodyToJoint(joint, _inertia(clouds[link.name]), place)

    def _branch(self, cylinder: Cylinder, end: str, clouds: dict[str, np.ndarray]) -> Branch:
        name, attachment = f"{cylinder.name}.{end}", getattr(cylinder, end)
        parent, place = self.places[attachment.link]
        joint = self.model.addJoint(parent, pin.JointModelSpherical(), place * _shift(attachment.pin), name)
        self.model.appendBodyToJoint(joint, _inertia(clouds[name]), pin.SE3.Identity())
        return Branch(cylinder, attachment.link)

    def transmission(self, q: np.ndarray) -> np.ndarray:
        """Actuator speeds per joint speed (n, n), from the speeds of the pins along the centre line."""
        rows = []
        for actuator in self.machine.actuators:
            if isinstance(actuator, Cylinder):
                rows.append([self.centre_line(actuator, q, unit)[1] for unit in np.eye(self.joints)])
            else:
                rows.append(np.eye(self.joints)[self.machine.joints.index(actuator.joint)])
        return np.array(rows)

    def centre_line(self, cylinder: Cylinder | GasCylinder, q: np.ndarray,
                    qd: np.ndarray) -> tuple[float, float]:
        """Length of a cylinder and its rate."""
        self._move(q, qd, np.zeros_like(qd))
        line = self._point(f"{cylinder.name}.rod") - self._point(f"{cylinder.name}.barrel")
        return float(np.linalg.norm(line.value)), float(line.unit().value @ line.rate)

    def distance_to_axis(self, cylinder: Cylinder, end: str) -> float:
        """Distance [m] of a pin from the axis of the joint that the cylinder drives, as the tree stands."""
        joint = self.machine.axis_of(cylinder)
        away = self._point(f"{cylinder.name}.{end}") - self._point(joint)
        return float(np.linalg.norm(np.cross(self._axis(joint).value, away.value)))

    def joint_forces(self, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
        """Generalised forces (n,): the torques of the whole tree, projected through the loops."""
        whole = pin.rnea(self.model, self.data, *self.extended(q, qd, qdd)).copy()
        nothing = np.zeros(self.joints)
        loops = np.array([self.extended(q, unit, nothing)[1] for unit in np.eye(self.joints)])
        return loops @ whole

    def actuator_forces(self, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
        """Forces (n,) of the actuators that do the same work as `joint_forces`."""
        return np.linalg.solve(self.transmission(q).T, self.joint_forces(q, qd, qdd))

    def energy(self, q: np.ndarray, qd: np.ndarray) -> float:
        """Kinetic and potential energy [J] of all bodies."""
        position, speed, _ = self.extended(q, qd, np.zeros_like(q))
        return float(pin.computeKineticEnergy(self.model, self.data, position, speed)
                     + pin.computePotentialEnergy(self.model, self.data, position))

    def extended(self, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> list[np.ndarray]:
        """State of the whole tree at which the loops are closed and stay closed."""
        self._move(q, qd, qdd)
        parts = [[q], [qd], [qdd]]
        for branch in self.branches:
            for part, more in zip(parts, self._ball(branch), strict=True):
                part.append(more)
        return [np.concatenate(part) for part in parts]

    def _ball(self, branch: Branch) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Quaternion, angular velocity and its rate of a barrel or rod relative to its carrier."""
        name = branch.cylinder.name
        x = (self._point(f"{name}.rod") - self._point(f"{name}.barrel")).unit()
        y = self._axis(self.machine.axis_of(branch.cylinder)).cross(x).unit()
        axes = zip(x, y, x.cross(y), strict=True)
        turn, rate, acceleration = (np.column_stack(columns) for columns in axes)
        spin, spun = pin.unSkew(turn.T @ rate), _antisymmetric(turn.T @ acceleration)
        carrier = self.model.getFrameId(f"at {branch.carrier}")
        relative = self.data.oMf[carrier].rotation.T @ turn
        moved = pin.getFrameVelocity(self.model, self.data, carrier, WORLD).angular
        rotates = pin.getFrameAcceleration(self.model, self.data, carrier, WORLD).angular
        own = spin - turn.T @ moved
        return pin.Quaternion(relative).coeffs(), own, spun - turn.T @ rotates + np.cross(own, turn.T @ moved)

    def _move(self, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> None:
        extra = 3 * len(self.branches)
        rest = np.concatenate([q, np.tile([0, 0, 0, 1.0], len(self.branches))])
        pin.forwardKinematics(self.model, self.data, rest, np.append(qd, np.zeros(extra)),
                              np.append(qdd, np.zeros(extra)))
        pin.updateFramePlacements(self.model, self.data)

    def _point(self, name: str) -> Jet:
        frame = self.model.getFrameId(f"at {name}")
        return Jet(self.data.oMf[frame].translation.copy(),
                   pin.getFrameVelocity(self.model, self.data, frame, WORLD).linear,
                   pin.getFrameClassicalAcceleration(self.model, self.data, frame, WORLD).linear)

    def _axis(self, name: str) -> Jet:
        frame = self.model.getFrameId(f"at {name}")
        # a cylinder may lie along the axis of a sliding joint: there the convention takes the joint's x axis
        sliding = self.machine.link(name).joint.type == "prismatic"
        z = self.data.oMf[frame].rotation[:, 0 if sliding else 2].copy()
        w = pin.getFrameVelocity(self.model, self.data, frame, WORLD).angular
        wd = pin.getFrameAcceleration(self.model, self.data, frame, WORLD).angular
        return Jet(z, np.cross(w, z), np.cross(wd, z) + np.cross(w, np.cross(w, z)))


def _shift(by: tuple[float, float, float]) -> pin.SE3:
    return pin.SE3(np.eye(3), np.array(by, dtype=float))


def _turn(angle: float, axis: int) -> pin.SE3:
    return pin.SE3(pin.AngleAxis(angle, np.eye(3)[axis]).matrix(), np.zeros(3))


def _antisymmetric(matrix: np.ndarray) -> np.ndarray:
    # RᵀR̈ = [ω̇×] + [ω×]², and the second term is symmetric
    return pin.unSkew((matrix - matrix.T) / 2)


def _inertia(phi: np.ndarray) -> pin.Inertia:
    m, x, y, z, xx, xy, xz, yy, yz, zz = phi
    return pin.Inertia.FromDynamicParameters(np.array([m, x, y, z, xx, xy, yy, xz, yz, zz]))
