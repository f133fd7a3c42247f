"""Routines for calibration on the controller: residuals of forces and of closed loops, each with its Jacobians.

A residual's Jacobians are routines of their own, since each takes several times the code of the residual.
"""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from hydroopt.codegen.symbols import ABOVE, COINCIDENT, DETERMINED, Field, Guard, Kind, Routine, Symbols

READS = ("q", "qd", "qdd", "reading", "wrench")


def no_geometry(api: Symbols) -> str:
    """Why there is no derivative by the geometry; "" if there is one."""
    if api.kinds["geometry"].names:
        return ""
    if api.folded:
        return "the geometry is part of the code, generate it without --fold-geometry"
    return "no number of the geometry has a sigma in the machine file"


def _measurement(api: Symbols) -> str:
    return api.struct("measurement", "A motion with the readings taken in it.",
                      Field("q", ("joint",), "rad or m", "position of each joint"),
                      Field("qd", ("joint",), "rad/s or m/s", "its speed"),
                      Field("qdd", ("joint",), "rad/s^2 or m/s^2", "its acceleration"),
                      reading_member(), wrench_member(api))


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
    units = {"by_q": "N/rad, N, N/m or N*m/rad", "by_qd": "per rad/s or m/s", "by_qdd": "per rad/s^2 or m/s^2"}
    meant = {"by_q": "position", "by_qd": "speed", "by_qdd": "acceleration"}
    gives = api.struct("residual_by_motion", "Derivatives of `residual` by the motion.", *(
        api.per_row(key, f"derivative by the {meant[key]} of each joint", "joint", unit=unit)
        for key, unit in units.items()))
    forces = _residual_forces(api)
    return _of_measurement(api, "residual_by_motion", "Derivatives of `residual` by the motion; jumps of dry friction "
                           "count as zero.", gives,
                           {key: ca.jacobian(forces, x) for key, x in zip(units, api.coordinates, strict=True)})


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
                       Field("q", ("joint",), "rad or m", "position of each joint"), wrench_member(api))
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
