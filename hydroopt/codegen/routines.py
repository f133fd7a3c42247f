"""The routines of the generated C: inputs, outputs and expressions of each."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import casadi as ca

from hydroopt.codegen import dynamics, residuals, tilted, valves
from hydroopt.codegen.inverse_kinematics import inverse_kinematics, no_arm
from hydroopt.codegen.joint_state import joint_state, no_lengths
from hydroopt.codegen.symbols import Field, Routine, Symbols
from hydroopt.errors import ProblemError
from hydroopt.machine.machine import Machine
from hydroopt.machine.parameter_kind import ParameterKind
from hydroopt.model.load_sharing import lever_arms
from hydroopt.spatial.inertia import Array


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
            return residuals.no_geometry(api)
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
                       Field("q", ("joint",), "rad or m", "position of each joint"),
                       residuals.reading_member())
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
                   ("q", "qd", "qdd"), gives, {"K": api.dynamics.regressor(psi, actuator_inertia=False)},
                   api.guards(levers=True, gas=True), api.lengths)


def _meaning(api: Symbols) -> str:
    return "force = K * psi" if api.complete.linear else "K = d force / d psi, as Stribeck speeds are not linear"




def _excitation(api: Symbols, designed_motion: DesignedMotion) -> Routine:
    t = api.symbol("t", 1)
    takes = api.struct("instant", "A time of the excitation.",
                       Field("t", (1,), "s", "time since its start; at rest before it and after its end"))
    return Routine("excitation", f"The motion to drive, which takes {designed_motion.duration:g} s.", takes, ("t",),
                   api.motion(), dict(zip(("q", "qd", "qdd"), designed_motion.function(t), strict=True)))


ROUTINES: Mapping[str, Callable[[Symbols], Routine]] = {
    "forward_kinematics": _forward_kinematics, "inverse_kinematics": inverse_kinematics, "cylinder_state":
    _cylinder_state, "joint_state": joint_state, "actuator_forces": _actuator_forces, "inverse_dynamics":
    _inverse_dynamics, "gravity_forces": _gravity_forces, "regressor": _regressor, "reduced_regressor":
    _reduced_regressor, "mass_matrix": dynamics.mass_matrix, "force_parts": dynamics.force_parts,
    "forward_dynamics": dynamics.forward_dynamics, "wrench_forces": residuals.wrench_forces,
    "tip_wrench": residuals.tip_wrench, "residual": residuals.residual, "residual_by_motion":
    residuals.residual_by_motion, "residual_by_parameters": residuals.residual_by_parameters,
    "residual_by_geometry": residuals.residual_by_geometry, "closure": residuals.closure,
    "tilted_regressor": tilted.tilted_regressor, "force_by_motion": tilted.force_by_motion, "valve_feedforward":
    valves.valve_feedforward, "valve_refit": valves.valve_refit, "position_feedback": valves.position_feedback}
