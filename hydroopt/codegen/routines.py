"""What the controller can call: each routine's inputs, outputs and expressions, from a machine's symbols."""

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

SHORTEST = 1e-3
"""Pin distance [m] below which pins count as coinciding."""
SMALLEST = 1e-9
"""Volume [m³] below which a gas counts as gone."""
SHORTEST_LEVER = 1e-4
"""Lever arm [m] below which a cylinder counts as standing at its dead point."""


class Kind(NamedTuple):
    """What an index counts: the things' names in order, with units if they are numbers."""

    names: tuple[str, ...]
    units: tuple[str, ...] = ()


class Field(NamedTuple):
    """A member of a struct: its shape in kinds of things or in numbers, its unit and meaning."""

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
    """A value that a routine does not go on without: it, or its size, must be in a `relation` to a limit."""

    value: ca.SX
    relation: str
    limit: float
    status: str
    absolute: bool = False


class Routine(NamedTuple):
    """A function of the interface: which members of a struct it reads, which struct it fills, and how.

    `lengths` are the pin distances of the hydraulic cylinders where it has to do with them, to be held against their
    strokes.
    """

    name: str
    text: str
    takes: str
    reads: tuple[str, ...]
    gives: str
    outputs: Mapping[str, ca.SX]
    guards: tuple[Guard, ...] = ()
    lengths: ca.SX | None = None


class Course(NamedTuple):
    """A motion to drive: casadi.Function t (1, 1) → q, qd, qdd (n,), from t = 0 to `duration` [s]."""

    function: ca.Function
    duration: float


class Interface:
    """All structs and routines of a machine.

    Attributes:
        machine: what is modelled.
        kinds: what indices count; `units` are those of arrays whose units are not those of what they count.
        values: what `prepare` takes, by the name of the array; empty ones are left out.
        inputs: symbols of those arrays and of everything that routines read, by name.
        structs: parameters, inputs and outputs.
        course: a motion to drive, if there is one.
        routines: by name.
    """

    def __init__(self, machine: Machine, *, fold_geometry: bool = False, course: Course | None = None,
                 psi: Array | None = None) -> None:
        self.machine, self.course = machine, course
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
        self.struct("params", "What calibration and identification estimate, and what the maker states.",
                    Field("geometry", ("geometry",), "SI", "numbers of the geometry"),
                    Field("psi", ("psi",), "SI", "dynamic parameters"),
                    Field("effort", ("reading",), "SI", "actuator force per unit of each reading"),
                    Field("shortest", ("cylinder",), "m", "pin distance of each cylinder when retracted"),
                    Field("longest", ("cylinder",), "m", "pin distance of each cylinder when extended"))
        self.at = coordinates(machine)
        self.inputs = {name: ca.SX.sym(name, len(array)) for name, array in self.values.items()}
        self.inputs |= dict(zip(("q", "qd", "qdd"), self.at, strict=True))
        symbols = {name: self.inputs["geometry"][k] for k, name in enumerate(self.kinds["geometry"].names)}
        self.dynamics = Dynamics(Geometry(machine, symbols), self.at)
        self.routines = {name: make(self) for name, make in ROUTINES.items() if _possible(self, name)}
        if course is not None:
            self.routines["excitation"] = _excitation(self, course)

    def size(self, field: Field) -> tuple[int, ...]:
        """Shape of a field in numbers."""
        return tuple(n if isinstance(n, int) else len(self.kinds[n].names) for n in field.shape)

    def chosen(self, names: Sequence[str]) -> dict[str, Routine]:
        """Some routines, in the order of `ROUTINES`; all where none is named.

        Raises:
            ProblemError: there is no such routine, or this machine has no use for it.
        """
        for name in names:
            if name not in self.routines:
                what = "this machine has no part that it could compute" if name in ROUTINES else "there is none"
                raise ProblemError(f"no routine '{name}': {what}", where="--functions",
                                   remedy=f"use {', '.join(self.routines)}")
        return {name: routine for name, routine in self.routines.items() if not names or name in names}

    def struct(self, name: str, text: str, *fields: Field) -> str:
        """Enter a struct, without members that would be empty."""
        self.structs[name] = Struct(name, text, tuple(f for f in fields if all(self.size(f))))
        return name

    def symbol(self, name: str, size: int) -> ca.SX:
        """The symbol of something that is read."""
        return self.inputs.setdefault(name, ca.SX.sym(name, size))

    @property
    def lengths(self) -> ca.SX | None:
        """Pin distances of the hydraulic cylinders, if there are any."""
        if not self.machine.cylinders:
            return None
        return ca.vertcat(*(self.dynamics.cylinders[c.name].length for c in self.machine.cylinders))

    def guards(self, *, levers: bool = False, gas: bool = False) -> tuple[Guard, ...]:
        """Pins apart; lever arms longer than nothing; gas with a volume."""
        found = [Guard(self.dynamics.cylinders[c.name].length, ">", SHORTEST, "OPEN_TRIANGLE")
                 for c in self.machine.all_cylinders]
        if levers:
            # an actuator stands in the row of the last joint it moves, so that the lever arms are triangular
            found += [Guard(bar, ">", SHORTEST_LEVER, "DEAD_POINT", absolute=True)
                      for bar in ca.vertsplit(ca.diag(self.dynamics.transmission)) if not bar.is_constant()]
        if gas:
            found += [Guard(each.gas_volume(self.dynamics.cylinders[each.name].length), ">", SMALLEST, "NO_GAS_VOLUME")
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
        return self.struct("efforts", "Forces of the actuators, as their pressures show them.", Field(
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


def _forward_kinematics(own: Interface) -> Routine:
    machine, geometry = own.machine, own.dynamics.geometry
    poses = []
    for link in machine.links:
        pose = own.dynamics.links[link.name].pose @ geometry.far_end(link.name)
        poses.append(ca.vertcat(ca.horzcat(pose.rotation, pose.origin), ca.horzcat(0, 0, 0, 1)))
    last = machine.links[-1].name
    end = own.dynamics.links[last].fixed(geometry.far_end(last))
    turn = end.pose.rotation
    jacobian = ca.jacobian(ca.vertcat(turn @ end.velocity, turn @ end.rotation), own.at.qd)
    gives = own.struct(
        "poses", "Where the links are.",
        Field("pose", ("link", 4, 4), "1 and m", "homogeneous transform of each link's far end, seen from the base"),
        Field("jacobian", (6, "joint"), "m/rad and 1", f"speed x, y, z and rate of rotation x, y, z of the far end of "
              f"{last}, in the base frame, per speed of each joint"))
    return Routine("forward_kinematics", "Poses of all links and the Jacobian of the last one's far end.",
                   own.motion(), ("q",), gives, {"pose": ca.vertcat(*poses), "jacobian": jacobian})


def _cylinder_state(own: Interface) -> Routine:
    motions = [own.dynamics.cylinders[c.name] for c in own.machine.cylinders]
    length, speed = (ca.vertcat(*(getattr(m, key) for m in motions)) for key in ("length", "speed"))
    gives = own.struct(
        "cylinders", "State of the cylinders.",
        Field("length", ("cylinder",), "m", "distance between the pins"),
        Field("speed", ("cylinder",), "m/s", "its rate"),
        Field("lever_arm", ("cylinder", "joint"), "m/rad", "change of the length with each joint"))
    return Routine("cylinder_state", "Lengths, speeds and lever arms of the cylinders from the joints.", own.motion(),
                   ("q", "qd"), gives, {"length": length, "speed": speed, "lever_arm": ca.jacobian(speed, own.at.qd)},
                   own.guards(), own.lengths)


def _joint_state(own: Interface) -> Routine:
    machine, count = own.machine, len(own.machine.cylinders)
    length, speed = own.symbol("length", count), own.symbol("speed", count)
    q, qd = ca.SX(len(machine.joints), 1), ca.SX(len(machine.joints), 1)
    guards, covered = [], []
    for k, cylinder in enumerate(machine.cylinders):
        found, nominal = own.dynamics.geometry.triangle(cylinder), Geometry(machine).triangle(cylinder)
        if found is None or nominal is None:
            continue
        joint, sides = found
        middle = sum(machine.link(joint).joint.range) / 2
        branch = int(np.sign(np.sin(middle + float(nominal[1].offset))))
        angle = triangle_angle(sides, length[k], branch, middle)
        both = sides.fixed * sides.moving
        cosine = (sides.fixed**2 + sides.moving**2 + sides.lateral**2 - length[k]**2) / (2 * both)
        lever = branch * both * ca.sqrt(1 - cosine**2) / length[k]
        guards += [Guard(length[k], ">", SHORTEST, "OPEN_TRIANGLE"),
                   Guard(cosine, "<=", 1.0, "OPEN_TRIANGLE", absolute=True),
                   Guard(lever, ">", SHORTEST_LEVER, "DEAD_POINT", absolute=True)]
        index = machine.joints.index(joint)
        q[index], qd[index] = angle, speed[k] / lever
        covered.append(joint)
    takes = own.struct("lengths", "What the cylinders' transducers show.",
                       Field("length", ("cylinder",), "m", "distance between the pins"),
                       Field("speed", ("cylinder",), "m/s", "its rate"))
    rest = [joint for joint in machine.joints if joint not in covered]
    missing = f"; 0 for {', '.join(rest)}, which no cylinder tells" if rest else ""
    gives = own.struct("joints", "State of the joints that one cylinder each moves.",
                       Field("q", ("joint",), "rad", f"angle of each joint{missing}"),
                       Field("qd", ("joint",), "rad/s", "its speed"))
    return Routine("joint_state", "Joint angles and speeds from the cylinders' lengths.", takes, ("length", "speed"),
                   gives, {"q": q, "qd": qd}, tuple(guards), length)


def _actuator_forces(own: Interface) -> Routine:
    channels = own.kinds["reading"].names
    reading = own.symbol("reading", len(channels))
    share = own.inputs["effort"] * reading
    force = ca.vertcat(*(sum((share[channels.index(c)] for c in each), ca.SX(0))
                         for each in own.complete.force_from_pressure.values()))
    names = own.complete.parameters.names
    offsets = [next((own.inputs["psi"][names.index(f"{a}.{kind}")] for kind in ("f_offset", "tau_offset")
                     if f"{a}.{kind}" in names), ca.SX(0)) for a in own.kinds["actuator"].names]
    torque = own.dynamics.transmission.T @ (force - ca.vertcat(*offsets))
    takes = own.struct("readings", "What the transducers of the actuators show.",
                       Field("q", ("joint",), "rad or m", "position of each joint"),
                       Field("reading", ("reading",), "Pa or N*m", "of each transducer"))
    gives = own.struct("loads", "What the actuators do.",
                       Field("force", ("actuator",), "N or N*m", "force of each actuator as its readings show it"),
                       Field("torque", ("joint",), "N*m or N", "what the forces less their offsets do at each joint"))
    return Routine("actuator_forces", "Forces of the actuators from their pressures, and the torques they make.", takes,
                   ("q", "reading"), gives, {"force": force, "torque": torque}, own.guards(), own.lengths)


def _predicted(own: Interface) -> ca.SX:
    return own.dynamics.forces(own.inputs["psi"])


def _inverse_dynamics(own: Interface) -> Routine:
    return Routine("inverse_dynamics", "Forces that the actuators show in a motion: bodies, friction and offsets.",
                   own.motion(), ("q", "qd", "qdd"), own.efforts(), {"force": _predicted(own)},
                   own.guards(levers=True, gas=True), own.lengths)


def _gravity_forces(own: Interface) -> Routine:
    offsets = own.complete.parameters.places(ParameterKind.FORCE_OFFSET)
    still = ca.substitute(_predicted(own), ca.vertcat(own.at.qd, own.at.qdd), ca.DM.zeros(2 * len(own.machine.joints)))
    psi = own.inputs["psi"]
    kept = ca.SX(psi)
    kept[offsets] = 0
    return Routine("gravity_forces", "Forces that hold the machine still, gas cylinders included, offsets left out.",
                   own.motion(), ("q",), own.efforts(), {"force": ca.substitute(still, psi, kept)},
                   own.guards(levers=True, gas=True), own.lengths)


def _regressor(own: Interface) -> Routine:
    gives = own.struct("regressor", f"Forces per unit of each dynamic parameter: {_meaning(own)}.", Field(
        "K", ("actuator", "psi"), "N or N*m per unit of psi", "row for each actuator, column for each parameter"))
    return Routine("regressor", "Regressor of the complete model, with barrels and rods.", own.motion(),
                   ("q", "qd", "qdd"), gives, {"K": own.dynamics.regressor(own.inputs["psi"])},
                   own.guards(levers=True, gas=True), own.lengths)


def _reduced_regressor(own: Interface) -> Routine:
    gives = own.struct("reduced_regressor", "Forces per unit of each parameter, barrels and rods left out.", Field(
        "K", ("actuator", "reduced"), "N or N*m per unit of psi", "row for each actuator, column for each parameter"))
    psi = own.inputs["psi"][list(own.complete.parameters.select(own.reduced.parameters.names))]
    return Routine("reduced_regressor", "Regressor of the reduced model, without barrels and rods.", own.motion(),
                   ("q", "qd", "qdd"), gives, {"K": own.dynamics.regressor(psi, actuator_inertia=False)},
                   own.guards(levers=True, gas=True), own.lengths)


def _meaning(own: Interface) -> str:
    return "force = K * psi" if own.complete.linear else "K = d force / d psi, as Stribeck speeds are not linear"


def _closure(own: Interface) -> Routine:
    chain, count = own.chain, len(own.machine.cylinders)
    q, fixture, stroke = own.symbol("chain_q", len(chain.joints)), own.symbol("fixture", 3), own.symbol("stroke", count)
    g = own.inputs.get("geometry", ca.SX(ca.DM(chain.parameters.nominal)))
    by_model, distance = chain.strokes(g, q)
    gap = chain.closure(g, q, fixture) if own.machine.calibrator else ca.SX(0, 1)
    residual = ca.vertcat(gap, by_model - stroke)
    own.kinds["row"] = Kind((*(chain.channels[:3] if own.machine.calibrator else ()),
                             *(f"{cylinder.name}.stroke" for cylinder in own.machine.cylinders)))
    takes = own.struct(
        "chain", "A pose of the machine, with its calibrator if it has one.",
        Field("chain_q", ("chain",), "rad or m", "position of each joint of the chain"),
        *([Field("fixture", (3,), "m", "where the ball is held, in the base frame: x, y, z")]
          if own.machine.calibrator else ()),
        Field("stroke", ("cylinder",), "m", "measured stroke of each cylinder, 0 when retracted"))
    reads = ("chain_q", *(("fixture",) if own.machine.calibrator else ()), *(("stroke",) if count else ()))
    gives = own.struct(
        "closure", "Residuals of the closed loops: tip less fixture, then stroke by the model less stroke measured.",
        Field("residual", ("row",), "m", "of each row"),
        Field("by_q", ("row", "chain"), "m/rad or 1", "its change with each joint of the chain"),
        Field("by_geometry", ("row", "geometry"), "m per unit of geometry", "its change with each number"))
    outputs = {"residual": residual, "by_q": ca.jacobian(residual, q)}
    if own.kinds["geometry"].names:
        outputs["by_geometry"] = ca.jacobian(residual, g)
    guards = [Guard(value, ">", SHORTEST, "OPEN_TRIANGLE") for value in ca.vertsplit(distance)] if count else []
    return Routine("closure", "Loop closure with its Jacobians by angles and by geometry.", takes, reads, gives,
                   outputs, tuple(guards), distance if count else None)


def _payload_update(own: Interface) -> Routine:
    last = own.machine.links[-1].name
    rows = own.dynamics.at_actuators(own.dynamics.joint_regressor(last))
    motion = own.structs[own.motion()].fields
    takes = own.struct("load_sample", "A motion with the forces measured in it.", *motion,
                       Field("force", ("actuator",), "N or N*m", "measured force of each actuator"),
                       Field("std", ("actuator",), "N or N*m", "its standard deviation, positive"))
    own.struct("load", f"A load on {last}: what is known of it so far.",
               Field("phi", ("body",), "kg, kg*m, kg*m^2", f"mass, moments and inertia in the frame of {last}"),
               Field("std", ("body",), "kg, kg*m, kg*m^2", "standard deviation of phi"),
               Field("prior", ("body",), "kg, kg*m, kg*m^2", "standard deviation of phi at the start, about zero"),
               Field("forgetting", (), "1", "weight of the past at each step: 1 keeps all of it, 0.999 forgets"),
               Field("unit", ("body", "body"), "", "for the routine: the covariance of phi is U D U^T, U unit upper"),
               Field("diagonal", ("body",), "", "for the routine: D"))
    gives = own.struct("load_rows", "Forces without load, and what a load adds to them.",
                       Field("predicted", ("actuator",), "N or N*m", "force of each actuator without load"),
                       Field("rows", ("actuator", "body"), "N or N*m per unit of phi", "force per unit of the load"))
    return Routine("payload_update", "One step of recursive least squares for the load.", takes, ("q", "qd", "qdd"),
                   gives, {"predicted": _predicted(own), "rows": rows}, own.guards(levers=True, gas=True), own.lengths)


def _valve_feedforward(own: Interface) -> Routine:
    plant, count = Plant(own.complete), len(own.machine.actuators)
    rate, p_a, p_b = (own.symbol(name, count) for name in ("force_rate", "pressure_a", "pressure_b"))
    supply, speed = own.symbol("supply", 2), own.dynamics.rates + own.symbol("speed_added", count)
    openings, commands = [], []
    for k, each in enumerate(plant.actuators):
        value = plant.value(each, ca.SX(ca.DM(plant.parameters.nominal)))  # built in
        length = ca.SX(0)
        if isinstance(each.actuator, Cylinder):  # whose stroke begins where calibration finds it
            dead = own.dynamics.geometry.value[f"{each.actuator.name}.dead_length"]
            length = own.dynamics.cylinders[each.actuator.name].length - dead + each.actuator.dead_length
        wide = valve_inversion.opening(each, speed[k], rate[k], length, ca.vertcat(p_a[k], p_b[k]), supply, value)
        openings.append(ca.fmin(ca.fmax(wide, -1.0), 1.0))
        commands.append(valve_inversion.command(each.valve, openings[-1], value))
    motion = own.structs[own.motion()].fields
    takes = own.struct("demand", "A motion to drive, with the pressures that the valves meet.", *motion,
                       Field("speed_added", ("actuator",), "m/s or rad/s", "speed that a feedback adds; 0 without"),
                       Field("force_rate", ("actuator",), "N/s or N*m/s", "how fast each force is to change"),
                       Field("pressure_a", ("actuator",), "Pa", "in the head of a cylinder, at port A of a motor"),
                       Field("pressure_b", ("actuator",), "Pa", "in the rod side of a cylinder, at port B of a motor"),
                       Field("supply", (2,), "Pa", "pressures of supply and tank"))
    gives = own.struct("commands", "What the valves are to do.",
                       Field("force", ("actuator",), "N or N*m", "force that each actuator shows in the motion"),
                       Field("opening", ("actuator",), "1", "of each valve, -1 to 1, positive from P to A"),
                       Field("command", ("actuator",), "1, V or A", "to each valve"))
    return Routine("valve_feedforward", "Forces of a motion, and commands at which the valves, as the machine file "
                   "states them, bring it about.", takes,
                   ("q", "qd", "qdd", "speed_added", "force_rate", "pressure_a", "pressure_b", "supply"), gives,
                   {"force": _predicted(own), "opening": ca.vertcat(*openings), "command": ca.vertcat(*commands)},
                   (*own.guards(levers=True, gas=True),
                    Guard(supply[0] - supply[1], ">", valve_inversion.DROP, "NO_SUPPLY")), own.lengths)


def _excitation(own: Interface, course: Course) -> Routine:
    t = own.symbol("t", 1)
    takes = own.struct("instant", "A moment of the excitation.",
                       Field("t", (1,), "s", "time since it began; it rests before that and after its end"))
    return Routine("excitation", f"The motion to drive, which takes {course.duration:g} s.", takes, ("t",),
                   own.motion(), dict(zip(("q", "qd", "qdd"), course.function(t), strict=True)))


ROUTINES: Mapping[str, Callable[[Interface], Routine]] = {
    "forward_kinematics": _forward_kinematics, "cylinder_state": _cylinder_state, "joint_state": _joint_state,
    "actuator_forces": _actuator_forces, "inverse_dynamics": _inverse_dynamics, "gravity_forces": _gravity_forces,
    "regressor": _regressor, "reduced_regressor": _reduced_regressor, "closure": _closure,
    "payload_update": _payload_update, "valve_feedforward": _valve_feedforward}
