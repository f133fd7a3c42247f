"""Routines for machines on a slope that carry a load: forces by gravity, by parameters and by the motion."""

from __future__ import annotations

import casadi as ca

from hydroopt.codegen.symbols import Field, Routine, Symbols
from hydroopt.model.kinematics import gravity_in_base


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
    units = {"by_q": "N/rad, N, N/m or N*m/rad", "by_qd": "per rad/s or m/s", "by_qdd": "per rad/s^2 or m/s^2"}
    meant = {"by_q": "position", "by_qd": "speed", "by_qdd": "acceleration"}
    gives = api.struct("force_by_motion", "Derivatives of predicted forces by the motion.", *(
        api.per_row(key, f"derivative by the {meant[key]} of each joint", "joint", unit=unit)
        for key, unit in units.items()))
    forces = api.dynamics.forces(api.symbol("loaded_psi", len(api.complete.parameters)))
    return Routine("force_by_motion", "Derivatives of predicted forces by the motion, with `loaded_psi` on the machine "
                   "file's slope; jumps of dry friction count as zero.", _tilted_motion(api),
                   ("q", "qd", "qdd", "loaded_psi"), gives,
                   {key: ca.jacobian(forces, x) for key, x in zip(units, api.coordinates, strict=True)},
                   api.guards(levers=True, gas=True), api.lengths)
