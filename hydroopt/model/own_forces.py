"""Forces of an actuator's own: its friction, and force terms that a user states, as expressions of its motion."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import casadi as ca

from hydroopt.errors import ProblemError
from hydroopt.machine.actuators import Actuator, Cylinder
from hydroopt.parameters.force_terms import ForceTerm
from hydroopt.parameters.parameter_set import ParameterSet


@dataclass(frozen=True)
class MotionSymbols:
    """What a force term may depend on, in SI.

    Attributes:
        q, qd, qdd: positions, velocities and accelerations of the joints that move by themselves, by name.
        position, speed: length of the cylinder or position of the joint that the actuator drives, and its derivative.
        pressure: sum of the pressures in both chambers of the cylinder [Pa].
    """

    q: Mapping[str, ca.SX]
    qd: Mapping[str, ca.SX]
    qdd: Mapping[str, ca.SX]
    position: ca.SX
    speed: ca.SX
    pressure: ca.SX


@dataclass(frozen=True, eq=False)
class OwnForce:
    """A term as an expression.

    Attributes:
        actuator: its place among the actuators.
        names: of its parameters.
        symbols: of its coefficients (c,).
        force: [N or N·m].
        slope: (1, c) derivatives by the coefficients.
        linear: whether the force is ``slope · coefficients`` with a slope that does not depend on these.
        pressed: whether it depends on the pressure.
    """

    actuator: int
    names: tuple[str, ...]
    symbols: ca.SX
    force: ca.SX
    slope: ca.SX
    linear: bool
    pressed: bool

    def at(self, parameters: ParameterSet, psi: ca.SX | ca.DM) -> tuple[ca.SX, dict[str, ca.SX]]:
        """The force with the parameters ψ (p,), and its derivative by each parameter."""
        values = ca.SX(psi[[parameters.index(name) for name in self.names]])
        force, slope = ca.substitute([self.force, self.slope], [self.symbols], [values])
        return force, dict(zip(self.names, ca.horzsplit(slope), strict=True))


def own_force(term: ForceTerm, actuator: int, motion: MotionSymbols) -> OwnForce:
    """A term in the symbols of a model.

    Raises:
        ProblemError: its function fails, returns no number, or depends on other symbols; or the force does not depend
            on a coefficient.
    """
    symbols = ca.SX.sym("own", len(term.coefficients))
    try:
        force = ca.SX(term.expression(motion, dict(zip(term.coefficients, ca.vertsplit(symbols), strict=True))))
    except ProblemError:
        raise
    except Exception as error:
        raise ProblemError(f"its function failed ({error})".replace("\n", " "), where=term.where,
                           remedy="compute one number from the motion and the coefficients with CasADi") from error
    if not force.is_scalar():
        raise ProblemError(f"its function returns {force.shape[0]} by {force.shape[1]} numbers", where=term.where,
                           remedy="return one number [N or N*m]")
    force = ca.densify(force)
    if unused := [name for name, symbol in zip(term.coefficients, ca.vertsplit(symbols), strict=True)
                  if not ca.depends_on(force, symbol)]:
        raise ProblemError(f"the force does not depend on {', '.join(unused)}", where=term.where,
                           remedy="use all coefficients, or leave these out")
    known = ca.vertcat(symbols, motion.pressure, *_inputs(motion))
    if strange := [str(symbol) for symbol in ca.symvar(force) if not ca.depends_on(known, symbol)]:
        raise ProblemError(f"the force depends on {', '.join(strange[:5])}", where=term.where,
                           remedy="use the motion and the coefficients that the function is given")
    slope = ca.jacobian(force, symbols)
    linear = not ca.depends_on(slope, symbols) and ca.substitute(force, symbols, ca.SX.zeros(*symbols.shape)).is_zero()
    return OwnForce(actuator, tuple(term.addresses), symbols, force, slope, linear,
                    ca.depends_on(force, motion.pressure))


def _inputs(motion: MotionSymbols) -> Sequence[ca.SX]:
    return [*motion.q.values(), *motion.qd.values(), *motion.qdd.values()]


def sign_of(speed: ca.SX, dead_zone: float | None) -> ca.SX:
    """Sign of a speed, zero within the dead zone [m/s or rad/s]; smooth if CasADi's `sign` is replaced by a smooth
    function."""
    if dead_zone is None:
        return ca.sign(speed)
    return (ca.sign(speed - dead_zone) + ca.sign(speed + dead_zone)) / 2


def friction_terms(actuator: Actuator, speed: ca.SX, pressure: ca.SX,
                   value: Callable[[str], ca.SX | float]) -> dict[str, ca.SX]:
    """Derivatives of an actuator's friction force by its parameters, by the name of the parameter.

    Coulomb and viscous friction, each with a value of its own for the negative direction if that is stated;
    Stribeck's, sign(v)·f_stribeck·exp(−(v/v_stribeck)²) (Armstrong-Hélouvry, Dupont, Canudas de Wit 1994); that of the
    seals, sign(v)·f_seal·(p_head + p_rod) (Bonchis, Corke, Rye 1999). All but v_stribeck enter linearly.

    Args:
        actuator: whose friction.
        speed: of it [m/s or rad/s].
        pressure: sum of the pressures in both chambers [Pa].
        value: gives the values of the parameters f_stribeck and v_stribeck, at which derivatives are taken.
    """
    stated, name = actuator.friction, actuator.name
    kind = f"{name}.{actuator.effort_symbol}"
    sign = sign_of(speed, stated.dead_zone)
    terms = {f"{kind}_offset": ca.SX(1), f"{kind}_coulomb": sign, f"{kind}_viscous": speed}
    if stated.coulomb_reverse is not None:
        terms |= {f"{kind}_coulomb": (sign + sign**2) / 2, f"{kind}_coulomb_reverse": (sign - sign**2) / 2}
    if stated.viscous_reverse is not None:
        size = ca.fabs(speed)
        terms |= {f"{kind}_viscous": (speed + size) / 2, f"{kind}_viscous_reverse": (speed - size) / 2}
    if stated.stribeck is not None:
        force, scale = value(f"{kind}_stribeck"), value(f"{name}.v_stribeck")
        part = (speed / scale) ** 2
        fading = sign * ca.exp(-part)
        terms |= {f"{kind}_stribeck": fading, f"{name}.v_stribeck": 2 * force * fading * part / scale}
    if isinstance(actuator, Cylinder) and actuator.friction.seal is not None:
        terms[f"{kind}_seal"] = sign * pressure
    return terms
