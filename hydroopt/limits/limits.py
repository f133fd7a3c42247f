"""The limits of a machine as bounded functions of the joints' state, each with a name for messages.

Joint positions, speeds and accelerations; cylinder strokes and speeds; the pump's flow; what valves give at the
supply's pressure; chamber pressures or torques; what passive joints leave without balance; workspace, ground, obstacles
and the machine's own parts; tipping over, moving and when stopped. What depends on uncertain parameters counts as the
value that it keeps with the reserves' certainty.
"""

from __future__ import annotations

import itertools
from collections.abc import Collection
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from hydroopt.limits.parts import (
    Part,
    built_close,
    distance,
    distance_to_point,
    drawn_distances,
    pairs,
    parts,
)
from hydroopt.limits.reserves import DEFAULT, Reserves
from hydroopt.limits.uncertain import UncertainParameters
from hydroopt.machine.actuators import Cylinder, Drive, Motor
from hydroopt.machine.machine import BASE
from hydroopt.model.hanging import Hanging
from hydroopt.model.hydraulics import ActuatorHydraulics, chamber_flows
from hydroopt.model.kinematics import gravity_in_base
from hydroopt.model.model import Model
from hydroopt.model.regressor import body_regressor
from hydroopt.parameters.dynamic import bodies
from hydroopt.parameters.hydraulic import parameter_set
from hydroopt.simulation.simulate import BACK_PRESSURE
from hydroopt.spatial.inertia import Array

ROUNDING = 1e-9
"""Change of a value, as a part of a limit's scale or in m, that counts as rounding."""
TIGHT = 0.02
"""Part of a limit's scale within which it leaves no room."""
WATCHED = 0.5
"""Distance [m] beyond their reserve within which the machine's own parts are watched."""
MARGIN, POSTURES = 3.0, 200
"""How many assumed tracking errors lie between a plan and the value at which it is stopped; random postures in which
the largest effect of such an error is sought."""


class Row(NamedTuple):
    """A limited quantity: name, unit, bounds, and the scale by which its values are divided.

    Values below `floor` do not occur on the machine and count as `floor`. `margin` lies between the bounds and the
    limit less its reserve: so far beyond the plan a motion is stopped. `seen` says whether people see it. `low`
    names the link or strut whose height above ground it is, and `passive` says that it is what a passive joint leaves
    without balance.
    """

    name: str
    unit: str
    lower: float
    upper: float
    scale: float
    floor: float = -np.inf
    margin: float = 0.0
    seen: bool = False
    low: str = ""
    passive: bool = False


class Limits:
    """All limits of a machine as one function of the joints' state.

    Args:
        model: of the machine.
        reserves: that are kept of them.
        known: what is known of ψ; by default what the machine file states.
        resting: joints that rest, without a tracking error.
        near: distance [m] within which the machine's own parts are watched; by default `WATCHED` beyond their reserve.

    Attributes:
        rows: what is bounded (m,), in the order of the function's output; bounds are less the reserves, and less the
            margin of `Reserves.tracking`.
        function: casadi.Function (q, qd, qdd) → (m,). It does not contain the bounds, so that machines that differ
            only in bounds share its kernel.
        derivatives: of it, (m, 3n), by q, then qd, then qdd.
        scale: (m,) of the rows.
        lower, upper: bounds (m,), divided by the scales.
        hanging: the passive joints.
        back_pressure: [Pa] in the chamber that does not push.

    Example:
        >>> from hydroopt.machine.machine_file import load_machine
        >>> model = Model(load_machine("cat215b"))
        >>> limits, itself = Limits(model), Limits(model, Reserves.none())
        >>> {row.name: row.lower for row in limits.rows}["stick above ground"].__round__(2)
        0.46
        >>> {row.name: row.lower for row in itself.rows}["stick above ground"]
        0.0
    """

    back_pressure = BACK_PRESSURE

    def __init__(self, model: Model, reserves: Reserves = DEFAULT, known: UncertainParameters | None = None,
                 resting: Collection[str] = (), near: float | None = None) -> None:
        model.refuse_seals("limits of a motion")
        self.model, self.reserves = model, reserves.checked()
        self.known = UncertainParameters.stated(model) if known is None else known
        self.hanging = Hanging(model)
        self._near = self.reserves.between + WATCHED if near is None else near
        self._psi = ca.SX.sym("psi", len(model.parameters))
        self._force = self._worst(_actuator_forces(model, self._psi)) if model.machine.actuators else None
        self._entries: list[tuple[Row, ca.SX]] = []
        self._joints()
        self._cylinders()
        self._pump()
        self._efforts()
        self._valves()
        self._workspace()
        self._clearances()
        self._tipping()
        self._passive()
        self.scale = np.array([row.scale for row, _ in self._entries])
        states, values = model.coordinates, ca.vertcat(*(value for _, value in self._entries))
        self.function = ca.Function("limits", [*states], [values], ["q", "qd", "qdd"], ["value"])
        self.derivatives = ca.Function("limits_derivatives", [*states],
                                       [ca.densify(ca.jacobian(values, ca.vertcat(*states)))],
                                       ["q", "qd", "qdd"], ["by_state"])
        self._errors = self._tracking_errors()
        self._bound(resting)

    def __reduce__(self) -> tuple[type[Limits], tuple[object, ...]]:
        return Limits, (self.model, self.reserves, self.known, self.resting, self._near)

    def without_reserves(self) -> Limits:
        """The limits of the machine itself, of the same quantities."""
        return Limits(self.model, Reserves.none(), self.known, near=self._near)

    def while_resting(self, joints: Collection[str]) -> Limits:
        """The same limits while some joints rest."""
        made = object.__new__(Limits)
        made.__dict__.update(self.__dict__)  # a copy by `__reduce__` would write all expressions again
        made._bound(joints)
        return made

    def _bound(self, resting: Collection[str]) -> None:
        self.resting = tuple(resting)
        moving = ~np.isin(self.model.machine.joints, self.resting)
        margins = dict[str, float]()
        for (row, _), errors in zip(self._entries, self._errors, strict=True):
            margins[row.name] = max(margins.get(row.name, 0.0), float(np.linalg.norm(errors[moving])))
        self.rows = tuple(row._replace(lower=row.lower + margins[row.name], upper=row.upper - margins[row.name],
                                       margin=margins[row.name]) for row, _ in self._entries)
        self.lower, self.upper = (np.array([getattr(row, side) for row in self.rows]) / self.scale
                                  for side in ("lower", "upper"))

    def _tracking_errors(self) -> Array:
        """What `MARGIN` tracking errors of each joint make of each row (m, n), of lengths and angles alone, at most."""
        joints, q = self.model.machine.joints, self.model.coordinates.q
        low, high = self.model.machine.ranges.T
        places = [k for k, (row, _) in enumerate(self._entries) if row.unit in ("m", "rad")]
        found = np.zeros((len(self._entries), len(joints)))
        if self.reserves.tracking and places:
            slopes = ca.Function("slopes", [q], [ca.densify(ca.jacobian(
                ca.vertcat(*(self._entries[k][1] for k in places)), q))]).map(POSTURES)
            drawn = np.random.default_rng(0).uniform(low, high, (POSTURES, len(joints)))
            by_q = np.abs(np.asarray(slopes(drawn.T))).reshape(len(places), POSTURES, len(joints))
            found[places] = np.max(np.where(np.isfinite(by_q), by_q, 0.0), axis=1)
        return np.asarray(MARGIN * self.reserves.tracking * (high - low) * found)

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

    def names(self, rows: NDArray[np.bool_]) -> list[str]:
        """Names of some rows (m,), each once."""
        return list(dict.fromkeys(self.rows[k].name for k in np.flatnonzero(rows)))

    def _worst(self, value: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Mean (m,) of expressions that are linear in ψ, and by how much each of them exceeds it at most (m,)."""
        mean, std = self.known.of(value, self._psi)
        return mean, self.reserves.deviations() * std

    def _add(self, name: str, unit: str, value: ca.SX, lower: float = -np.inf, upper: float = np.inf,
             scale: float | None = None, floor: float = -np.inf, **of: Any) -> None:
        sizes = [abs(bound) for bound in (lower, upper) if np.isfinite(bound) and bound]
        self._entries.append((Row(name, unit, lower, upper, scale or (max(sizes) if sizes else 1.0), floor=floor, **of),
                              value))

    def _joints(self) -> None:
        machine, states = self.model.machine, self.model.coordinates
        for k, name in enumerate(machine.joints):
            joint = machine.link(name).joint
            unit = "m" if joint.type == "prismatic" else "rad"
            lower, upper = joint.range
            self._add(f"{name} position", unit, states.q[k], lower, upper, upper - lower, seen=True)
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
            self._add("pump flow", "m^3/s", sum(chosen[1:], chosen[0]),
                      upper=(1 - self.reserves.flow) * machine.pump.max_flow, scale=machine.pump.max_flow)

    def _efforts(self) -> None:
        model, kept = self.model, 1 - self.reserves.pressure
        if self._force is None:
            return
        force, more = self._force
        for k, actuator in enumerate(model.machine.actuators):
            if isinstance(actuator, Drive):
                if (most := actuator.max_torque) is not None:
                    unit = model.machine.effort_unit(actuator.joint)
                    self._add(f"{actuator.name} torque", unit, force[k] + more[k], upper=kept * most, scale=most)
                    self._add(f"{actuator.name} torque", unit, force[k] - more[k], lower=-kept * most, scale=most)
                continue
            if actuator.relief_pressure is None:
                continue
            # a chamber pushes against the back pressure in the other one
            areas, most = actuator.areas, kept * actuator.relief_pressure
            for chamber, area, other, sign in zip(actuator.chambers, areas, areas[::-1], (1, -1), strict=True):
                self._add(" ".join(chamber.split(".")), "Pa",
                          (sign * force[k] + more[k] + other * self.back_pressure) / area,
                          upper=most if most >= self.back_pressure else -np.inf,  # cannot be satisfied
                          scale=actuator.relief_pressure, floor=self.back_pressure)

    def _valves(self) -> None:
        """Forces that valves still give at a speed, since the flow through them takes force of what the supply gives:
        f ± R·v² ≤ A·p_supply − A'·p_tank in both directions (see `ActuatorHydraulics.opening_for`)."""
        machine = self.model.machine
        if self._force is None or machine.pump is None or machine.pump.pressure is None or machine.oil is None:
            return
        (force, more), opened = self._force, 1 - self.reserves.flow
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
                          sign * (force[k] + resistance / opened**2 * squared) + more[k], upper=most, scale=most)

    def _workspace(self) -> None:
        machine = self.model.machine
        if machine.workspace is None:
            return
        last = machine.links[-1].name
        tip = (self.model.dynamics.links[last].pose @ self.model.dynamics.geometry.far_end(last)).origin
        for k, (low, high) in enumerate(zip(machine.workspace.lower, machine.workspace.upper, strict=True)):
            self._add(f"workspace along {'xyz'[k]}", "m", tip[k], low, high, high - low)

    def _clearances(self) -> None:
        machine, dynamics, reserves = self.model.machine, self.model.dynamics, self.reserves
        found = parts(self.model)
        if machine.ground is not None:
            for part in found:
                # lines around an area end at each of its corners
                for end in (part.end,) if part.link else (part.start, part.end):
                    if _varies(end[2], self.model.coordinates.q):
                        self._add(f"{part.name} above ground", "m", end[2] - part.radius - machine.ground,
                                  reserves.clearance, scale=1.0, seen=True, low=part.name)
        for obstacle in machine.obstacles:
            pose = dynamics.links[obstacle.link].pose if obstacle.link != BASE else None
            centre = ca.SX(ca.DM(obstacle.centre)) if pose is None else pose.point(ca.DM(obstacle.centre))
            for part in found:
                away = self._from_obstacle(part, obstacle.link, centre, obstacle.radius)
                if away is not None:
                    self._add(f"distance of {part.name} to {obstacle.name}", "m",
                              away - part.radius - obstacle.radius, reserves.clearance, scale=1.0, seen=True)
        for one, other in pairs(self.model, self._near):
            self._add(f"distance of {one.name} to {other.name}", "m", distance(one, other) - one.radius - other.radius,
                      reserves.between, scale=1.0, seen=True)

    def _from_obstacle(self, part: Part, carrier: str, centre: ca.SX, radius: float) -> ca.SX | None:
        """Distance of a part from the centre of a ball on a link.

        Of a line that is pinned to that link and built close to the ball, that of its outer half. None if it is the
        carrier, or a cylinder that is pinned there and built close, or if it does not move against it.
        """
        if part.link == carrier:
            return None
        away = distance_to_point(part, centre)
        drawn, = drawn_distances(self.model, [away - part.radius - radius])
        if carrier in part.bodies and part.rooted and built_close(drawn):
            if not part.link:
                return None
            away = distance_to_point(part._replace(start=(part.start + part.end) / 2), centre)
            drawn, = drawn_distances(self.model, [away])
        return away if drawn.size and np.ptp(drawn) > ROUNDING else None

    def _tipping(self) -> None:
        machine, dynamics = self.model.machine, self.model.dynamics
        if machine.footprint is None or machine.ground is None:
            return
        columns = self.model.parameters.bodies
        force, moment = ca.SX(3, 1), ca.SX(3, 1)
        for owner in bodies(machine, actuator_inertia=self.model.actuator_inertia):
            motion = dynamics.body_motion(owner)
            wrench = body_regressor(motion) @ self._psi[columns[owner].start:columns[owner].stop]
            body_force = motion.pose.rotation @ wrench[:3]
            force += body_force
            moment += motion.pose.rotation @ wrench[3:] + ca.cross(motion.pose.origin, body_force)
        down, chassis = ca.DM(gravity_in_base(machine)), ca.SX.sym("chassis", 4)
        force -= chassis[0] * down
        moment -= ca.cross(chassis[1:], down)
        corners = [np.array([*corner, machine.ground]) for corner in machine.footprint.corners]
        total = machine.gravity * (machine.footprint.mass + sum(
            self.known.mean[columns[owner].start] for owner in columns)) or 1.0
        middle, restoring = machine.footprint.middle, []
        reserves = []
        for k, corner in enumerate(corners):
            edge = corners[(k + 1) % len(corners)] - corner
            along = edge / np.linalg.norm(edge)
            # about each edge of the footprint the moment of the ground's force must not be negative
            restoring.append(ca.dot(ca.DM(along), moment - ca.cross(ca.DM(corner), force)))
            arm = along[0] * (middle[1] - corner[1]) - along[1] * (middle[0] - corner[0])
            reserves.append(self.reserves.tipping * total * arm)
        moving = ca.vertcat(*restoring)
        # a motion that keeps both keeps them at any slower pace: what it adds grows with the square of the pace
        stopped = ca.substitute(moving, ca.vertcat(*self.model.coordinates[1:]), ca.DM.zeros(2 * len(machine.joints)))
        of_chassis = UncertainParameters.chassis(machine)
        for value in (moving, stopped):
            mean, by_bodies = self.known.of(value, self._psi)
            mean, by_chassis = of_chassis.of(mean, chassis)
            more = self.reserves.deviations(len(corners)) * ca.sqrt(by_bodies**2 + by_chassis**2)
            for k, reserve in enumerate(reserves):
                self._add(f"tipping over edge {k + 1}", "N*m", mean[k] - more[k], float(reserve), scale=total)

    def _passive(self) -> None:
        hanging = self.hanging
        for joint, value, most in zip(hanging.joints, ca.vertsplit(hanging.balance),
                                      hanging.tolerance if hanging.joints else (), strict=True):
            name = self.model.machine.joints[joint]
            self._add(f"{name} out of balance", self.model.machine.effort_unit(name), value, -most, most,
                      passive=True)


class UseOfLimit(NamedTuple):
    """What a motion uses of a limit, over all of its samples [`unit`]; infinite bounds are none.

    `sample` is where it comes nearest to a bound; `margin` and `seen` are those of its row.
    """

    name: str
    unit: str
    lower: float
    lowest: float
    highest: float
    upper: float
    sample: int = 0
    margin: float = 0.0
    seen: bool = False

    @property
    def stop(self) -> tuple[float, float]:
        """Values below and above which a motion is stopped, infinite where it is not: beyond the plan by the margin."""
        return (self.lowest - self.margin if self.margin and np.isfinite(self.lower) else -np.inf,
                self.highest + self.margin if self.margin and np.isfinite(self.upper) else np.inf)

    @property
    def room(self) -> float:
        """What is left; not negative if the limit is kept."""
        return min(self.lowest - self.lower, self.upper - self.highest)

    @property
    def part(self) -> float:
        """What is left of the range, or of the bound if there is but one; not a number if that is zero."""
        bounds = [bound for bound in (self.lower, self.upper) if np.isfinite(bound)]
        size = float(np.ptp(bounds)) or abs(bounds[0])
        return self.room / size if size else float("nan")


class Course(NamedTuple):
    """A limited quantity over time (N,), and what is used of its limit."""

    values: Array
    use: UseOfLimit


def courses(limits: Limits, q: Array, qd: Array, qdd: Array) -> dict[str, Course]:
    """Each limited quantity over states (N, n); of rows that share a name, at each sample the one with the least room.

    >>> from hydroopt.machine.machine_file import load_machine
    >>> model = Model(load_machine("patu655_lift"))
    >>> use = courses(Limits(model), np.array([[0.2], [0.3]]), np.zeros((2, 1)), np.zeros((2, 1)))["lift position"].use
    >>> round(use.lowest, 9), use.highest, use.room > 0
    (0.2, 0.3, True)
    """
    values, found = limits.values(q, qd, qdd) * limits.scale, dict[str, list[int]]()
    for k, row in enumerate(limits.rows):
        found.setdefault(row.name, []).append(k)
    return {name: _course(limits, values, places) for name, places in found.items()}


def _course(limits: Limits, values: Array, places: list[int]) -> Course:
    rows = [limits.rows[k] for k in places]
    own = np.maximum(values[:, places], [row.floor for row in rows])
    lower, upper = ([getattr(row, side) for row in rows] for side in ("lower", "upper"))
    room = np.minimum(own - lower, upper - own)
    bounded = [[k for k, bound in enumerate(side) if np.isfinite(bound)] or range(len(rows)) for side in (lower, upper)]
    use = UseOfLimit(rows[0].name, rows[0].unit, max(lower), float(np.min(own[:, bounded[0]])),
                     float(np.max(own[:, bounded[1]])), min(upper), int(np.argmin(np.min(room, axis=1))),
                     rows[0].margin, rows[0].seen)
    return Course(np.take_along_axis(own, np.argmin(room, axis=1)[:, None], axis=1)[:, 0], use)


def _actuator_forces(model: Model, psi: ca.SX) -> ca.SX:
    """Forces (a,) of all actuators in the model's coordinates."""
    dynamics = model.dynamics
    made = dynamics.forces if model.machine.one_each else dynamics.actuator_forces
    return made(psi)


def _varies(value: ca.SX, q: ca.SX) -> bool:
    """Whether a value changes with q."""
    at = ca.Function("value", [q], [value]).map(2)(np.random.default_rng(0).uniform(-1, 1, (q.size1(), 2)))
    return not np.ptp(np.asarray(at)) < ROUNDING
