"""Friction of an actuator as a function of its speed and its pressures: one expression for each parameter."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca

from hydroopt.machine.actuators import Actuator, Cylinder


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
