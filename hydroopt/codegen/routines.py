"""The routines of the generated C: inputs, outputs and expressions of each."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import casadi as ca
import numpy as np

from hydroopt.control import valve_inversion
from hydroopt.errors import ProblemError
from hydroopt.machine.actuators import Cylinder
from hydroopt.machine.geometry import Geometry
from hydroopt.machine.machine import Machine
from hydroopt.machine.parameter_kind import ParameterKind
from hydroopt.model.closed_chain import KinematicModel
from hydroopt.model.kinematics import coordinates
from hydroopt.model.model import Model
from hydroopt.model.plant import Plant
from hydroopt.model.regressor import Dynamics
from hydroopt.spatial.cylinder_triangle import triangle_angle
from hydroopt.spatial.inertia import NAMES, UNITS, Array

COINCIDENT = 1e-3
"""Pin distance [m] below which pins count as coinciding."""
EMPTY = 1e-9
"""Volume [m³] below which a gas cylinder counts as empty."""
SHORTEST_LEVER = 1e-4
"""Lever arm [m] below which a cylinder is at its dead point."""


class Kind(NamedTuple):
    """Items that an array index enumerates: names in order, and units if they are numbers."""

    names: tuple[str, ...]
    units: tuple[str, ...] = ()


class Field(NamedTuple):
    """A member of a struct: shape as names of kinds or numbers, unit and meaning."""

    name: str
    shape: tuple[str | int, ...]
    unit: str
    text: str


class Struct(NamedTuple):
    """A struct of the interface."""

    name: str
    text: str
    fields: tuple[Field, ...]


class Guard(NamedTuple):
    """A check of a routine: a value, or its absolute value, must satisfy `relation` to a limit; else it returns
    `status`."""

    value: ca.SX
    relation: str
    limit: float
    status: str
    absolute: bool = False


class Routine(NamedTuple):
    """A function of the interface: the struct it takes and the members it reads, the struct it returns and its
    expressions.

    `lengths` are the pin distances of the hydraulic cylinders, which are compared with their strokes; None if the
    routine does not use them.
    """

    name: str
    text: str
    takes: str
    reads: tuple[str, ...]
    gives: str
    outputs: Mapping[str, ca.SX]
    guards: tuple[Guard, ...] = ()
    lengths: ca.SX | None = None


class DesignedMotion(NamedTuple):
    """A motion to drive: casadi.Function t (1, 1) → q, qd, qdd (n,), from t = 0 to `duration` [s]."""

    function: ca.Function
    duration: float


class Interface:
    """All structs and routines of a machine.

    Attributes:
        machine: the machine that is modelled.
        kinds: items that array indices enumerate; `units` are those of arrays with other units than their items.
        values: arrays that `prepare` takes, by name; empty ones are left out.
        inputs: symbols of those arrays and of all inputs of routines, by name.
        structs: parameters, inputs and outputs.
        designed_motion: a motion to drive, or None.
        routines: by name.
    """

    def __init__(self, machine: Machine, *, fold_geometry: bool = False, designed_motion: DesignedMotion | None = None,
                 psi: Array | None = None) -> None:
        self.machine, self.designed_motion = machine, designed_motion
        self.chain = KinematicModel(machine)
        self.complete, self.reduced = Model(machine), Model(machine, actuator_inertia=False)
        self.complete.refuse_seals("codegen")
        self.folded = fold_geometry
        known, free, units = self.complete.parameters, self.chain.parameters, machine.channel_units
        factors = [(channel, factor, units[channel], f"{unit}/({units[channel]})") for each, unit in
                   zip(self.complete.force_from_pressure.values(), self.complete.force_units, strict=True)
                   for channel, factor in each.items()]
        self.kinds = {
            "joint": Kind(machine.joints, tuple(units[f"{joint}.q"] for joint in machine.joints)),
            "link": Kind(tuple(link.name for link in machine.links)),
            "actuator": Kind(tuple(a.name for a in machine.actuators)),
            "cylinder": Kind(tuple(c.name for c in machine.cylinders)),
            "reading": Kind(tuple(f[0] for f in factors), tuple(f[2] for f in factors)),
            "geometry": Kind(() if fold_geometry else free.names, free.units), "psi": Kind(known.names, known.units),
            "reduced": Kind(self.reduced.parameters.names, self.reduced.parameters.units),
            "body": Kind(NAMES, tuple(UNITS)),
            "chain": Kind(self.chain.joints, tuple(units[f"{joint}.q"] for joint in self.chain.joints))}
        self.units = {"effort": tuple(f[3] for f in factors)}
        values = {
            "geometry": free.nominal if not fold_geometry else np.zeros(0),
            "psi": known.nominal if psi is None else psi,
            "effort": np.array([f[1] for f in factors]),
            "shortest": np.array([c.dead_length for c in machine.cylinders]),
            "longest": np.array([c.dead_length + c.stroke for c in machine.cylinders])}
        self.values: dict[str, Array] = {name: array for name, array in values.items() if len(array)}
        self.structs: dict[str, Struct] = {}
        self.struct("params", "Parameters: results of calibration and identification, and data of the manufacturer.",
                    Field("geometry", ("geometry",), "SI", "numbers of the geometry"),
                    Field("psi", ("psi",), "SI", "dynamic parameters"),
                    Field("effort", ("reading",), "SI", "actuator force per unit of each reading"),
                    Field("shortest", ("cylinder",), "m", "pin distance of each cylinder when retracted"),
                    Field("longest", ("cylinder",), "m", "pin distance of each cylinder when extended"))
        self.coordinates = coordinates(machine)
        self.inputs = {name: ca.SX.sym(name, len(array)) for name, array in self.values.items()}
        self.inputs |= dict(zip(("q", "qd", "qdd"), self.coordinates, strict=True))
        symbols = {name: self.inputs["geometry"][k] for k, name in enumerate(self.kinds["geometry"].names)}
        self.dynamics = Dynamics(Geometry(machine, symbols), self.coordinates)
        self.routines = {name: make(self) for name, make in ROUTINES.items() if _possible(self, name)}
        if designed_motion is not None:
            self.routines["excitation"] = _excitation(self, designed_motion)

    def size(self, field: Field) -> tuple[int, ...]:
        """Shape of a field in numbers."""
        return tuple(n if isinstance(n, int) else len(self.kinds[n].names) for n in field.shape)

    def chosen(self, names: Sequence[str]) -> dict[str, Routine]:
        """Some routines, in the order of `ROUTINES`; all where none is named.

        Raises:
            ProblemError: there is no such routine, or this machine has no part for it.
        """
        for name in names:
            if name not in self.routines:
                what = "this machine has no part for it" if name in ROUTINES else "there is none"
                raise ProblemError(f"no routine '{name}': {what}", where="--functions",
                                   remedy=f"use {', '.join(self.routines)}")
        return {name: routine for name, routine in self.routines.items() if not names or name in names}

    def struct(self, name: str, text: str, *fields: Field) -> str:
        """Add a struct, without empty members."""
        self.structs[name] = Struct(name, text, tuple(f for f in fields if all(self.size(f))))
        return name

    def symbol(self, name: str, size: int) -> ca.SX:
        """The symbol of an input (size,)."""
        return self.inputs.setdefault(name, ca.SX.sym(name, size))

    @property
    def lengths(self) -> ca.SX | None:
        """Pin distances of the hydraulic cylinders, if there are any."""
        if not self.machine.cylinders:
            return None
        return ca.vertcat(*(self.dynamics.cylinders[c.name].length for c in self.machine.cylinders))

    def guards(self, *, levers: bool = False, gas: bool = False) -> tuple[Guard, ...]:
        """Checks of pin distances, and if asked for of lever arms and gas volumes."""
        found = [Guard(self.dynamics.cylinders[c.name].length, ">", COINCIDENT, "OPEN_TRIANGLE")
                 for c in self.machine.all_cylinders]
        if levers:
            # the row of an actuator is that of the last joint it moves, so that the matrix of lever arms is triangular
            found += [Guard(bar, ">", SHORTEST_LEVER, "DEAD_POINT", absolute=True)
                      for bar in ca.vertsplit(ca.diag(self.dynamics.transmission)) if not bar.is_constant()]
        if gas:
            found += [Guard(each.gas_volume(self.dynamics.cylinders[each.name].length), ">", EMPTY, "NO_GAS_VOLUME")
                      for each in self.machine.gas_cylinders]
        return tuple(found)

    def motion(self) -> str:
        """The struct of a motion."""
        return self.struct("motion", "Motion of the joints.",
                           Field("q", ("joint",), "rad or m", "position of each joint"),
                           Field("qd", ("joint",), "rad/s or m/s", "its speed"),
                           Field("qdd", ("joint",), "rad/s^2 or m/s^2", "its acceleration"))

    def efforts(self) -> str:
        """The struct of actuator forces."""
        return self.struct("efforts", "Forces of the actuators, as measured by their pressures.", Field(
            "force", ("actuator",), "N or N*m", "force of each actuator, a cylinder's positive where it pushes"))


def _possible(interface: Interface, name: str) -> bool:
    machine = interface.machine
    needs = {"cylinder_state": bool(machine.cylinders),
             "joint_state": any(Geometry(machine).triangle(c) for c in machine.cylinders),
             "regressor": len(interface.complete.parameters) > 0,
             "reduced_regressor": len(interface.reduced.parameters) > 0,
             "inverse_dynamics": len(interface.complete.parameters) > 0,
             "gravity_forces": len(interface.complete.parameters) > 0,
             "payload_update": len(interface.complete.parameters) > 0,
             "valve_feedforward": len(machine.circuits) == len(machine.actuators),
             "closure": bool(machine.calibrator or machine.cylinders)}
    return needs.get(name, True)


def _forward_kinematics(api: Interface) -> Routine:
    machine, geometry = api.machine, api.dynamics.geometry
    poses = []
    for link in machine.links:
        pose = api.dynamics.links[link.name].pose @ geometry.far_end(link.name)
        poses.append(ca.vertcat(ca.horzcat(pose.rotation, pose.origin), ca.horzcat(0, 0, 0, 1)))
    last = machine.links[-1].name
    end = api.dynamics.links[last].fixed(geometry.far_end(last))
    turn = end.pose.rotation
    jacobian = ca.jacobian(ca.vertcat(turn @ end.velocity, turn @ end.rotation), api.coordinates.qd)
    gives = api.struct(
        "poses", "Poses of the links.",
        Field("pose", ("link", 4, 4), "1 and m", "homogeneous transform of each link's far end in the base frame"),
        Field("jacobian", (6, "joint"), "m/rad and 1", f"speed x, y, z and rate of rotation x, y, z of the far end of "
              f"{last}, in the base frame, per speed of each joint"))
    return Routine("forward_kinematics", "Poses of all links and the Jacobian of the last one's far end.",
                   api.motion(), ("q",), gives, {"pose": ca.vertcat(*poses), "jacobian": jacobian})


def _cylinder_state(api: Interface) -> Routine:
    motions = [api.dynamics.cylinders[c.name] for c in api.machine.cylinders]
    length, speed = (ca.vertcat(*(getattr(m, key) for m in motions)) for key in ("length", "speed"))
    gives = api.struct(
        "cylinders", "State of the cylinders.",
        Field("length", ("cylinder",), "m", "distance between the pins"),
        Field("speed", ("cylinder",), "m/s", "its rate"),
        Field("lever_arm", ("cylinder", "joint"), "m/rad", "change of the length with each joint"))
    return Routine("cylinder_state", "Lengths, speeds and lever arms of the cylinders from the joints.", api.motion(),
                   ("q", "qd"), gives,
                   {"length": length, "speed": speed, "lever_arm": ca.jacobian(speed, api.coordinates.qd)},
                   api.guards(), api.lengths)


def _joint_state(api: Interface) -> Routine:
    machine, count = api.machine, len(api.machine.cylinders)
    length, speed = api.symbol("length", count), api.symbol("speed", count)
    q, qd = ca.SX(len(machine.joints), 1), ca.SX(len(machine.joints), 1)
    guards, covered = [], []
    for k, cylinder in enumerate(machine.cylinders):
        found, nominal = api.dynamics.geometry.triangle(cylinder), Geometry(machine).triangle(cylinder)
        if found is None or nominal is None:
            continue
        joint, sides = found
        middle = sum(machine.link(joint).joint.range) / 2
        branch = int(np.sign(np.sin(middle + float(nominal[1].offset))))
        angle = triangle_angle(sides, length[k], branch, middle)
        both = sides.fixed * sides.moving
        cosine = (sides.fixed**2 + sides.moving**2 + sides.lateral**2 - length[k]**2) / (2 * both)
        lever = branch * both * ca.sqrt(1 - cosine**2) / length[k]
        guards += [Guard(length[k], ">", COINCIDENT, "OPEN_TRIANGLE"),
                   Guard(cosine, "<=", 1.0, "OPEN_TRIANGLE", absolute=True),
                   Guard(lever, ">", SHORTEST_LEVER, "DEAD_POINT", absolute=True)]
        index = machine.joints.index(joint)
        q[index], qd[index] = angle, speed[k] / lever
        covered.append(joint)
    takes = api.struct("lengths", "Readings of the cylinders' length transducers.",
                       Field("length", ("cylinder",), "m", "distance between the pins"),
                       Field("speed", ("cylinder",), "m/s", "its rate"))
    others = [joint for joint in machine.joints if joint not in covered]
    missing = f"; 0 for {', '.join(others)}, which no single cylinder moves" if others else ""
    gives = api.struct("joints", "State of the joints that one cylinder each moves.",
                       Field("q", ("joint",), "rad", f"angle of each joint{missing}"),
                       Field("qd", ("joint",), "rad/s", "its speed"))
    return Routine("joint_state", "Joint angles and speeds from the cylinders' lengths.", takes, ("length", "speed"),
                   gives, {"q": q, "qd": qd}, tuple(guards), length)


def _actuator_forces(api: Interface) -> Routine:
    channels = api.kinds["reading"].names
    reading = api.symbol("reading", len(channels))
    share = api.inputs["effort"] * reading
    force = ca.vertcat(*(sum((share[channels.index(c)] for c in each), ca.SX(0))
                         for each in api.complete.force_from_pressure.values()))
    names = api.complete.parameters.names
    offsets = [next((api.inputs["psi"][names.index(f"{a}.{kind}")] for kind in ("f_offset", "tau_offset")
                     if f"{a}.{kind}" in names), ca.SX(0)) for a in api.kinds["actuator"].names]
    torque = api.dynamics.transmission.T @ (force - ca.vertcat(*offsets))
    takes = api.struct("readings", "Readings of the actuators' transducers.",
                       Field("q", ("joint",), "rad or m", "position of each joint"),
                       Field("reading", ("reading",), "Pa or N*m", "reading of each transducer"))
    gives = api.struct("loads", "Forces of the actuators and their effect.",
                       Field("force", ("actuator",), "N or N*m", "force of each actuator by its readings, with offset"),
                       Field("torque", ("joint",), "N*m or N", "effect of the forces, without offsets, at each joint"))
    return Routine("actuator_forces", "Forces of the actuators from their pressures, and joint torques.", takes,
                   ("q", "reading"), gives, {"force": force, "torque": torque}, api.guards(), api.lengths)


def _predicted(api: Interface) -> ca.SX:
    return api.dynamics.forces(api.inputs["psi"])


def _inverse_dynamics(api: Interface) -> Routine:
    return Routine("inverse_dynamics", "Measured forces of a motion: bodies, friction and offsets.",
                   api.motion(), ("q", "qd", "qdd"), api.efforts(), {"force": _predicted(api)},
                   api.guards(levers=True, gas=True), api.lengths)


def _gravity_forces(api: Interface) -> Routine:
    offsets = api.complete.parameters.places(ParameterKind.FORCE_OFFSET)
    rates = ca.vertcat(api.coordinates.qd, api.coordinates.qdd)
    static = ca.substitute(_predicted(api), rates, ca.DM.zeros(rates.shape))
    psi = api.inputs["psi"]
    without_offsets = ca.SX(psi)
    without_offsets[offsets] = 0
    return Routine("gravity_forces", "Static forces, gas cylinders included, offsets left out.",
                   api.motion(), ("q",), api.efforts(), {"force": ca.substitute(static, psi, without_offsets)},
                   api.guards(levers=True, gas=True), api.lengths)


def _regressor(api: Interface) -> Routine:
    gives = api.struct("regressor", f"Forces per unit of each dynamic parameter: {_meaning(api)}.", Field(
        "K", ("actuator", "psi"), "N or N*m per unit of psi", "row for each actuator, column for each parameter"))
    return Routine("regressor", "Regressor of the complete model, with barrels and rods.", api.motion(),
                   ("q", "qd", "qdd"), gives, {"K": api.dynamics.regressor(api.inputs["psi"])},
                   api.guards(levers=True, gas=True), api.lengths)


def _reduced_regressor(api: Interface) -> Routine:
    gives = api.struct("reduced_regressor", "Forces per unit of each parameter, barrels and rods left out.", Field(
        "K", ("actuator", "reduced"), "N or N*m per unit of psi", "row for each actuator, column for each parameter"))
    psi = api.inputs["psi"][list(api.complete.parameters.select(api.reduced.parameters.names))]
    return Routine("reduced_regressor", "Regressor of the reduced model, without barrels and rods.", api.motion(),
                   ("q", "qd", "qdd"), gives, {"K": api.dynamics.regressor(psi, actuator_inertia=False)},
                   api.guards(levers=True, gas=True), api.lengths)


def _meaning(api: Interface) -> str:
    return "force = K * psi" if api.complete.linear else "K = d force / d psi, as Stribeck speeds are not linear"


def _closure(api: Interface) -> Routine:
    chain, count = api.chain, len(api.machine.cylinders)
    q, fixture, stroke = api.symbol("chain_q", len(chain.joints)), api.symbol("fixture", 3), api.symbol("stroke", count)
    g = api.inputs.get("geometry", ca.SX(ca.DM(chain.parameters.nominal)))
    by_model, distance = chain.strokes(g, q)
    gap = chain.closure(g, q, fixture) if api.machine.calibrator else ca.SX(0, 1)
    residual = ca.vertcat(gap, by_model - stroke)
    api.kinds["row"] = Kind((*(chain.channels[:3] if api.machine.calibrator else ()),
                             *(f"{cylinder.name}.stroke" for cylinder in api.machine.cylinders)))
    takes = api.struct(
        "chain", "A pose of the machine, with its calibrator if it has one.",
        Field("chain_q", ("chain",), "rad or m", "position of each joint of the chain"),
        *([Field("fixture", (3,), "m", "position of the fixture in the base frame: x, y, z")]
          if api.machine.calibrator else ()),
        Field("stroke", ("cylinder",), "m", "measured stroke of each cylinder, 0 when retracted"))
    reads = ("chain_q", *(("fixture",) if api.machine.calibrator else ()), *(("stroke",) if count else ()))
    gives = api.struct(
        "closure", "Residuals of the closed loops: tip minus fixture, then modelled minus measured stroke.",
        Field("residual", ("row",), "m", "residual of each row"),
        Field("by_q", ("row", "chain"), "m/rad or 1", "its derivative by each joint of the chain"),
        Field("by_geometry", ("row", "geometry"), "m per unit of geometry", "its derivative by each number"))
    outputs = {"residual": residual, "by_q": ca.jacobian(residual, q)}
    if api.kinds["geometry"].names:
        outputs["by_geometry"] = ca.jacobian(residual, g)
    guards = [Guard(value, ">", COINCIDENT, "OPEN_TRIANGLE") for value in ca.vertsplit(distance)] if count else []
    return Routine("closure", "Loop closure with its Jacobians by angles and by geometry.", takes, reads, gives,
                   outputs, tuple(guards), distance if count else None)


def _payload_update(api: Interface) -> Routine:
    last = api.machine.links[-1].name
    rows = api.dynamics.at_actuators(api.dynamics.joint_regressor(last))
    motion = api.structs[api.motion()].fields
    takes = api.struct("load_sample", "A motion with the forces measured in it.", *motion,
                       Field("force", ("actuator",), "N or N*m", "measured force of each actuator"),
                       Field("std", ("actuator",), "N or N*m", "its standard deviation, positive"))
    api.struct("load", f"Estimate of a load on {last}.",
               Field("phi", ("body",), "kg, kg*m, kg*m^2", f"mass, moments and inertia in the frame of {last}"),
               Field("std", ("body",), "kg, kg*m, kg*m^2", "standard deviation of phi"),
               Field("prior", ("body",), "kg, kg*m, kg*m^2", "standard deviation of phi at the start, about zero"),
               Field("forgetting", (), "1", "weight of earlier samples per step: 1 keeps all of them, 0.999 forgets"),
               Field("unit", ("body", "body"), "", "for the routine: the covariance of phi is U D U^T, U unit upper"),
               Field("diagonal", ("body",), "", "for the routine: D"))
    gives = api.struct("load_rows", "Forces without load, and their derivative by the load.",
                       Field("predicted", ("actuator",), "N or N*m", "force of each actuator without load"),
                       Field("rows", ("actuator", "body"), "N or N*m per unit of phi", "force per unit of the load"))
    return Routine("payload_update", "One step of recursive least squares for the load.", takes, ("q", "qd", "qdd"),
                   gives, {"predicted": _predicted(api), "rows": rows}, api.guards(levers=True, gas=True), api.lengths)


def _valve_feedforward(api: Interface) -> Routine:
    plant, count = Plant(api.complete), len(api.machine.actuators)
    rate, p_a, p_b = (api.symbol(name, count) for name in ("force_rate", "pressure_a", "pressure_b"))
    supply, speed = api.symbol("supply", 2), api.dynamics.rates + api.symbol("speed_added", count)
    openings, commands = [], []
    for k, each in enumerate(plant.actuators):
        value = plant.value(each, ca.SX(ca.DM(plant.parameters.nominal)))  # constants in the code
        length = ca.SX(0)
        if isinstance(each.actuator, Cylinder):  # its stroke begins at the calibrated dead length
            dead = api.dynamics.geometry.value[f"{each.actuator.name}.dead_length"]
            length = api.dynamics.cylinders[each.actuator.name].length - dead + each.actuator.dead_length
        wide = valve_inversion.opening(each, speed[k], rate[k], length, ca.vertcat(p_a[k], p_b[k]), supply, value)
        openings.append(ca.fmin(ca.fmax(wide, -1.0), 1.0))
        commands.append(valve_inversion.command(each.valve, openings[-1], value))
    motion = api.structs[api.motion()].fields
    takes = api.struct("demand", "A motion to drive, with the pressures at the valves.", *motion,
                       Field("speed_added", ("actuator",), "m/s or rad/s", "speed added by feedback; 0 without"),
                       Field("force_rate", ("actuator",), "N/s or N*m/s", "demanded rate of each force"),
                       Field("pressure_a", ("actuator",), "Pa", "in the head of a cylinder, at port A of a motor"),
                       Field("pressure_b", ("actuator",), "Pa", "in the rod side of a cylinder, at port B of a motor"),
                       Field("supply", (2,), "Pa", "pressures of supply and tank"))
    gives = api.struct("commands", "Commands to the valves.",
                       Field("force", ("actuator",), "N or N*m", "measured force of each actuator in the motion"),
                       Field("opening", ("actuator",), "1", "opening of each valve, -1 to 1, positive from P to A"),
                       Field("command", ("actuator",), "1, V or A", "command to each valve"))
    return Routine("valve_feedforward", "Forces of a motion, and the valve commands that produce it, with the "
                   "valves of the machine file.", takes,
                   ("q", "qd", "qdd", "speed_added", "force_rate", "pressure_a", "pressure_b", "supply"), gives,
                   {"force": _predicted(api), "opening": ca.vertcat(*openings), "command": ca.vertcat(*commands)},
                   (*api.guards(levers=True, gas=True),
                    Guard(supply[0] - supply[1], ">", valve_inversion.DROP, "NO_SUPPLY")), api.lengths)


def _excitation(api: Interface, designed_motion: DesignedMotion) -> Routine:
    t = api.symbol("t", 1)
    takes = api.struct("instant", "A time of the excitation.",
                       Field("t", (1,), "s", "time since its start; at rest before it and after its end"))
    return Routine("excitation", f"The motion to drive, which takes {designed_motion.duration:g} s.", takes, ("t",),
                   api.motion(), dict(zip(("q", "qd", "qdd"), designed_motion.function(t), strict=True)))


ROUTINES: Mapping[str, Callable[[Interface], Routine]] = {
    "forward_kinematics": _forward_kinematics, "cylinder_state": _cylinder_state, "joint_state": _joint_state,
    "actuator_forces": _actuator_forces, "inverse_dynamics": _inverse_dynamics, "gravity_forces": _gravity_forces,
    "regressor": _regressor, "reduced_regressor": _reduced_regressor, "closure": _closure,
    "payload_update": _payload_update, "valve_feedforward": _valve_feedforward}
