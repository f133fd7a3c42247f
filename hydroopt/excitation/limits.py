"""What a machine cannot or must not do, as rows of numbers with bounds, each with a name a user knows.

Joint positions, speeds and accelerations; cylinder strokes and speeds; the pump's flow; chamber pressures or torques by
the nominal dynamics with a margin for its uncertainty; workspace, ground and obstacles; tipping over.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import casadi as ca
import numpy as np

from hydroopt.dynamic_parameters import bodies
from hydroopt.identifiability import random_states
from hydroopt.inertia import NAMES, Array
from hydroopt.machine import BASE
from hydroopt.model.build import Model
from hydroopt.model.kinematics import gravity_in_base
from hydroopt.model.regressor import body_regressor
from hydroopt.parts import Cylinder, Motor
from hydroopt.spatial import roll_pitch_yaw


class Row(NamedTuple):
    """A quantity over a motion: its name, unit, bounds and typical size, by which its excess is judged."""

    name: str
    unit: str
    lower: float
    upper: float
    scale: float


class Limits:
    """All limits of a machine as one function of the joints' state.

    Attributes:
        rows: what is bounded (m,), in the order of the function's output.
        function: casadi.Function (q, qd, qdd) → (m,) and its Jacobians (m, n) by q, qd and qdd.
        lower, upper: bounds (m,), divided by the rows' scales like the function's output.
        fixed: joints that rest.
    """

    def __init__(self, model: Model, margin: Array | None = None) -> None:
        self.model = model
        machine = model.machine
        self.margin = np.zeros(len(machine.actuators)) if margin is None else margin
        self._found: list[tuple[Row, ca.SX]] = []
        self._joints()
        self._cylinders()
        self._pump()
        self._efforts()
        self._places()
        self._tipping()
        self.rows = tuple(row for row, _ in self._found)
        scale = np.array([row.scale for row in self.rows])
        values = ca.vertcat(*(value for _, value in self._found)) / ca.DM(scale)
        at = model.at
        self.function = ca.Function("limits", [*at], [values, *(ca.densify(ca.jacobian(values, x)) for x in at)],
                                    ["q", "qd", "qdd"], ["value", "by_q", "by_qd", "by_qdd"])
        self.lower = np.array([row.lower for row in self.rows]) / scale
        self.upper = np.array([row.upper for row in self.rows]) / scale

    def excess(self, values: Array) -> Array:
        """By how much (N, m) values (N, m) exceed their bounds, in units of the rows' scales; at most zero if kept."""
        return np.asarray(np.maximum(values - self.upper, self.lower - values))

    def _add(self, name: str, unit: str, value: ca.SX, lower: float = -np.inf, upper: float = np.inf,
             scale: float | None = None) -> None:
        sizes = [abs(bound) for bound in (lower, upper) if np.isfinite(bound) and bound]
        self._found.append((Row(name, unit, lower, upper, scale or (max(sizes) if sizes else 1.0)), value))

    def _joints(self) -> None:
        machine, at = self.model.machine, self.model.at
        for k, name in enumerate(machine.joints):
            joint = machine.link(name).joint
            unit = "m" if joint.type == "prismatic" else "rad"
            lower, upper = joint.range
            self._add(f"{name} position", unit, at.q[k], lower, upper, upper - lower)
            for what, limit, value, per in (("speed", joint.max_speed, at.qd[k], "/s"),
                                            ("acceleration", joint.max_acceleration, at.qdd[k], "/s^2")):
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
        if machine.pump is None:
            return
        # an actuator draws what its growing chamber takes, whichever grows: the greatest of all combinations counts
        draws = []
        for k, actuator in enumerate(machine.actuators):
            speed = self.model.dynamics.rates[k]
            if isinstance(actuator, Cylinder):
                head, rod = actuator.areas
                draws.append((head * speed, -rod * speed))
            elif isinstance(actuator, Motor):
                size = actuator.torque_per_pressure * actuator.gear
                draws.append((size * speed, -size * speed))
        for chosen in itertools.product(*draws) if draws else ():
            self._add("pump flow", "m^3/s", sum(chosen[1:], chosen[0]), upper=machine.pump.max_flow)

    def _efforts(self) -> None:
        model = self.model
        force = model.dynamics.forces(ca.DM(model.parameters.nominal), actuator_inertia=model.actuator_inertia)
        for k, actuator in enumerate(model.machine.actuators):
            margin = float(self.margin[k])
            if isinstance(actuator, Cylinder) and actuator.relief_pressure is not None:
                head, rod = (area * actuator.relief_pressure for area in actuator.areas)
                self._add(f"{actuator.name} pressure", "N", force[k], margin - rod, head - margin, head)
            elif isinstance(actuator, Motor) and actuator.relief_pressure is not None:
                most = abs(actuator.torque_per_pressure) * actuator.gear * actuator.relief_pressure
                self._add(f"{actuator.name} pressure", "N*m", force[k], margin - most, most - margin, most)
            elif not isinstance(actuator, Cylinder | Motor) and actuator.max_torque is not None:
                most = actuator.max_torque
                self._add(f"{actuator.name} torque", model.force_units[k], force[k], margin - most, most - margin, most)

    def _places(self) -> None:
        machine, dynamics = self.model.machine, self.model.dynamics
        ends = {link.name: (dynamics.links[link.name].pose @ dynamics.geometry.far_end(link.name)).origin
                for link in machine.links}
        tip = ends[machine.links[-1].name]
        if machine.workspace is not None:
            for k, (low, high) in enumerate(zip(machine.workspace.lower, machine.workspace.upper, strict=True)):
                self._add(f"workspace along {'xyz'[k]}", "m", tip[k], low, high, high - low)
        if machine.ground is not None:
            up = ca.DM(roll_pitch_yaw(machine.orientation))[2, :]
            for name, end in ends.items():
                height = up @ end
                if not height.is_constant():
                    self._add(f"{name} above ground", "m", height, machine.ground, scale=1.0)
        for obstacle in machine.obstacles:
            pose = dynamics.links[obstacle.link].pose if obstacle.link != BASE else None
            centre = ca.DM(obstacle.centre) if pose is None else pose.point(ca.DM(obstacle.centre))
            self._add(f"distance to {obstacle.name}", "m^2", ca.sumsqr(tip - centre), obstacle.radius**2)

    def _tipping(self) -> None:
        machine, dynamics = self.model.machine, self.model.dynamics
        if machine.footprint is None or machine.ground is None:
            return
        psi, place = self.model.parameters.nominal, self.model.parameters.positions
        force, moment = ca.SX(3, 1), ca.SX(3, 1)
        for owner in bodies(machine, actuator_inertia=self.model.actuator_inertia):
            motion = dynamics.body_motion(owner)
            first = place[f"{owner}.m"]
            wrench = body_regressor(motion) @ ca.DM(psi[first:first + len(NAMES)])
            own = motion.pose.rotation @ wrench[:3]
            force += own
            moment += motion.pose.rotation @ wrench[3:] + ca.cross(motion.pose.origin, own)
        weight = -machine.footprint.mass * ca.DM(gravity_in_base(machine))
        force += weight
        moment += ca.cross(ca.DM(machine.footprint.com), weight)
        corners = [np.array([*corner, machine.ground]) for corner in machine.footprint.corners]
        total = float(np.linalg.norm(np.asarray(weight))) or 1.0
        for k, corner in enumerate(corners):
            edge = corners[(k + 1) % len(corners)] - corner
            # about each edge the ground's push must turn inwards, or the machine leaves the ground
            held = ca.dot(ca.DM(edge / np.linalg.norm(edge)), moment - ca.cross(ca.DM(corner), force))
            self._add(f"tipping over edge {k + 1}", "N*m", held, 0.0, scale=total)


def margins(model: Model, samples: int = 400, seed: int = 0) -> Array:
    """Twice the standard deviation (n,) of every actuator's force that the prior leaves, in the worst of random states.

    Of states within the limits of joints; actuators whose parameters have no prior get what the others leave.
    """


    states = random_states(model, samples, np.random.default_rng(seed))
    K = model.over(model.regressor, *states)[0]
    information = model.parameters.information
    known = np.diag(information) > 0
    covariance = np.linalg.inv(information[np.ix_(known, known)])
    variance = np.einsum("tij,jk,tik->ti", K[:, :, known], covariance, K[:, :, known])
    return np.asarray(2 * np.sqrt(np.median(variance, axis=0)))
