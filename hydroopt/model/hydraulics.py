"""Valves, chambers and the pump: flows and pressures as expressions, all in SI, pressures above ambient.

Merritt 1967 and Jelali and Kroll 2003 give orifice, chamber and valve; corners of
their equations are rounded over a width with a physical reason, so that every expression has derivatives.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from hydroopt.machine.actuators import Cylinder, Motor
from hydroopt.machine.machine import Machine
from hydroopt.machine.valves import Circuit, Oil, Valve
from hydroopt.spatial.inertia import Array

AMBIENT = 101325.0
"""Absolute pressure [Pa] above which all others are counted."""
VACUUM = 1e3
"""Absolute pressure [Pa] below which oil cavitates; the law of its free air ends there."""
CUT_OFF = 0.03
"""Part of the set pressure over which a pump goes from full flow to zero."""
CORNER = 0.1
"""Part of that over which the corners are rounded."""
RELIEF_OVERPRESSURE = 5e5
"""Overpressure [Pa] at which a relief valve passes the rated flow of the actuator's valve."""
CHECK_VALVE_SUCTION = 5e4
"""Pressure below the tank's [Pa] at which an anticavitation check valve passes that flow; at most one atmosphere."""
RELIEF_ROUNDING = 0.02
"""Part of these pressures over which the opening of such a valve is rounded."""

Value = Callable[[str], ca.SX | float]
"""Function from the key of a number in the machine file, such as `dead_band`, to its value or symbol."""


def chamber_flows(actuator: Cylinder | Motor, speed: Any) -> tuple[Any, Any]:
    """Flows [m³/s] that chambers a and b take at a speed [m/s or rad/s]: numbers, arrays or symbols."""
    a, b = actuator.areas
    return a * speed, -b * speed


def demanded_flow(machine: Machine, speed: Array) -> Array:
    """Flow (N,) [m³/s] that the actuators demand of the pump at their speeds (N, a) [m/s or rad/s].

    Example:
        >>> from hydroopt.machine.machine_file import load_machine
        >>> machine = load_machine("cat215b")
        >>> (6e4 * demanded_flow(machine, np.array([[0.0, 0.1, 0.0]]))).round(1)
        array([123.1])
    """
    hydraulic = [(k, each) for k, each in enumerate(machine.actuators) if isinstance(each, Cylinder | Motor)]
    return np.asarray(sum(np.maximum(*chamber_flows(each, speed[:, k])) for k, each in hydraulic))


def hinge(x: ca.SX, width: ca.SX | float) -> ca.SX:
    """max(x, 0), rounded within `width`: half of x + √(x² + width²)."""
    return (x + ca.sqrt(x**2 + width**2)) / 2


def orifice(conductance: ca.SX, upstream: ca.SX, downstream: ca.SX, laminar_drop: float) -> ca.SX:
    """Flow [m³/s] through a sharp edge: K·√Δp, but laminar below `laminar_drop` [Pa].

    K·Δp/(Δp² + Δp_lam²)^¼ is smooth and odd in Δp; at |Δp| = 3·Δp_lam it differs from K·√Δp by 2.6 % (similar to
    Ellman and Piché 1999; the transition itself: Merritt 1967).
    """
    drop = upstream - downstream
    return conductance * drop / ca.sqrt(ca.sqrt(drop**2 + laminar_drop**2))


def spool_position(valve: Valve, command: ca.SX, value: Value) -> ca.SX:
    """Position of the spool, −1 to 1 (positive towards P→A), that a command demands, dead bands included.

    It saturates at full opening.
    """
    span = valve.span
    position = ca.fmax(-1.0, ca.fmin(1.0, (command - valve.neutral) / span))
    forward = value("dead_band") / abs(span)
    reverse = forward if valve.dead_band_reverse is None else value("dead_band_reverse") / abs(span)
    width = valve.rounding
    return hinge(position - forward, width) / (1 - forward) - hinge(-position - reverse, width) / (1 - reverse)


class Openings(NamedTuple):
    """How far each edge is open, 0 to 1."""

    pa: ca.SX
    at: ca.SX
    pb: ca.SX
    bt: ca.SX


def openings(valve: Valve, spool: ca.SX, value: Value) -> Openings:
    """Openings of the edges at a place of the spool, −1 to 1."""
    overlap = value("overlap")
    forward, reverse = (hinge(side - overlap, valve.rounding) / (1 - overlap) for side in (spool, -spool))
    return Openings(pa=forward, at=reverse, pb=reverse, bt=forward)


def conductance(valve: Valve, edge: str, value: Value) -> ca.SX:
    """Flow through a fully open edge per root of pressure [m³/(s·√Pa)], by its key (`flow_pa`)."""
    return value("rated_flow" if getattr(valve, edge) is None else edge) / valve.rated_drop**0.5


def compressibility(oil: Oil, pressure: ca.SX, value: Value, air: str = "oil.air") -> ca.SX:
    """Reciprocal of the bulk modulus [1/Pa] of oil with free air, whose part is that key, at a pressure above ambient.

    The air, compressed by p·Vⁿ = const, is a part of the volume at that pressure (Gholizadeh, Burton, Schoenau 2011).
    Oil carries no tension:
    at vacuum cavities form, which close again when the pressure returns.
    """
    absolute = hinge(pressure + AMBIENT - VACUUM, VACUUM) + VACUUM
    part = value(air)
    gas = part / (1 - part) * (AMBIENT / absolute) ** (1 / oil.polytropic)
    cavities = (1 - ca.tanh((pressure + AMBIENT) / VACUUM - 1)) / (2 * VACUUM)
    return (1 / value("oil.bulk_modulus") + gas / (oil.polytropic * absolute)) / (1 + gas) + cavities


class Flows(NamedTuple):
    """Flows [m³/s] of one actuator: into its chambers, out of the supply."""

    into_a: ca.SX
    into_b: ca.SX
    supply: ca.SX


class ActuatorHydraulics:
    """One actuator's valve and chambers.

    Chamber a is a cylinder's head side or a motor's side a. `areas` are what its piston displaces per metre, or a
    motor per radian of its joint [m², m³/rad].
    """

    def __init__(self, actuator: Cylinder | Motor, circuit: Circuit, oil: Oil) -> None:
        self.actuator, self.circuit, self.oil, self.valve = actuator, circuit, oil, circuit.valve
        self.areas = actuator.areas
        self.dead_length: float | ca.SX = actuator.dead_length if isinstance(actuator, Cylinder) else 0.0
        """Length [m] at which a cylinder's stroke begins; a symbol where code reads it from its parameters."""
        self.spool_states = 2 if self.valve.natural_frequency is not None else 0
        """Number of states of the spool: 0 or 2."""

    @property
    def chambers(self) -> tuple[str, str]:
        """Names of the states and log channels of both chambers' pressures."""
        return self.actuator.chambers

    def volumes(self, length: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Volumes [m³] of both chambers without hoses, at a cylinder's length; a motor's are part of its hoses."""
        if isinstance(self.actuator, Motor):
            return ca.SX(0.0), ca.SX(0.0)
        stroke = length - self.dead_length
        return self.areas[0] * stroke, self.areas[1] * (self.actuator.stroke - stroke)

    def spool_rates(self, spool: ca.SX, spool_rate: ca.SX, commanded: ca.SX, value: Value) -> tuple[ca.SX, ca.SX]:
        """Rates of the spool's place and speed: a system of second order (Jelali and Kroll 2003)."""
        omega = 2 * ca.pi * value("natural_frequency")
        return spool_rate, omega**2 * (commanded - spool) - 2 * value("damping") * omega * spool_rate

    def flows(self, spool: ca.SX, p_a: ca.SX, p_b: ca.SX, supply: ca.SX, value: Value) -> Flows:
        """Flows through the valve, the leaks, and the relief and check valves at the ports.

        Args:
            spool: its place, −1 to 1.
            p_a: pressure in chamber a [Pa].
            p_b: pressure in chamber b [Pa].
            supply: pressures (2,) of supply and tank [Pa].
            value: gives the numbers of the machine file.
        """
        valve, circuit = self.valve, self.circuit
        pump, tank = supply[0], supply[1]
        opening = openings(valve, spool, value)

        def through(edge: str, share: ca.SX, upstream: ca.SX, downstream: ca.SX) -> ca.SX:
            return orifice(conductance(valve, edge, value) * share, upstream, downstream, valve.laminar_drop)

        pa, at = through("flow_pa", opening.pa, pump, p_a), through("flow_at", opening.at, p_a, tank)
        pb, bt = through("flow_pb", opening.pb, pump, p_b), through("flow_bt", opening.bt, p_b, tank)
        into = {"a": pa - at, "b": pb - bt}
        if circuit.leakage is not None:
            across = value("leakage") * (p_a - p_b)
            into = {"a": into["a"] - across, "b": into["b"] + across}
        for port, pressure in (("a", p_a), ("b", p_b)):
            if getattr(circuit, f"leakage_{port}") is not None:
                into[port] -= value(f"leakage_{port}") * (pressure - tank)
            full = conductance(valve, f"flow_p{port}", value) * valve.rated_drop**0.5
            if self.actuator.relief_pressure is not None:
                excess = pressure - self.actuator.relief_pressure
                into[port] -= full * hinge(excess / RELIEF_OVERPRESSURE, RELIEF_ROUNDING)
            if circuit.anticavitation:
                into[port] += full * hinge((tank - pressure) / CHECK_VALVE_SUCTION, RELIEF_ROUNDING)
        return Flows(into["a"], into["b"], pa + pb)

    def capacities(self, p_a: ca.SX, p_b: ca.SX, length: ca.SX, value: Value) -> tuple[ca.SX, ca.SX]:
        """Oil [m³/Pa] that raises each chamber's pressure by one pascal (Merritt 1967).

        The walls of hoses yield too: the volume of a hose is divided by the modulus of its walls.
        """
        found = []
        for port, pressure, volume in zip("ab", (p_a, p_b), self.volumes(length), strict=True):
            hose = value(f"volume_{port}")
            air = "oil.air" if getattr(self.circuit, f"air_{port}") is None else f"air_{port}"
            capacity = (volume + hose) * compressibility(self.oil, pressure, value, air)
            if self.circuit.hose_modulus is not None:
                capacity += hose / value("hose_modulus")
            found.append(capacity)
        return found[0], found[1]

    def pressure_rates(self, flows: Flows, p_a: ca.SX, p_b: ca.SX, length: ca.SX, speed: ca.SX,
                       value: Value) -> tuple[ca.SX, ca.SX]:
        """Rates [Pa/s] of both chambers' pressures: net flow by capacity."""
        swept, capacity = chamber_flows(self.actuator, speed), self.capacities(p_a, p_b, length, value)
        return (flows.into_a - swept[0]) / capacity[0], (flows.into_b - swept[1]) / capacity[1]

    def resistances(self, value: Value) -> tuple[ca.SX, ca.SX]:
        """Force per square of the speed [N·s²/m² or N·m·s²/rad²] that the fully open valve takes: extending,
        retracting."""
        a, b = self.areas
        k_pa, k_at, k_pb, k_bt = (conductance(self.valve, edge, value)
                                  for edge in ("flow_pa", "flow_at", "flow_pb", "flow_bt"))
        return a**3 / k_pa**2 + b**3 / k_bt**2, b**3 / k_pb**2 + a**3 / k_at**2

    def opening_for(self, force: ca.SX, speed: ca.SX, supply: ca.SX, value: Value) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Spool position and both chambers' pressures in steady motion at a force and a speed.

        For sharp edges without leaks: the same spool opens the edge that feeds and the one that drains, so that
        A_a·p_supply − A_b·p_tank − f = (v/x)²·(A_a³/K_pa² + A_b³/K_bt²) when extending, and likewise when retracting
        (as in Merritt 1967, for unequal areas and edges). The result is NaN where the supply pressure does not suffice.
        """
        a, b = self.areas
        pump, tank = supply[0], supply[1]
        k_pa, k_at = (conductance(self.valve, edge, value) for edge in ("flow_pa", "flow_at"))
        out, back = self.resistances(value)
        left_out, left_back = a * pump - b * tank - force, b * pump - a * tank + force
        extends = (1 + ca.sign(ca.sign(speed) + 0.5)) / 2  # 1 or 0, since generated C has no branches
        retracts = 1 - extends
        opening = speed * ca.sqrt(extends * out / left_out + retracts * back / left_back)
        p_a = (extends * (pump - left_out * a**2 / (k_pa**2 * out))
               + retracts * (tank + left_back * a**2 / (k_at**2 * back)))
        p_b = (a * p_a - force) / b
        return opening, p_a, p_b


def pump_flow(most: float, set_pressure: ca.SX, pressure: ca.SX) -> ca.SX:
    """Flow [m³/s] of a pressure-compensated pump: zero at its set pressure, full flow from slightly below.

    A straight cut-off (Merritt 1967) with rounded corners.
    """
    part = (set_pressure - pressure) / (CUT_OFF * set_pressure)
    return most * (hinge(part, CORNER) - hinge(part - 1, CORNER))
