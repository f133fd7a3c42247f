"""The limits of a machine as bounded functions of the joints' state, each with a name for messages.

Joint positions, speeds and accelerations; cylinder strokes and speeds; the pump's flow; what fully open valves give at
the supply's pressure; chamber pressures or torques by the nominal dynamics with a margin for its uncertainty; what
passive joints leave without balance; workspace, ground and obstacles; tipping over.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import casadi as ca
import numpy as np

from hydroopt.estimation.inference.identifiability import random_states
from hydroopt.machine.actuators import Cylinder, Drive, Motor
from hydroopt.machine.machine import BASE
from hydroopt.model.flow_demand import chamber_flows
from hydroopt.model.hanging import Hanging
from hydroopt.model.hydraulics import ActuatorHydraulics
from hydroopt.model.kinematics import gravity_in_base
from hydroopt.model.model import Model
from hydroopt.model.regressor import body_regressor
from hydroopt.parameters.dynamic import bodies
from hydroopt.parameters.hydraulic import parameter_set
from hydroopt.simulation.simulate import BACK_PRESSURE
from hydroopt.spatial.inertia import Array

USED = 0.9
"""Part of a valve's opening, and of the pump's flow, that a designed motion uses in steady flow: the rest is for leaks,
for the oil's compression and for a controller that catches up."""


class Row(NamedTuple):
    """A limited quantity: name, unit, bounds, and the scale by which its values are divided.

    Values below `floor` do not occur on the machine and count as `floor`.
    """

    name: str
    unit: str
    lower: float
    upper: float
    scale: float
    floor: float = -np.inf


class Limits:
    """All limits of a machine as one function of the joints' state.

    Attributes:
        rows: what is bounded (m,), in the order of the function's output.
        function: casadi.Function (q, qd, qdd) → (m,). It does not contain the bounds, so that machines that differ
            only in bounds share its kernel.
        derivatives: of it, (m, 3n), by q, then qd, then qdd.
        scale: (m,) of the rows.
        lower, upper: bounds (m,), divided by the scales.
        margin: (a,) force [N, N·m] that each actuator keeps in reserve.
        hanging: the passive joints.
        back_pressure: [Pa] in the chamber that does not push.
    """

    back_pressure = BACK_PRESSURE

    def __init__(self, model: Model, margin: Array | None = None) -> None:
        self.model = model
        machine = model.machine
        self.hanging = Hanging(model)
        self.margin = np.zeros(len(machine.actuators)) if margin is None else margin
        self._entries: list[tuple[Row, ca.SX]] = []
        self._joints()
        self._cylinders()
        self._pump()
        self._efforts()
        self._valves()
        self._positions()
        self._tipping()
        self._passive()
        self.rows = tuple(row for row, _ in self._entries)
        self.scale = np.array([row.scale for row in self.rows])
        states, values = model.coordinates, ca.vertcat(*(value for _, value in self._entries))
        self.function = ca.Function("limits", [*states], [values], ["q", "qd", "qdd"], ["value"])
        self.derivatives = ca.Function("limits_derivatives", [*states],
                                       [ca.densify(ca.jacobian(values, ca.vertcat(*states)))],
                                       ["q", "qd", "qdd"], ["by_state"])
        self.lower = np.array([row.lower for row in self.rows]) / self.scale
        self.upper = np.array([row.upper for row in self.rows]) / self.scale

    def __reduce__(self) -> tuple[type[Limits], tuple[object, ...]]:
        return Limits, (self.model, self.margin)

    def values(self, q: Array, qd: Array, qdd: Array) -> Array:
        """What is limited (N, m) in states (N, n), divided by the scales."""
        return np.asarray(self.model.over(self.function, q, qd, qdd)[0][:, :, 0] / self.scale)

    def slopes(self, q: Array, qd: Array, qdd: Array) -> Array:
        """Derivatives (N, m, 3n), not divided by the scales, of what is limited by q, then qd, then qdd."""
        return np.asarray(self.model.over(self.derivatives, q, qd, qdd)[0])

    def excess(self, values: Array) -> Array:
        """By how much (N, m) values (N, m) exceed their bounds: at most zero if satisfied, infinite if not a number."""
        found = np.maximum(values - self.upper, self.lower - values)
        return np.where(np.isfinite(found), found, np.inf)

    def _add(self, name: str, unit: str, value: ca.SX, lower: float = -np.inf, upper: float = np.inf,
             scale: float | None = None, floor: float = -np.inf) -> None:
        sizes = [abs(bound) for bound in (lower, upper) if np.isfinite(bound) and bound]
        self._entries.append((Row(name, unit, lower, upper, scale or (max(sizes) if sizes else 1.0), floor), value))

    def _joints(self) -> None:
        machine, states = self.model.machine, self.model.coordinates
        for k, name in enumerate(machine.joints):
            joint = machine.link(name).joint
            unit = "m" if joint.type == "prismatic" else "rad"
            lower, upper = joint.range
            self._add(f"{name} position", unit, states.q[k], lower, upper, upper - lower)
            for what, limit, value, per in (("speed", joint.max_speed, states.qd[k], "/s"),
                                            ("acceleration", joint.max_acceleration, states.qdd[k], "/s^2")):
                if limit is not None:
                    self._add(f"{name} {what}", unit + per, value, -limit, limit)

    def _cylinders(self) -> None:
        for cylinder in self.model.machine.cylinders:
            motion = self.model.dynamics.cylinders[cylinder.name]
            self._add(f"{cylinder.name} stroke", "m", motion.length, cylinder.dead_length,
                      cylinder.dead_length + cylinder.stroke, cylinder.stroke)
            if cylinder.max_speed is not None:
                self._add(f"{cylinder.name} speed", "m/s", motion.speed, -cylinder.max_speed, cylinder.max_speed)

    def _pump(self) -> None:
        machine = self.model.machine
        if machine.pump is None or machine.pump.max_flow is None:
            return
        # the flow of an actuator depends on its direction, and a maximum has no derivative: one row for each of the
        # 2^n combinations of directions
        demands = [chamber_flows(actuator, self.model.dynamics.rates[k])
                   for k, actuator in enumerate(machine.actuators) if isinstance(actuator, Cylinder | Motor)]
        for chosen in itertools.product(*demands) if demands else ():
            self._add("pump flow", "m^3/s", sum(chosen[1:], chosen[0]), upper=USED * machine.pump.max_flow,
                      scale=machine.pump.max_flow)

    def _efforts(self) -> None:
        model = self.model
        force = _actuator_forces(model, ca.DM(model.parameters.nominal))
        for k, actuator in enumerate(model.machine.actuators):
            margin = float(self.margin[k])
            if isinstance(actuator, Drive):
                if (most := actuator.max_torque) is not None:
                    unit = model.machine.effort_units(actuator.joint)[0]
                    self._add(f"{actuator.name} torque", unit, force[k], margin - most, most - margin, most)
                continue
            if actuator.relief_pressure is None:
                continue
            # a chamber pushes against the back pressure in the other one
            areas = actuator.areas
            for chamber, area, other, sign in zip(actuator.chambers, areas, areas[::-1], (1, -1), strict=True):
                most = actuator.relief_pressure - margin / area
                self._add(" ".join(chamber.split(".")), "Pa", (sign * force[k] + other * self.back_pressure) / area,
                          upper=most if most >= self.back_pressure else -np.inf,  # cannot be satisfied
                          scale=actuator.relief_pressure, floor=self.back_pressure)

    def _valves(self) -> None:
        """Forces that valves still give at a speed, since the flow through them takes force of what the supply gives:
        f ± R·v² ≤ A·p_supply − A'·p_tank in both directions (see `ActuatorHydraulics.opening_for`)."""
        machine = self.model.machine
        if machine.pump is None or machine.pump.pressure is None or machine.oil is None:
            return
        force = _actuator_forces(self.model, ca.DM(self.model.parameters.nominal))
        theta = parameter_set(machine)
        numbers = dict(zip(theta.names, theta.nominal.tolist(), strict=True))
        supply, tank = machine.pump.pressure, machine.pump.tank_pressure
        for k, actuator in enumerate(machine.actuators):
            if isinstance(actuator, Drive) or actuator.circuit is None:
                continue
            each = ActuatorHydraulics(actuator, actuator.circuit, machine.oil)
            (a, b), squared = each.areas, self.model.dynamics.rates[k] * ca.fabs(self.model.dynamics.rates[k])
            own = {key.removeprefix(f"{actuator.name}."): value for key, value in numbers.items()}
            taken = each.resistances(own.__getitem__)
            for sign, resistance, most in ((1, taken[0], a * supply - b * tank), (-1, taken[1], b * supply - a * tank)):
                self._add(f"{actuator.name} valve {'forwards' if sign > 0 else 'backwards'}",
                          "N" if isinstance(actuator, Cylinder) else "N*m",
                          sign * (force[k] + resistance / USED**2 * squared), upper=most - float(self.margin[k]),
                          scale=most)

    def _passive(self) -> None:
        hanging = self.hanging
        for joint, value, most in zip(hanging.joints, ca.vertsplit(hanging.balance),
                                      hanging.tolerance if hanging.joints else (), strict=True):
            name = self.model.machine.joints[joint]
            self._add(f"{name} out of balance", self.model.machine.effort_units(name)[0], value, -most, most)

    def _positions(self) -> None:
        machine, dynamics = self.model.machine, self.model.dynamics
        ends = {link.name: (dynamics.links[link.name].pose @ dynamics.geometry.far_end(link.name)).origin
                for link in machine.links}
        tip = ends[machine.links[-1].name]
        if machine.workspace is not None:
            for k, (low, high) in enumerate(zip(machine.workspace.lower, machine.workspace.upper, strict=True)):
                self._add(f"workspace along {'xyz'[k]}", "m", tip[k], low, high, high - low)
        if machine.ground is not None:
            for name, end in ends.items():
                if not end[2].is_constant():
                    self._add(f"{name} above ground", "m", end[2], machine.ground, scale=1.0)
        for obstacle in machine.obstacles:
            pose = dynamics.links[obstacle.link].pose if obstacle.link != BASE else None
            centre = ca.DM(obstacle.centre) if pose is None else pose.point(ca.DM(obstacle.centre))
            self._add(f"distance to {obstacle.name}", "m", ca.norm_2(tip - centre), obstacle.radius)

    def _tipping(self) -> None:
        machine, dynamics = self.model.machine, self.model.dynamics
        if machine.footprint is None or machine.ground is None:
            return
        psi, columns = self.model.parameters.nominal, self.model.parameters.bodies
        owners = tuple(bodies(machine, actuator_inertia=self.model.actuator_inertia))
        force, moment = ca.SX(3, 1), ca.SX(3, 1)
        for owner in owners:
            motion = dynamics.body_motion(owner)
            wrench = body_regressor(motion) @ ca.DM(psi[columns[owner]])
            body_force = motion.pose.rotation @ wrench[:3]
            force += body_force
            moment += motion.pose.rotation @ wrench[3:] + ca.cross(motion.pose.origin, body_force)
        weight = -machine.footprint.mass * ca.DM(gravity_in_base(machine))
        force += weight
        moment += ca.cross(ca.DM(machine.footprint.com), weight)
        corners = [np.array([*corner, machine.ground]) for corner in machine.footprint.corners]
        total = machine.gravity * (machine.footprint.mass + sum(psi[columns[owner].start] for owner in owners)) or 1.0
        for k, corner in enumerate(corners):
            edge = corners[(k + 1) % len(corners)] - corner
            # about each edge of the footprint the moment of the ground's force must not be negative
            restoring = ca.dot(ca.DM(edge / np.linalg.norm(edge)), moment - ca.cross(ca.DM(corner), force))
            self._add(f"tipping over edge {k + 1}", "N*m", restoring, 0.0, scale=total)


def _actuator_forces(model: Model, psi: ca.SX) -> ca.SX:
    """Forces (a,) of all actuators in the model's coordinates."""
    dynamics = model.dynamics
    made = dynamics.forces if model.machine.one_each else dynamics.actuator_forces
    return made(psi, actuator_inertia=model.actuator_inertia)


def margins(model: Model, samples: int = 400, seed: int = 0) -> Array:
    """Reserve of force [N, N·m] (a,) of each actuator for the uncertainty of the nominal parameters.

    Twice the standard deviation of its force by the machine file's confidences, the median over random states within
    the joints' limits; parameters without a stated confidence count as exact.
    """
    states = random_states(model, samples, np.random.default_rng(seed))
    psi = ca.SX.sym("psi", len(model.parameters))
    by_psi = model.regressor if model.machine.one_each else ca.Function(
        "by_psi", [*model.coordinates], [ca.densify(ca.substitute(
            ca.jacobian(_actuator_forces(model, psi), psi), psi, model.parameters.nominal))])
    K = model.over(by_psi, *states)[0]
    information = model.parameters.information
    known = np.diag(information) > 0
    covariance = np.linalg.inv(information[np.ix_(known, known)])
    variance = np.einsum("tij,jk,tik->ti", K[:, :, known], covariance, K[:, :, known])
    return np.asarray(2 * np.sqrt(np.median(variance, axis=0)))
