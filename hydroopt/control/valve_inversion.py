"""Inversion of the valves: the command at which an actuator has a given speed and rate of force."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import casadi as ca
import numpy as np

from hydroopt.kernels.integrator import Integrator
from hydroopt.kernels.virtual_machine import OneSample
from hydroopt.machine.valves import EDGES, Valve
from hydroopt.model.hydraulics import ActuatorHydraulics, Flows, Value, conductance, orifice
from hydroopt.model.plant import PRESSURE, Plant
from hydroopt.spatial.inertia import Array

RAMP = 0.003
"""Opening below which the command crosses the dead band linearly instead of in a jump."""
DROP = 1e5
"""Least pressure drop [Pa] across an edge that the inversion assumes; feedback corrects what is missing below it."""


def command(valve: Valve, opening: ca.SX, value: Value) -> ca.SX:
    """Command for an opening of −1 to 1 (positive P→A): the inverse of the valve's dead bands.

    Beyond the ramp it undoes `spool_position` and `openings`, whose rounded corner h = (x + √(x² + w²))/2 has the
    inverse x = h − w²/(4·h). Within, it is a smooth inverse, so that noise about zero does not make the spool jump (Tao
    and Kokotovic 1996).
    """
    side, size, width = ca.sign(opening), ca.fabs(opening), valve.rounding

    def beyond(h: ca.SX) -> ca.SX:
        return h - width**2 / (4 * ca.fmax(h, 1e-2 * width))

    forward = value("dead_band") / abs(valve.span)
    reverse = forward if valve.dead_band_reverse is None else value("dead_band_reverse") / abs(valve.span)
    dead = (1 + side) / 2 * forward + (1 - side) / 2 * reverse
    spool = ca.fmax(value("overlap") + beyond(size * (1 - value("overlap"))), 0)
    spool_command = ca.fmax(dead + beyond(spool * (1 - dead)), 0)
    return valve.neutral + valve.span * side * ca.fmin(1.0, size / RAMP) * spool_command


def opening(each: ActuatorHydraulics, speed: ca.SX, force_rate: ca.SX, length: ca.SX, pressure: ca.SX, supply: ca.SX,
            factors: ca.SX, value: Value) -> ca.SX:
    """Opening, −1 to 1, at which an actuator moves at a speed while its force changes at a rate.

    f' = A_a·p_a' − A_b·p_b' is the rate with a shut valve, due to motion and leaks, plus a part that is proportional
    to the opening. It is solved for the opening (the innermost step of Sirouspour and Salcudean 2001).

    Args:
        each: the actuator.
        speed: of it [m/s or rad/s].
        force_rate: [N/s or N·m/s].
        length: of a cylinder [m].
        pressure: (2,) of the chambers [Pa].
        supply: (2,) of supply and tank [Pa].
        factors: (2,) on its flows, extending and retracting, see `valve_refit`.
        value: of the numbers of its circuit.
    """
    (a, b), (p_a, p_b), (pump, tank) = each.areas, ca.vertsplit(pressure), ca.vertsplit(supply)
    # with closed edges only the leaks remain
    leaks = each.flows(ca.SX(0), p_a, p_b, supply, lambda key: 0.0 if key in (*EDGES, "rated_flow") else value(key))
    shut = each.pressure_rates(leaks, p_a, p_b, length, speed, value)
    unit = each.pressure_rates(Flows(ca.SX(1), ca.SX(1), ca.SX(0)), p_a, p_b, length, ca.SX(0), value)

    def through(edge: str, upstream: ca.SX, downstream: ca.SX) -> ca.SX:
        drop = ca.fmax(upstream - downstream, DROP)
        return orifice(conductance(each.valve, edge, value), drop, ca.SX(0), each.valve.laminar_drop)

    extending = a * unit[0] * through("flow_pa", pump, p_a) + b * unit[1] * through("flow_bt", p_b, tank)
    retracting = a * unit[0] * through("flow_at", p_a, tank) + b * unit[1] * through("flow_pb", pump, p_b)
    missing = force_rate - (a * shut[0] - b * shut[1])
    return ca.fmax(missing, 0) / (factors[0] * extending) + ca.fmin(missing, 0) / (factors[1] * retracting)


class Slopes(NamedTuple):
    """Derivatives of the commands (n,) by the demanded speeds (n,) of the same actuators and by the supply pressure."""

    speed: Array
    supply: Array


class Valves:
    """The valves of a machine with the parameters θ that a controller uses.

    Attributes:
        plant: the machine.
        theta: hydraulic parameters.
        limits: lowest and highest command (n,) of each valve.
    """

    def __init__(self, plant: Plant, theta: Array) -> None:
        self.plant, self.theta = plant, theta
        ends = np.sort([(each.valve.neutral - each.valve.span, each.valve.full) for each in plant.actuators], axis=1)
        self.limits = ends[:, 0], ends[:, 1]

    @cached_property
    def function(self) -> ca.Function:
        """(speed, force_rate, length (n,), pressure (n, 2), supply (2,), factors (n, 2), θ) → command and opening (n,),
        p_a' (n,) with factors of one."""
        n, theta = len(self.plant.actuators), ca.SX.sym("theta", len(self.theta))
        speed, rate, length = (ca.SX.sym(name, n) for name in ("speed", "force_rate", "length"))
        pressure, supply, factors = ca.SX.sym("pressure", n, 2), ca.SX.sym("supply", 2), ca.SX.sym("factors", n, 2)
        commands, openings, rates = [], [], []
        for k, each in enumerate(self.plant.actuators):
            value, p = self.plant.value(each, theta), pressure[k, :].T
            wide = opening(each, speed[k], rate[k], length[k], p, supply, factors[k, :].T, value)
            saturated = ca.fmin(ca.fmax(wide, -1.0), 1.0)
            openings.append(saturated)
            commands.append(command(each.valve, saturated, value))
            # within the ramp the spool crosses the overlap as the command does, so that rates do not jump about zero
            size = ca.fabs(saturated)
            spool = ca.sign(saturated) * ca.fmin(1.0, size / RAMP) * (value("overlap") + size * (1 - value("overlap")))
            rates.append(each.pressure_rates(each.flows(spool, p[0], p[1], supply, value), p[0], p[1], length[k],
                                             speed[k], value)[0])
        return ca.Function("valves", [speed, rate, length, pressure, supply, factors, theta],
                           [ca.vertcat(*commands), ca.vertcat(*openings), ca.vertcat(*rates)],
                           ["speed", "force_rate", "length", "pressure", "supply", "factors", "theta"],
                           ["command", "opening", "p_a_rate"])

    @cached_property
    def _commands(self) -> OneSample:
        given = self.function.sx_in()
        return OneSample(ca.Function("commands", given, self.function(*given)[:2]))

    def pressures(self, start: Array, seconds: Array, motion: Sequence[Array], force_rate: Array,
                  supply: Array) -> Array:
        """Pressures p_a (M, a) [Pa] behind each piece of a motion in which speed, length and force are linear in time.

        p_a' follows from the flow through the valve, p_b from force and p_a.

        Args:
            start: p_a (a,) at the start.
            seconds: (M,) length of each piece.
            motion: speed, length and force (M + 1, a) at its ends.
            force_rate: (M, a) in each piece.
            supply: pressures (2,) of supply and tank.

        Raises:
            IntegrationError: no step succeeds.
        """
        pieces = len(seconds)
        slopes = [np.diff(values, axis=0) / seconds[:, None] for values in motion]
        rest = [force_rate, np.tile(supply, (pieces, 1))]
        integrator = Integrator(self._pressure_rates, [self.theta], np.full(len(start), PRESSURE))
        return integrator.along(start, seconds, *(values[:-1] for values in motion), *rest,
                                slopes=[*slopes, *(0 * values for values in rest)])

    @cached_property
    def _pressure_rates(self) -> ca.Function:
        """(p_a, speed, length, force, force_rate (a,), supply (2,), θ) → p_a'."""
        count, (a, b) = len(self.plant.actuators), np.array([each.areas for each in self.plant.actuators]).T
        names = ("p_a", "speed", "length", "force", "force_rate")
        p_a, speed, length, force, rate = parts = [ca.SX.sym(name, count) for name in names]
        supply, theta = ca.SX.sym("supply", 2), ca.SX.sym("theta", len(self.theta))
        both = ca.horzcat(p_a, (a * p_a - force) / b)
        return ca.Function("demanded_pressures", [*parts, supply, theta],
                           [self.function(speed, rate, length, both, supply, ca.SX.ones(count, 2), theta)[2]],
                           [*names, "supply", "theta"], ["p_a_rate"])

    def command(self, speed: Array, force_rate: Array, length: Array, pressure: Array, supply: Array,
                factors: Array | None = None) -> tuple[Array, Array]:
        """Commands and openings (n,); `factors` (n, 2) on the flows, one if None."""
        factors = np.ones((len(speed), 2)) if factors is None else factors
        commands, openings = self._commands(speed, force_rate, length, pressure, supply, factors, self.theta)
        return commands, openings

    @property
    def speed_per_force(self) -> Array:
        """Speed (n,) through a fully open valve without load per largest force [m/(s·N) or rad/(s·N·m)]."""
        found, pump = [], self.plant.supply[0]
        for each in self.plant.actuators:
            flow = conductance(each.valve, "flow_pa", self.plant.value(each, ca.SX(ca.DM(self.theta)))) * pump**0.5
            found.append(float(ca.evalf(flow)) / each.areas[0] / (each.areas[0] * pump))
        return np.array(found)

    @cached_property
    def steady(self) -> ca.Function:
        """(speed, force (n,), supply (2,)) → p_a (n,) of steady motion, see `ActuatorHydraulics.opening_for`."""
        n = len(self.plant.actuators)
        speed, force, supply = ca.SX.sym("speed", n), ca.SX.sym("force", n), ca.SX.sym("supply", 2)
        found = [each.opening_for(force[k], speed[k], supply, self.plant.value(each, ca.SX(ca.DM(self.theta))))[1]
                 for k, each in enumerate(self.plant.actuators)]
        return ca.Function("steady", [speed, force, supply], [ca.vertcat(*found)],
                           ["speed", "force", "supply"], ["p_a"])

    @cached_property
    def _derivatives(self) -> ca.Function:
        given = self.function.sx_in()
        out = self.function(*given)[0]
        return ca.Function("slopes", given, [ca.densify(ca.jacobian(out, given[0])),
                                             ca.densify(ca.jacobian(out, given[4]))])

    def slopes(self, speed: Array, length: Array, pressure: Array, supply: Array) -> Slopes:
        """Derivatives of the commands, at speeds that open the valves beyond the ramp and constant forces."""
        still = np.zeros_like(speed)
        by_speed, by_supply = (np.asarray(part) for part in self._derivatives(
            speed, still, length, pressure, supply, np.ones((len(speed), 2)), self.theta))
        return Slopes(np.diag(by_speed).copy(), by_supply[:, 0].copy())
