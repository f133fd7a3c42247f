"""Cascade control of position, force and valve: feedback of lengths and pressures added to a feedforward."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from hydroopt.control.axes import Axes
from hydroopt.control.linear_plant import Point, Reading, readings, signals
from hydroopt.control.reference import Demand
from hydroopt.control.valve_inversion import Valves
from hydroopt.control.valve_refit import ValveRefit
from hydroopt.kernels.virtual_machine import OneSample
from hydroopt.spatial.inertia import Array

if TYPE_CHECKING:
    from control import StateSpace

SHORTEST = 1e-9
"""Time constant [s] of a low pass that passes everything."""


@dataclass(frozen=True, eq=False)
class Gains:
    """Feedback of the axes (m,) and of the actuators (a,), see `Axes`.

    Attributes:
        position: speed per error of the position, of each axis [1/s].
        force: speed per error of the force, of each actuator [m/(s·N) or rad/(s·N·m)].
        integral_time: T_i of the integral action on the position's error, of each axis [s].
        filter_time: time constant of a low pass on all feedback of an axis [s]; 0 for none.
    """

    position: Array
    force: Array
    integral_time: Array
    filter_time: Array


def feedback(axes: Axes, error: ca.SX, shares: ca.SX, force_error: ca.SX, opening: ca.SX, filtered: ca.SX,
             integral: ca.SX, gains: Gains, period: ca.SX) -> tuple[ca.SX, ca.SX]:
    """One sample of the feedback of a `Cascade`: the speed (a,) that it adds, and the integrals (m,) for the next one.

    Integrals wait while a valve of their axis is fully open.

    Args:
        axes: m of them, with a actuators.
        error: of their positions (m,).
        shares: speeds (a, m) of the actuators per speed of their axis.
        force_error: of the actuators' forces (a,) [N or N·m].
        opening: of the valves (a,) a sample ago, −1 to 1.
        filtered: the speed (a,) that it added a sample ago.
        integral: of the positions' errors (m,), by the integral time.
        gains: as symbols.
        period: since the last sample [s].
    """
    demanded = shares @ (gains.position * (error + integral)) + gains.force * force_error
    pole = ca.exp(-period / ca.fmax(gains.filter_time[axes.of.tolist(), 0], SHORTEST))
    free = ca.vertcat(*(ca.sign(ca.fmax(0, 1 - ca.mmax(ca.fabs(opening[list(places)])))) for places in axes.actuators))
    return pole * filtered + (1 - pole) * demanded, integral + free * period * error / gains.integral_time


class Cascade:
    """v = v_r + K_x·(e + ∫e/T_i) + K_f·(f_r − f), and the command at which the valve gives this speed.

    e is the error of the actuator's length, f its force computed from pressures; v_r and f_r are speed and force of the
    reference. Where several actuators share a joint, e is the joint's error, and each takes the share of the speed that
    its lever arm makes of it; their forces f_r are those of `shared_load`. What is not measured is not fed back. The
    outer position loop demands the force f_r + K_x/K_f·(e + ∫e/T_i), the force loop adds a speed to v_r, and the
    valve's flow equation is solved for the command (position, force, valve: as in Sirouspour and Salcudean 2001, with
    linear feedback in place of their Lyapunov design). An error Δf of the feedforward force causes a length error of
    K_f/K_x·Δf until the integral action has removed it.

    With v_r = 0 and the static forces as f_r this is PI control with gravity compensation; with speeds and forces of
    the motion it is computed-force feedforward. With a `refit` the valves' flows are corrected on-line.
    """

    def __init__(self, valves: Valves, demand: Demand, gains: Gains, period: float, *,
                 refit: ValveRefit | None = None) -> None:
        self.valves, self.demand, self.gains, self.period, self.refit = valves, demand, gains, period, refit
        self.axes = Axes(valves.plant)
        self._pole = np.exp(-period / np.maximum(gains.filter_time[self.axes.of], SHORTEST))
        self._position, self._shares = self.axes.positions(demand.q, demand.length), self.axes.shares_along(demand.q)
        self.reset()

    def reset(self) -> None:
        """Return to the initial state."""
        self._integral = np.zeros(len(self.axes.names))
        self._filtered, self._opening = np.zeros((2, len(self.axes.of)))
        if self.refit:
            self.refit.reset()

    def command(self, k: int, reading: Reading) -> Array:
        """Commands (a,) at sample k from the readings."""
        demand, preview, gains = self.demand, self.demand.preview, self.gains
        error = self._controlled(k, self._position[k] - self.axes.positions(reading.q, reading.length))
        self._filtered, self._integral = self._feedback(
            error, self._shares[k], demand.measured_force[k] - reading.force, self._opening, self._filtered,
            self._integral, gains.position, gains.force, gains.integral_time, gains.filter_time)
        factors = self.refit.read(reading) if self.refit else None
        command, self._opening = self.valves.command(self._speed(k, reading), preview.force_rate[k], preview.length[k],
                                                     preview.pressure[k], reading.supply, factors)
        if self.refit:
            self.refit.sent(command)
        return command

    @cached_property
    def _feedback(self) -> OneSample:
        """(errors (m,), shares (a, m), errors of forces, openings, filtered (a,), integral (m,), gains) → filtered,
        integral."""
        m, a = len(self.axes.names), len(self.axes.of)
        sizes = {"error": (m, 1), "shares": (a, m), "force_error": (a, 1), "opening": (a, 1), "filtered": (a, 1),
                 "integral": (m, 1)} | {key: (len(values), 1) for key, values in vars(self.gains).items()}
        given = [ca.SX.sym(name, *size) for name, size in sizes.items()]
        error, shares, force_error, opening, filtered, integral, *gains = given
        return OneSample(ca.Function("feedback", given, feedback(
            self.axes, error, shares, force_error, opening, filtered, integral, Gains(*gains), ca.SX(self.period))))

    def _controlled(self, k: int, error: Array) -> Array:
        """The part of the axes' errors (m,) that position control answers for: all of it."""
        return error

    def _speed(self, k: int, reading: Reading) -> Array:
        """Demanded speeds (a,) of the actuators."""
        return np.asarray(self.demand.preview.speed[k] + self._filtered)

    def linear(self, point: Point) -> StateSpace:
        """The linearised controller: from q, forces and supply pressure to commands.

        It has two kinds of states: the integral of each axis, and the filter of each actuator.
        """
        return linear_feedback(self.axes, self.valves, self.gains, self.period, point)


def linear_feedback(axes: Axes, valves: Valves, gains: Gains, period: float, point: Point) -> StateSpace:
    """What `Cascade.linear` returns, of any gains."""
    import control  # noqa: PLC0415 — codegen reaches this module, and needs no linear systems

    pole = np.diag(np.exp(-period / np.maximum(gains.filter_time[axes.of], SHORTEST)))
    a, m, n = len(pole), len(gains.position), len(point.q)
    rest, along, shares = np.eye(a) - pole, axes.slopes(point.lever_arm), axes.shares(point.lever_arm)
    slopes = valves.slopes(point.speed, point.length, point.pressure, point.supply)
    regulated, by_speed = shares * gains.position, np.diag(slopes.speed)
    to_feedback = np.hstack([-regulated @ along, -np.diag(gains.force), np.zeros((a, 1))])
    to_integral = np.hstack([-np.diag(period / gains.integral_time) @ along, np.zeros((m, a + 1))])
    by_integral = rest @ regulated
    supply = np.hstack([np.zeros((a, n + a)), slopes.supply[:, None]])
    return control.ss(
        np.block([[np.eye(m), np.zeros((m, a))], [by_integral, pole]]),
        np.vstack([to_integral, rest @ to_feedback]),
        by_speed @ np.hstack([by_integral, pole]), by_speed @ rest @ to_feedback + supply, period,
        states=signals([*(f"{name}.integral" for name in axes.names),
                        *(f"{each.actuator.name}.filtered" for each in axes.plant.actuators)]),
        inputs=readings(axes.plant), outputs=signals(axes.plant.inputs))
