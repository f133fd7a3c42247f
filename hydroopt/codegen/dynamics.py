"""Routines of forces and accelerations: mass matrix, parts of the inverse dynamics, forward dynamics."""

from __future__ import annotations

import casadi as ca

from hydroopt.codegen.residuals import wrench_member
from hydroopt.codegen.symbols import Field, Guard, Routine, Symbols
from hydroopt.machine.parameter_kind import ParameterKind

PIVOT = 1e-9
"""Pivot of the mass matrix, relative to its diagonal, below which parameters or a posture give no acceleration."""
TINY = 1e-30
"""Smallest pivot that is divided by: its inverse is a number also in single precision."""


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
                       Field("q", ("joint",), "rad or m", "position of each joint"),
                       Field("qd", ("joint",), "rad/s or m/s", "its speed"),
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
