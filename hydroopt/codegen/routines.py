"""The routines of the generated C: inputs, outputs and expressions of each.

Jacobians of residuals are routines of their own, since each takes several times the code of the residual.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import casadi as ca

from hydroopt.codegen import valves
from hydroopt.codegen.inverse_kinematics import inverse_kinematics, no_arm
from hydroopt.codegen.symbols import ABOVE, COINCIDENT, DETERMINED, Field, Guard, Kind, Routine, Symbols
from hydroopt.errors import ProblemError
from hydroopt.machine.geometry import Geometry
from hydroopt.machine.machine import Machine
from hydroopt.machine.parameter_kind import ParameterKind
from hydroopt.model.cylinder_motion import SHORTEST_LEVER
from hydroopt.model.joint_from_length import joint_from_length
from hydroopt.model.joints_from_readings import back
from hydroopt.model.kinematics import gravity_in_base
from hydroopt.model.load_sharing import lever_arms
from hydroopt.spatial.inertia import Array

READS = ("q", "qd", "qdd", "reading", "wrench")
PIVOT = 1e-9
"""Pivot of the mass matrix, relative to its diagonal, below which parameters or a posture give no acceleration."""
TINY = 1e-30
"""Smallest pivot that is divided by: its inverse is a number also in single precision."""
SETTLED = 1e-5
"""Last of Newton's steps [rad or m] from which on no posture counts as having the lengths."""


class DesignedMotion(NamedTuple):
    """A motion to drive: casadi.Function t (1, 1) → q, qd, qdd (n,), from t = 0 to `duration` [s]."""

    function: ca.Function
    duration: float


class Interface(Symbols):
    """All structs and routines of a machine.

    Attributes:
        designed_motion: a motion to drive, or None.
        routines: by name.
        impossible: why this machine has no others, by name.
    """

    def __init__(self, machine: Machine, *, fold_geometry: bool = False, designed_motion: DesignedMotion | None = None,
                 psi: Array | None = None) -> None:
        super().__init__(machine, fold_geometry=fold_geometry, psi=psi)
        self.designed_motion = designed_motion
        self.impossible = {name: reason for name in ROUTINES if (reason := _impossible(self, name))}
        self.routines = {name: make(self) for name, make in ROUTINES.items() if name not in self.impossible}
        if designed_motion is not None:
            self.routines["excitation"] = _excitation(self, designed_motion)

    def chosen(self, names: Sequence[str]) -> dict[str, Routine]:
        """Some routines, in the order of `ROUTINES`; all where none is named.

        Raises:
            ProblemError: there is no such routine, or this machine has none.
        """
        for name in names:
            if name not in self.routines:
                what = self.impossible.get(name, "there is none")
                raise ProblemError(f"no routine '{name}': {what}", where="--functions",
                                   remedy=f"use {', '.join(self.routines)}")
        return {name: routine for name, routine in self.routines.items() if not names or name in names}


def _impossible(api: Symbols, name: str) -> str:
    """Why a machine has no such routine; "" if it has one."""
    machine = api.machine
    match name:
        case "cylinder_state" if not machine.cylinders:
            return "the machine has no hydraulic cylinders"
        case "reduced_regressor" if not len(api.reduced.parameters):
            return "the reduced model has no dynamic parameters"
        case "valve_feedforward" | "valve_refit" | "position_feedback" if len(machine.circuits) < len(machine.powered):
            return "the machine file does not state the valves of all actuators"
        case "closure" if not (machine.calibrator or machine.cylinders):
            return "the machine has neither hydraulic cylinders nor a calibrator"
        case "residual_by_geometry" if not api.kinds["geometry"].names:
            return no_geometry(api)
        case "inverse_kinematics":
            return no_arm(api)
        case "joint_state":
            return no_lengths(api)
        case "forward_kinematics" | "cylinder_state" | "actuator_forces" | "closure" | "wrench_forces":
            return ""
        case _ if not len(api.complete.parameters):
            return "the model has no dynamic parameters"
    return ""


def _forward_kinematics(api: Symbols) -> Routine:
    machine, geometry = api.machine, api.dynamics.geometry
    poses = []
    for link in machine.links:
        pose = api.dynamics.links[link.name].pose @ geometry.far_end(link.name)
        poses.append(ca.vertcat(ca.horzcat(pose.rotation, pose.origin), ca.horzcat(0, 0, 0, 1)))
    gives = api.struct(
        "poses", "Poses of the links.",
        Field("pose", ("link", 4, 4), "1 and m", "homogeneous transform of each link's far end in the base frame"),
        Field("jacobian", (6, "joint"), "m/rad and 1", f"speed x, y, z and rate of rotation x, y, z of the far end of "
              f"{machine.tip}, in the base frame, per speed of each joint"))
    return Routine("forward_kinematics", "Poses of all links and the Jacobian of the last one's far end.",
                   api.motion(), ("q",), gives, {"pose": ca.vertcat(*poses), "jacobian": api.dynamics.tip_jacobian},
                   (*api.turns(api.coordinates.q, machine.joints), *api.straight(api.dynamics.tree.sines)))


def _cylinder_state(api: Symbols) -> Routine:
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


def _actuator_forces(api: Symbols) -> Routine:
    force, names = api.read, api.complete.parameters.names
    offsets = [next((api.inputs["psi"][names.index(f"{a}.{kind}")] for kind in ("f_offset", "tau_offset")
                     if f"{a}.{kind}" in names), ca.SX(0)) for a in api.kinds["actuator"].names]
    read = [each in api.machine.measured_actuators for each in api.machine.actuators]
    acting = ca.vertcat(*(each - offset if known else ca.SX(0) for each, offset, known in
                          zip(ca.vertsplit(force), offsets, read, strict=True)))
    outputs = {"force": force, "torque": api.dynamics.transmission.T @ acting}
    takes = api.struct("readings", "Readings of the actuators' transducers.",
                       api.structs[api.motion()].fields[0], reading_member())
    unread = ", ".join(each.name for each, known in zip(api.machine.actuators, read, strict=True) if not known)
    members = (Field("force", ("actuator",), "N or N*m", "force of each actuator by its readings, with offset"
                     + (f"; 0 for {unread}, which no balance contains" if unread else "")),
               Field("torque", ("joint",), "N*m or N", "effect of the forces, without offsets, at each joint"))
    if api.row == "actuator":
        gives = api.struct("loads", "Forces of the actuators and their effect.", *members)
        return Routine("actuator_forces", "Forces of the actuators from their pressures, and joint torques.", takes,
                       ("q", "reading"), gives, outputs, (*api.pressures("reading"), *api.guards()), api.lengths)
    gives = api.struct("loads", "Forces of the actuators and their effect.", *members,
                       api.per_row("balance", "measured force of each {row}, with offsets"))
    return Routine("actuator_forces", "Forces of the actuators from their pressures, their effect at the joints, and "
                   "what the balances measure.", takes, ("q", "reading"), gives, outputs | {"balance": api.measured},
                   (*api.pressures("reading"), *api.guards(levers=not api.dynamics.work.sparsity().is_diag())),
                   api.lengths)


def _inverse_dynamics(api: Symbols) -> Routine:
    text, guards = "Measured forces of a motion: bodies, friction and offsets.", api.guards(levers=True, gas=True)
    if api.row == "actuator":
        return Routine("inverse_dynamics", text, api.motion(), ("q", "qd", "qdd"), api.efforts(),
                       {"force": api.predicted}, guards, api.lengths)
    gives = api.struct("motion_efforts", "Forces that a motion demands.", api.force, Field(
        "actuator_force", ("actuator",), "N or N*m", "force of each actuator, measured or not; those of a joint share "
        "its load with the least sum of (force/capacity)^2, and passive joints carry themselves"))
    shared = lever_arms(api.machine, api.dynamics.transmission)
    return Routine("inverse_dynamics", text, api.motion(), ("q", "qd", "qdd"), gives,
                   {"force": api.predicted, "actuator_force": api.dynamics.actuator_forces(api.inputs["psi"])},
                   (*guards, *api.arms(shared)), api.lengths)


def _gravity_forces(api: Symbols) -> Routine:
    offsets = api.complete.parameters.places(ParameterKind.FORCE_OFFSET)
    rates = ca.vertcat(api.coordinates.qd, api.coordinates.qdd)
    static = ca.substitute(api.predicted, rates, ca.DM.zeros(rates.shape))
    psi = api.inputs["psi"]
    without_offsets = ca.SX(psi)
    without_offsets[offsets] = 0
    return Routine("gravity_forces", "Static forces, gas cylinders and springs included, offsets left out.",
                   api.motion(), ("q",), api.efforts(), {"force": ca.substitute(static, psi, without_offsets)},
                   api.guards(levers=True, gas=True), api.lengths)


def _regressor(api: Symbols) -> Routine:
    gives = api.struct("regressor", f"Forces per unit of each dynamic parameter: {_meaning(api)}.", api.per_row(
        "K", "row for each {row}, column for each parameter", "psi", unit="N or N*m per unit of psi"))
    return Routine("regressor", "Regressor of the complete model, with barrels and rods.", api.motion(),
                   ("q", "qd", "qdd"), gives, {"K": api.dynamics.regressor(api.inputs["psi"])},
                   api.guards(levers=True, gas=True), api.lengths)


def _reduced_regressor(api: Symbols) -> Routine:
    text = "Forces per unit of each parameter, barrels and rods left out."
    gives = api.struct("reduced_regressor", text, api.per_row(
        "K", "row for each {row}, column for each parameter", "reduced", unit="N or N*m per unit of psi"))
    psi = api.inputs["psi"][list(api.complete.parameters.select(api.reduced.parameters.names))]
    return Routine("reduced_regressor", "Regressor of the reduced model, without barrels and rods.", api.motion(),
                   ("q", "qd", "qdd"), gives, {"K": api.dynamics.without_actuator_inertia().regressor(psi)},
                   api.guards(levers=True, gas=True), api.lengths)


def _meaning(api: Symbols) -> str:
    return "force = K * psi" if api.complete.linear else "K = d force / d psi, as Stribeck speeds are not linear"


def _excitation(api: Symbols, designed_motion: DesignedMotion) -> Routine:
    t = api.symbol("t", 1)
    takes = api.struct("instant", "A time of the excitation.",
                       Field("t", (1,), "s", "time since its start; at rest before it and after its end"))
    return Routine("excitation", f"The motion to drive, which takes {designed_motion.duration:g} s.", takes, ("t",),
                   api.motion(), dict(zip(("q", "qd", "qdd"), designed_motion.function(t), strict=True)))


def no_geometry(api: Symbols) -> str:
    """Why there is no derivative by the geometry; "" if there is one."""
    if api.kinds["geometry"].names:
        return ""
    if api.folded:
        return "the geometry is part of the code, generate it without --fold-geometry"
    return "no number of the geometry has a sigma in the machine file"


def _measurement(api: Symbols) -> str:
    return api.struct("measurement", "A motion with the readings taken in it.",
                      *api.structs[api.motion()].fields, reading_member(), wrench_member(api))


def reading_member() -> Field:
    """The member with readings of transducers."""
    return Field("reading", ("reading",), "Pa or N*m", f"reading of each transducer; pressures {ABOVE}")


def wrench_member(api: Symbols) -> Field:
    """The member with a wrench at the tip."""
    return Field("wrench", (6,), "N, N*m", "force x, y, z and moment x, y, z that the surroundings exert on the "
                 f"machine at the far end of {api.machine.tip}, in the base frame; 0 without contact")


def _residual_forces(api: Symbols) -> ca.SX:
    measured, wrench = api.measured, api.symbol("wrench", 6)
    return measured - api.predicted - api.dynamics.wrench_forces(wrench)


def _of_measurement(api: Symbols, name: str, text: str, gives: str, outputs: Mapping[str, ca.SX]) -> Routine:
    # a routine reads only what its result depends on: readings enter no derivative, a wrench not that by parameters
    reads = tuple(key for key in READS if ca.depends_on(ca.veccat(*outputs.values()), api.inputs[key])
                  or key in ("q", "qd", "qdd"))
    guards = (*api.pressures(*({"reading"} & set(reads))), *api.guards(levers=True, gas=True))
    return Routine(name, text, _measurement(api), reads, gives, outputs, guards, api.lengths)


def residual(api: Symbols) -> Routine:
    """Measured minus predicted forces."""
    gives = api.struct("residual", f"Residuals of the {api.row}s' forces.",
                       api.per_row("residual", "measured minus predicted force of each {row}"))
    by_reading = "its `effort`" if api.row == "actuator" else "its `effort` times its actuator's share in the balance"
    return _of_measurement(api, "residual", "Measured forces minus those of the motion and of the wrench at the tip. "
                           f"The derivative by each reading is {by_reading}.", gives,
                           {"residual": _residual_forces(api)})


def residual_by_motion(api: Symbols) -> Routine:
    """Its derivatives by positions, speeds and accelerations."""
    gives = api.struct("residual_by_motion", "Derivatives of `residual` by the motion.", *_by_motion(api))
    return _of_measurement(api, "residual_by_motion", "Derivatives of `residual` by the motion; jumps of dry friction "
                           "count as zero.", gives, _derivatives(api, _residual_forces(api)))


def _by_motion(api: Symbols) -> list[Field]:
    """Members with derivatives of forces by positions, speeds and accelerations of the joints."""
    return [api.per_row(key, f"derivative by the {of} of each joint", "joint", unit=unit) for key, of, unit in (
        ("by_q", "position", "N/rad, N, N/m or N*m/rad"), ("by_qd", "speed", "per rad/s or m/s"),
        ("by_qdd", "acceleration", "per rad/s^2 or m/s^2"))]


def _derivatives(api: Symbols, forces: ca.SX) -> dict[str, ca.SX]:
    return {f"by_{name}": ca.jacobian(forces, api.inputs[name]) for name in ("q", "qd", "qdd")}


def residual_by_parameters(api: Symbols) -> Routine:
    """Its derivative by the dynamic parameters."""
    gives = api.struct("residual_by_parameters", "Derivative of `residual` by the dynamic parameters.", api.per_row(
        "by_psi", "derivative by each dynamic parameter", "psi", unit="N or N*m per unit of psi"))
    return _of_measurement(api, "residual_by_parameters", "Derivative of `residual` by the dynamic parameters.", gives,
                           {"by_psi": -api.dynamics.regressor(api.inputs["psi"])})


def residual_by_geometry(api: Symbols) -> Routine:
    """Its derivative by the numbers of the geometry."""
    gives = api.struct("residual_by_geometry", "Derivative of `residual` by the geometry.", api.per_row(
        "by_geometry", "derivative by each number", "geometry", unit="N or N*m per unit of geometry"))
    return _of_measurement(api, "residual_by_geometry", "Derivative of `residual` by the numbers of the geometry.",
                           gives, {"by_geometry": ca.jacobian(_residual_forces(api), api.inputs["geometry"])})


def closure(api: Symbols) -> Routine:
    """Loop closure with its derivatives."""
    chain, count = api.chain, len(api.machine.cylinders)
    q, fixture, stroke = api.symbol("chain_q", len(chain.joints)), api.symbol("fixture", 3), api.symbol("stroke", count)
    g = api.inputs.get("geometry", ca.SX(ca.DM(chain.parameters.nominal)))
    by_model, distance = chain.strokes(g, q)
    gap = chain.closure(g, q, fixture) if api.machine.calibrator else ca.SX(0, 1)
    rows = ca.vertcat(gap, by_model - stroke)
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
    outputs = {"residual": rows, "by_q": ca.jacobian(rows, q)}
    missing = no_geometry(api)
    if not missing:
        outputs["by_geometry"] = ca.jacobian(rows, g)
    guards = [*api.turns(q, chain.joints), *api.straight(chain.loop_sines(g, q))]
    guards += [Guard(value, ">", COINCIDENT, "OPEN_TRIANGLE") for value in ca.vertsplit(distance)] if count else []
    held = [one.name for one in api.machine.fixtures if one.kind != "ball"]
    lost = {"by_geometry": missing} if missing else {}
    if held:
        lost["orientation"] = (f"fixtures {', '.join(held)} are no balls, and this routine compares the tip's position "
                               "with the fixture's only")
    return Routine("closure", "Loop closure with its Jacobians by angles and by geometry. Dynamic parameters do not "
                   "enter it." if not missing else "Loop closure with its Jacobian by angles. Dynamic parameters do "
                   "not enter it.", takes, reads, gives, outputs, tuple(guards), distance if count else None,
                   lost)


def wrench_forces(api: Symbols) -> Routine:
    """What a wrench at the tip adds to the forces of a motion."""
    wrench = api.symbol("wrench", 6)
    takes = api.struct("contact", "A wrench at the tip.",
                       api.structs[api.motion()].fields[0], wrench_member(api))
    return Routine("wrench_forces", "What a wrench at the tip adds to the forces of `inverse_dynamics`, by virtual "
                   "work.", takes, ("q", "wrench"), api.efforts(),
                   {"force": api.dynamics.wrench_forces(wrench)}, api.guards(levers=True), api.lengths)


def tip_wrench(api: Symbols) -> Routine:
    """The wrench that explains measured forces."""
    wrench, determined = api.dynamics.tip_wrench(api.dynamics.at_joints(api.measured - api.predicted))
    api.symbol("wrench", 6)
    unknown, rank = api.dynamics.wrench_rank
    meaning = ("force x, y, z and moment x, y, z" if unknown == 6 else "force x, y, z, and zero for the moment"
               if rank == 3 else "force x, y, z within the motions of the tip, zero across them and for the moment")
    gives = api.struct("tip_wrench", "The wrench that the surroundings exert on the machine.", Field(
        "wrench", (6,), "N, N*m", f"{meaning}, at the far end of {api.machine.tip}, in the base frame"))
    return Routine("tip_wrench", "The wrench at the tip that explains the measured forces of a motion.",
                   _measurement(api), ("q", "qd", "qdd", "reading"), gives, {"wrench": wrench},
                   (*api.pressures("reading"), *api.guards(levers=True, gas=True),
                    Guard(determined, ">", DETERMINED, "SINGULAR")), api.lengths)


def mass_matrix(api: Symbols) -> Routine:
    """Mass matrix and gravity."""
    psi = api.inputs["psi"]
    gives = api.struct("inertia", "Inertia and gravity of the bodies at the joints.",
                       Field("mass_matrix", ("joint", "joint"), "kg*m^2, kg*m or kg", "torque per acceleration"),
                       Field("gravity", ("joint",), "N*m or N", "torque that holds the bodies at each joint"))
    return Routine("mass_matrix", "Mass matrix and gravity of all bodies and rotors, at the joints.", api.motion(),
                   ("q",), gives, {"mass_matrix": api.dynamics.mass_matrix(psi),
                                   "gravity": api.dynamics.gravity_torques(psi)}, api.guards(), api.lengths)


def force_parts(api: Symbols) -> Routine:
    """The forces of a motion by their causes."""
    parameters, psi = api.complete.parameters, api.inputs["psi"]
    at_rest = ca.vertcat(api.coordinates.qd, api.coordinates.qdd)

    def of(chosen: list[int]) -> ca.SX:
        kept = ca.SX.zeros(len(parameters))
        kept[chosen] = psi[chosen]
        return api.dynamics.forces(kept)

    friction = [k for k, kind in enumerate(parameters.kinds) if kind.is_friction]
    elastic = [k for k, kind in enumerate(parameters.kinds) if kind.is_elastic]
    offsets = list(parameters.places(ParameterKind.FORCE_OFFSET))
    bodies = sorted(set(range(len(parameters))) - {*friction, *elastic, *offsets})
    moving = of(bodies)
    gravity = ca.substitute(moving, at_rest, ca.DM.zeros(at_rest.shape))
    meant = {"gravity": "that holds the bodies", "inertia": "that accelerates bodies and rotors",
             "friction": "against friction", "elastic": "against gas cylinders and springs",
             "offset": "that transducers read without load"}
    gives = api.struct("force_parts", "Forces of a motion by their causes.", *(
        api.per_row(key, f"part of the force of each {{row}} {text}") for key, text in meant.items()))
    return Routine("force_parts", "Forces of a motion by their causes; their sum is that of `inverse_dynamics`.",
                   api.motion(), ("q", "qd", "qdd"), gives,
                   {"gravity": gravity, "inertia": moving - gravity, "friction": of(friction), "elastic": of(elastic),
                    "offset": of(offsets)}, api.guards(levers=True, gas=True), api.lengths)


def forward_dynamics(api: Symbols) -> Routine:
    """Accelerations under forces of the actuators."""
    machine, psi = api.machine, api.inputs["psi"]
    force, wrench = api.symbol("actuator_force", len(machine.actuators)), api.symbol("wrench", 6)
    free = [k for k, joint in enumerate(machine.joints) if joint not in machine.base_joints]
    total, own = api.dynamics.efforts(psi)
    mass = ca.densify(ca.jacobian(total, api.coordinates.qdd))[free, free]
    rest = ca.substitute(total, api.coordinates.qdd, ca.DM.zeros(api.coordinates.qdd.shape))
    load = (api.dynamics.transmission.T @ (force - own) + api.dynamics.tip_jacobian.T @ wrench - rest)[free]
    found = ca.SX.zeros(len(machine.joints))
    found[free], pivots = _solved(mass, load)
    takes = api.struct("loaded_state", "State of the joints, and the forces that act.",
                       *api.structs[api.motion()].fields[:2],
                       Field("actuator_force", ("actuator",), "N or N*m", "force of each actuator with the offset of "
                             "its transducers, a cylinder's positive where it pushes"), wrench_member(api))
    gives = api.struct("accelerations", "Accelerations of the joints.", Field(
        "qdd", ("joint",), "rad/s^2 or m/s^2", "acceleration of each joint" + ("; 0 for those of the base, which is "
                                                                               "not free" if machine.base_joints
                                                                               else "")))
    singular = [Guard(pivots[k] - PIVOT * mass[k, k], ">", 0.0, "SINGULAR") for k in range(len(free))]
    return Routine("forward_dynamics", "Accelerations that forces of the actuators and a wrench at the tip give; dry "
                   "friction acts against the speed, and is zero at rest.", takes,
                   ("q", "qd", "actuator_force", "wrench"), gives, {"qdd": found},
                   (*api.guards(gas=True), *singular), api.lengths)


def _solved(mass: ca.SX, load: ca.SX) -> tuple[ca.SX, list[ca.SX]]:
    """Solution of mass·x = load by M = L·D·Lᵀ, and the pivots D, which no quotient takes where they vanish."""
    n = load.numel()
    lower, x = ca.SX.eye(n), ca.SX(load)
    pivots: list[ca.SX] = []
    divided: list[ca.SX] = []
    for j in range(n):
        pivots.append(mass[j, j] - sum((lower[j, k] ** 2 * pivots[k] for k in range(j)), ca.SX(0)))
        divided.append(1 / ca.fmax(pivots[j], TINY))
        for i in range(j + 1, n):
            lower[i, j] = divided[j] * (mass[i, j] - sum((lower[i, k] * lower[j, k] * pivots[k] for k in range(j)),
                                                         ca.SX(0)))
    for j in range(n):
        x[j] -= sum((lower[j, k] * x[k] for k in range(j)), ca.SX(0))
    for j in reversed(range(n)):
        x[j] = divided[j] * x[j] - sum((lower[i, j] * x[i] for i in range(j + 1, n)), ca.SX(0))
    return x, pivots


def _tilted_motion(api: Symbols) -> str:
    return api.struct("tilted_motion", "A motion of a machine on a slope, with what it carries.",
                      *api.structs[api.motion()].fields,
                      Field("gravity", (3,), "m/s^2", "gravity x, y, z in the base frame"),
                      Field("loaded_psi", ("psi",), "SI", "dynamic parameters with those of a load"))


def tilted_regressor(api: Symbols) -> Routine:
    """The regressor under another gravity, and the forces' derivative by gravity."""
    machine, dynamics, psi = api.machine, api.dynamics, api.symbol("loaded_psi", len(api.complete.parameters))
    gravity = api.symbol("gravity", 3)

    def heavy(acceleration: ca.SX) -> ca.SX:
        return dynamics.at_balances(dynamics.gravity_torques(psi, acceleration))

    K = dynamics.regressor(psi) + ca.jacobian(heavy(gravity - gravity_in_base(machine)), psi)
    of_joint = ca.SX.eye(len(machine.joints))
    lever = [dynamics.transmission[machine.actuators.index(balance.alone), :] if balance.alone is not None
             else of_joint[joint, :] for balance, joint in zip(machine.balances, dynamics.kept, strict=True)]
    gives = api.struct("tilted_regressor", "Forces on a slope.",
                       api.per_row("K", "row for each {row}, column for each parameter", "psi",
                                   unit="N or N*m per unit of psi"),
                       api.per_row("by_gravity", "derivative of the force of each {row} by gravity x, y, z", 3,
                                   unit="N or N*m per m/s^2"),
                       api.per_row("lever", "change of each {row}'s length or angle with each joint; of a joint that "
                                   "several move, its own", "joint", unit="m/rad or 1"))
    return Routine("tilted_regressor", "Regressor under a gravity, and the derivative of the forces by gravity with "
                   "`loaded_psi`.", _tilted_motion(api), ("q", "qd", "qdd", "gravity", "loaded_psi"), gives,
                   {"K": K, "by_gravity": ca.jacobian(heavy(gravity), gravity), "lever": ca.vertcat(*lever)},
                   api.guards(levers=True, gas=True), api.lengths)


def force_by_motion(api: Symbols) -> Routine:
    """Derivatives of the forces by positions, speeds and accelerations."""
    gives = api.struct("force_by_motion", "Derivatives of predicted forces by the motion.", *_by_motion(api))
    forces = api.dynamics.forces(api.symbol("loaded_psi", len(api.complete.parameters)))
    return Routine("force_by_motion", "Derivatives of predicted forces by the motion, with `loaded_psi` on the machine "
                   "file's slope; jumps of dry friction count as zero.", _tilted_motion(api),
                   ("q", "qd", "qdd", "loaded_psi"), gives,
                   _derivatives(api, forces), api.guards(levers=True, gas=True), api.lengths)


def no_lengths(api: Symbols) -> str:
    """Why a machine's lengths determine no joint; "" if they determine one."""
    by_triangle = any(joint_from_length(Geometry(api.machine), c) for c in api.machine.cylinders)
    found = by_triangle or api.slides or api.together
    return "" if found else "no hydraulic cylinder of the machine moves a single joint"


def joint_state(api: Symbols) -> Routine:
    """Positions and speeds of the joints that the cylinders' lengths tell."""
    machine, count = api.machine, len(api.machine.cylinders)
    length, speed = api.symbol("length", count), api.symbol("speed", count)
    q, qd = ca.SX(len(machine.joints), 1), ca.SX(len(machine.joints), 1)
    guards: list[Guard] = []
    covered: list[str] = []
    grouped = {machine.joints[k] for group in api.together for k in group.joints}
    for k, cylinder in enumerate(machine.cylinders):
        found = joint_from_length(api.dynamics.geometry, cylinder)
        if found is None or found.joint in {*covered, *grouped}:
            continue
        sides, turn = found.sides, ca.SX.sym("turn")
        angle = found.angle(length[k])
        # through a linkage the joint turns faster or slower than the one of the triangle
        ratio = ca.substitute(ca.jacobian(found.driven(turn), turn), turn, found.turn(length[k]))
        both = sides.fixed * sides.moving
        cosine = (sides.fixed**2 + sides.moving**2 + sides.lateral**2 - length[k]**2) / (2 * both)
        lever = found.branch * both * ca.sqrt(1 - cosine**2) / length[k]
        guards += [Guard(length[k], ">", COINCIDENT, "OPEN_TRIANGLE"),
                   Guard(cosine, "<=", 1.0, "OPEN_TRIANGLE", absolute=True),
                   Guard(lever, ">", SHORTEST_LEVER, "DEAD_POINT", absolute=True),
                   *api.straight(found.sines(found.turn(length[k])))]
        index = machine.joints.index(found.joint)
        q[index], qd[index] = angle, speed[k] / lever * ratio
        covered.append(found.joint)
    for slide in api.slides:
        at, under = slide.solved(api.dynamics.geometry, length[slide.cylinder])
        lever = slide.sign * ca.sqrt(under) / length[slide.cylinder]
        guards += [Guard(length[slide.cylinder], ">", COINCIDENT, "OPEN_TRIANGLE"),
                   Guard(under, ">=", 0.0, "OPEN_TRIANGLE"),
                   Guard(lever, ">", SHORTEST_LEVER, "DEAD_POINT", absolute=True)]
        q[slide.joint], qd[slide.joint] = at, speed[slide.cylinder] / lever
        covered.append(machine.joints[slide.joint])
    for group in api.together:
        own, read = list(group.joints), list(group.cylinders)
        at, step, arms = group.solved(api.dynamics, q, length[read])
        guards += [Guard(length[k], ">", COINCIDENT, "OPEN_TRIANGLE") for k in read]
        guards += [Guard(each, "<", SETTLED, "OPEN_TRIANGLE", absolute=True) for each in ca.vertsplit(step)]
        guards += [Guard(bar, ">", SHORTEST_LEVER, "DEAD_POINT") for bar in _bars(arms[:, own])]
        q[own], qd[own] = at, back(arms[:, own], speed[read] - arms[:, list(group.given)] @ qd[list(group.given), 0])
        covered += [machine.joints[k] for k in own]
    takes = api.struct("lengths", "Readings of the cylinders' length transducers.",
                       Field("length", ("cylinder",), "m", "distance between the pins"),
                       Field("speed", ("cylinder",), "m/s", "its rate"))
    others = [joint for joint in machine.joints if joint not in covered]
    missing = f"; 0 for {', '.join(others)}, which no single cylinder moves" if others else ""
    if api.slides or api.together:
        gives = api.struct("joints", "State of the joints that cylinders move.",
                           Field("q", ("joint",), "rad or m", f"position of each joint{missing}"),
                           Field("qd", ("joint",), "rad/s or m/s", "its speed"))
        text = "Joint positions and speeds from the cylinders' lengths."
    else:
        gives = api.struct("joints", "State of the joints that one cylinder each moves.",
                           Field("q", ("joint",), "rad", f"angle of each joint{missing}"),
                           Field("qd", ("joint",), "rad/s", "its speed"))
        text = "Joint angles and speeds from the cylinders' lengths."
    return Routine("joint_state", text, takes, ("length", "speed"), gives, {"q": q, "qd": qd}, tuple(guards), length)


def _bars(arms: ca.SX) -> list[ca.SX]:
    """Lever arms [m or 1] of cylinders at each of the joints that they move together, while those before follow: all
    above zero where the lengths tell the joints."""
    gram, found = ca.densify(arms.T @ arms), []
    while gram.size1():
        found.append(ca.sqrt(gram[0, 0]))
        gram = gram[1:, 1:] - gram[1:, 0] @ gram[0, 1:] / gram[0, 0]
    return found


ROUTINES: Mapping[str, Callable[[Symbols], Routine]] = {
    "forward_kinematics": _forward_kinematics, "inverse_kinematics": inverse_kinematics, "cylinder_state":
    _cylinder_state, "joint_state": joint_state, "actuator_forces": _actuator_forces, "inverse_dynamics":
    _inverse_dynamics, "gravity_forces": _gravity_forces, "regressor": _regressor, "reduced_regressor":
    _reduced_regressor, "mass_matrix": mass_matrix, "force_parts": force_parts,
    "forward_dynamics": forward_dynamics, "wrench_forces": wrench_forces,
    "tip_wrench": tip_wrench, "residual": residual, "residual_by_motion":
    residual_by_motion, "residual_by_parameters": residual_by_parameters,
    "residual_by_geometry": residual_by_geometry, "closure": closure,
    "tilted_regressor": tilted_regressor, "force_by_motion": force_by_motion, "valve_feedforward":
    valves.valve_feedforward, "valve_refit": valves.valve_refit, "position_feedback": valves.position_feedback}
