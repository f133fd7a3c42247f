"""A machine in plain numpy, of complex numbers: forces by the principle of virtual power with jets of matrices in time.

Everything is derived here a second time, from the numbers of the machine alone. Frames are homogeneous matrices with
their first and second derivative in time, expressed in the base frame; nothing is projected into frames of bodies, and
no derivative is taken but by time. All steps are analytic, so that an imaginary step of 1e-200 in any number gives the
derivative of a result to rounding (Squire, Trapp 1998).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from hydroopt.machine.actuators import Cylinder, Drive, Motor
from hydroopt.machine.machine import BASE, Machine
from hydroopt.parameters.dynamic import bodies

Array = np.ndarray
STEP = 1e-200


class Jet(NamedTuple):
    """A matrix with its first and second derivative in time."""

    value: Array
    rate: Array
    acceleration: Array

    def __matmul__(self, other: Jet) -> Jet:
        return Jet(self.value @ other.value, self.rate @ other.value + self.value @ other.rate,
                   self.acceleration @ other.value + 2 * self.rate @ other.rate + self.value @ other.acceleration)

    def minus(self, other: Jet) -> Jet:
        return Jet(*(a - b for a, b in zip(self, other, strict=True)))

    def plus(self, other: Jet) -> Jet:
        return Jet(*(a + b for a, b in zip(self, other, strict=True)))

    def times(self, other: Jet) -> Jet:
        return Jet(self.value * other.value, self.rate * other.value + self.value * other.rate,
                   self.acceleration * other.value + 2 * self.rate * other.rate + self.value * other.acceleration)

    def cross(self, other: Jet) -> Jet:
        return Jet(np.cross(self.value, other.value),
                   np.cross(self.rate, other.value) + np.cross(self.value, other.rate),
                   np.cross(self.acceleration, other.value) + 2 * np.cross(self.rate, other.rate)
                   + np.cross(self.value, other.acceleration))

    def dot(self, other: Jet) -> Jet:
        return Jet(*(np.sum(part) for part in self.times(other)))

    def through(self, function: Callable[[Any], Any], slope: Callable[[Any], Any], bend: Callable[[Any], Any]) -> Jet:
        v, w, a = self
        return Jet(function(v), slope(v) * w, slope(v) * a + bend(v) * w**2)

    def power(self, p: float) -> Jet:
        return self.through(lambda v: v**p, lambda v: p * v**(p - 1), lambda v: p * (p - 1) * v**(p - 2))


def fixed(value: Array) -> Jet:
    value = np.asarray(value, dtype=complex)
    return Jet(value, 0 * value, 0 * value)


def turned(angle: Any, axis: int) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    made = np.eye(4, dtype=complex)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    made[i, i] = made[j, j] = c
    made[i, j], made[j, i] = -s, s
    return made


def shifted(by: Any) -> Array:
    made = np.eye(4, dtype=complex)
    made[:3, 3] = by
    return made


class ComplexMachine:
    """A machine whose geometry, by address, may be other (and complex) numbers than those of its file."""

    def __init__(self, machine: Machine, geometry: Mapping[str, Any] | None = None) -> None:
        self.machine = machine
        self.number = {number.name: number.value for number in machine.geometry_numbers} | dict(geometry or {})
        roll, pitch, yaw = machine.orientation
        world = turned(yaw, 2) @ turned(pitch, 1) @ turned(roll, 0)
        self.gravity = world[:3, :3].T @ np.array([0, 0, -machine.gravity])

    def frames(self, q: Array, qd: Array, qdd: Array) -> tuple[dict[str, Jet], dict[str, Jet]]:
        """Frames of the links and of their far ends, by name; the base is one of them."""
        frames, ends = {BASE: fixed(np.eye(4))}, {BASE: fixed(np.eye(4))}
        place = {name: k for k, name in enumerate(self.machine.joints)}
        for link in self.machine.links:
            keys = ("a", "alpha", "beta", "theta", "d")
            a, alpha, beta, theta, d = (self.number[f"{link.name}.{key}"] for key in keys)
            start = fixed(shifted((0, 0, d)) @ turned(theta, 2))
            if link.name in place:
                k = place[link.name]
                if link.joint.type == "prismatic":
                    up = np.zeros((4, 4))
                    up[2, 3] = 1
                    moved = Jet(shifted((0, 0, q[k])), up * qd[k], up * qdd[k])
                else:
                    now, spin = turned(q[k], 2), np.zeros((4, 4))
                    spin[0, 1], spin[1, 0] = -1, 1
                    moved = Jet(now, now @ spin * qd[k], now @ (spin * qdd[k] + spin @ spin * qd[k]**2))
                start = start @ moved
            frames[link.name] = ends[link.parent] @ start
            ends[link.name] = frames[link.name] @ fixed(shifted((a, 0, 0)) @ turned(alpha, 0) @ turned(beta, 1))
        return frames, ends

    def pins(self, frames: Mapping[str, Jet], cylinder: Any) -> list[Jet]:
        found = []
        for end in ("barrel", "rod"):
            at = np.array([*(self.number[f"{cylinder.name}.{end}.{axis}"] for axis in "xyz"), 1.0])
            whole = frames[getattr(cylinder, end).link]
            found.append(Jet(*(part[:3] for part in whole @ fixed(at))))
        return found

    def length(self, frames: Mapping[str, Jet], cylinder: Any) -> Jet:
        barrel, rod = self.pins(frames, cylinder)
        across = rod.minus(barrel)
        return across.dot(across).power(0.5)

    def cylinder_bodies(self, frames: Mapping[str, Jet], ends: Mapping[str, Jet],
                        cylinder: Cylinder) -> tuple[Jet, Jet]:
        """Frames of barrel and rod: x along the centre line, z as near as possible to the axis of the driven joint."""
        link = self.machine.link(self.machine.axis_of(cylinder))
        if link.joint.type == "prismatic":  # then x of the joint's frame: a cylinder may lie along its z
            axis = Jet(*(part[:3, 0] for part in frames[link.name]))
        else:
            axis = Jet(*(part[:3, 2] for part in ends[link.parent]))
        barrel, rod = self.pins(frames, cylinder)

        def unit(vector: Jet) -> Jet:
            return Jet(*(np.asarray(part) for part in vector.times(vector.dot(vector).power(-0.5))))

        x = unit(rod.minus(barrel))
        y = unit(axis.cross(x))
        z = x.cross(y)
        made = []
        for pin in (barrel, rod):
            parts = []
            for k in range(3):
                whole = np.zeros((4, 4), dtype=complex)
                whole[:3] = np.column_stack([x[k], y[k], z[k], pin[k]])
                whole[3, 3] = k == 0
                parts.append(whole)
            made.append(Jet(*parts))
        return made[0], made[1]

    def moved(self, q: Array, qd: Array, qdd: Array) -> dict[str, Jet]:
        """Frames of all bodies by owner."""
        frames, ends = self.frames(q, qd, qdd)
        found = dict(frames)
        for cylinder in self.machine.cylinders:
            both = self.cylinder_bodies(frames, ends, cylinder)
            found |= dict(zip((f"{cylinder.name}.barrel", f"{cylinder.name}.rod"), both, strict=True))
        return found

    def tip_jacobian(self, q: Array) -> Array:
        rows = []
        for unit in np.eye(len(q)):
            end = self.frames(q, unit, 0 * unit)[1][self.machine.tip]
            rows.append(np.concatenate([end.rate[:3, 3], spin(end)]))
        return np.array(rows).T

    def transmission(self, q: Array) -> Array:
        rows = []
        for actuator in self.machine.actuators:
            if isinstance(actuator, Cylinder):
                rows.append([self.length(self.frames(q, unit, 0 * unit)[0], actuator).rate for unit in np.eye(len(q))])
            else:
                rows.append(np.eye(len(q))[self.machine.joints.index(actuator.joint)])
        return np.array(rows)

    def forces(self, q: Array, qd: Array, qdd: Array, psi: Mapping[str, Any], wrench: Array | None = None, *,
               friction: bool = True) -> Array:
        """Actuator forces (n,) of a motion, with parameters by name; friction is linear and has no dead zone."""
        machine, n = self.machine, len(q)
        now, units = self.moved(q, qd, qdd), [self.moved(q, unit, 0 * unit) for unit in np.eye(n)]
        total = np.zeros(n, dtype=complex)
        for owner in bodies(machine):
            phi = np.array([psi[f"{owner}.{key}"] for key in
                            ("m", "mc_x", "mc_y", "mc_z", "I_xx", "I_xy", "I_xz", "I_yy", "I_yz", "I_zz")])
            jet = now[owner]
            R, w, wd = jet.value[:3, :3], spin(jet), spin_rate(jet)
            a = jet.acceleration[:3, 3] - self.gravity
            mc = R @ phi[1:4]
            xx, xy, xz, yy, yz, zz = phi[4:]
            about = R @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ R.T
            force = phi[0] * a + np.cross(wd, mc) + np.cross(w, np.cross(w, mc))
            moment = np.cross(mc, a) + about @ wd + np.cross(w, about @ w)
            total += [force @ each[owner].rate[:3, 3] + moment @ spin(each[owner]) for each in units]
        if wrench is not None:
            total -= self.tip_jacobian(q).T @ wrench
        T = self.transmission(q)
        for k, joint in enumerate(machine.joints if friction else ()):
            sign = np.sign(qd[k].real)
            total[k] += psi.get(f"{joint}.tau_coulomb", 0) * sign + psi.get(f"{joint}.tau_viscous", 0) * qd[k]
        for actuator in machine.actuators:
            if isinstance(actuator, Drive):
                k = machine.joints.index(actuator.joint)
                total[k] += psi.get(f"{actuator.name}.rotor_inertia", 0) * actuator.gear**2 * qdd[k]
            if isinstance(actuator, Cylinder) and friction:
                total += self._pin_friction(actuator, q, qd, psi)
        for gas in machine.gas_cylinders:
            out = 1 if gas.acts == "push" else -1
            lengths = [self.length(self.frames(q, unit, 0 * unit)[0], gas) for unit in np.eye(n)]
            volume = gas.volume + out * gas.area * (lengths[0].value - gas.reference_length)
            push = out * gas.area * psi[f"{gas.name}.precharge"] * (gas.volume / volume)**gas.polytropic
            total -= push * np.array([each.rate for each in lengths])
        found = np.linalg.solve(T.T, total)
        speed = T @ qd
        for k, actuator in enumerate(machine.actuators if friction else ()):
            kind = f"{actuator.name}.{'f' if isinstance(actuator, Cylinder) else 'tau'}"
            found[k] += (psi.get(f"{kind}_offset", 0) + psi.get(f"{kind}_coulomb", 0) * np.sign(speed[k].real)
                         + psi.get(f"{kind}_viscous", 0) * speed[k])
        return found

    def _pin_friction(self, cylinder: Cylinder, q: Array, qd: Array, psi: Mapping[str, Any]) -> Array:
        """Torques about the pins, z of the cylinder's frame, against the turn relative to the links they sit in."""
        def turns(rates: Array) -> list[Any]:
            moved = self.moved(q, rates, 0 * rates)
            return [(spin(moved[f"{cylinder.name}.{end}"]) - spin(moved[getattr(cylinder, end).link]))
                    @ moved[f"{cylinder.name}.{end}"].value[:3, 2] for end in ("barrel", "rod")]
        now, shares = turns(qd), np.array([turns(unit) for unit in np.eye(len(q))])
        return sum((psi.get(f"{cylinder.name}.n_{end}", 0) * np.sign(now[k].real) * shares[:, k]
                    for k, end in enumerate(("barrel", "rod"))), np.zeros(len(q)))

    def measured(self, reading: Mapping[str, Any]) -> Array:
        """Actuator forces (n,) from readings by channel (Eq. 4.33, 4.61), from areas and motor constants."""
        found = []
        for actuator in self.machine.actuators:
            match actuator:
                case Cylinder():
                    head, rod = actuator.areas
                    found.append(head * reading[f"{actuator.name}.p_head"] - rod * reading[f"{actuator.name}.p_rod"])
                case Motor():
                    constant = actuator.torque_per_pressure * actuator.gear
                    found.append(constant * (reading[f"{actuator.name}.p_a"] - reading[f"{actuator.name}.p_b"]))
                case _:
                    found.append(reading[f"{actuator.joint}.tau"])
        return np.array(found)


def spin(jet: Jet) -> Array:
    """Angular velocity (3,) of a frame, from Ṙ·Rᵀ."""
    W = jet.rate[:3, :3] @ jet.value[:3, :3].T
    return np.array([W[2, 1] - W[1, 2], W[0, 2] - W[2, 0], W[1, 0] - W[0, 1]]) / 2


def spin_rate(jet: Jet) -> Array:
    """Angular acceleration (3,): the skew part of R̈·Rᵀ."""
    W = jet.acceleration[:3, :3] @ jet.value[:3, :3].T
    return np.array([W[2, 1] - W[1, 2], W[0, 2] - W[2, 0], W[1, 0] - W[0, 1]]) / 2


def complex_step(function: Callable[[Array], Array], x: Array) -> Array:
    """Jacobian (m, n) of a real-analytic function at x (n,), exact to rounding."""
    columns = []
    for k in range(len(x)):
        moved = x.astype(complex)
        moved[k] += 1j * STEP
        columns.append(np.asarray(function(moved)).imag / STEP)
    return np.array(columns).T
