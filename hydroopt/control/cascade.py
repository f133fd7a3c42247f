"""Cascade control of position, force and valve: feedback of lengths and pressures added to a feedforward."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np
from scipy.linalg import block_diag

from hydroopt.control.axes import Axes
from hydroopt.control.linear_plant import SHORTEST, Point, Reading, readings, signals
from hydroopt.control.reference import Demand
from hydroopt.control.valve_inversion import Valves
from hydroopt.control.valve_refit import ValveRefit
from hydroopt.kernels.virtual_machine import OneSample
from hydroopt.spatial.inertia import Array

if TYPE_CHECKING:
    from control import StateSpace


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


class Feedback:
    """The feedback of a cascade: sample by sample, and as a linear system.

    Attributes:
        axes: of the machine.
        period: of the samples [s].
        step: (filtered (a,), integral (m,), error (m,), force_error, opening (a,), shares (a, m), gains) → the first
            two for the next sample, see `feedback`.
    """

    def __init__(self, axes: Axes, period: float) -> None:
        m, a = len(axes.names), len(axes.of)
        self.axes, self.period = axes, period
        filtered, integral, error, force_error, opening = state = [ca.SX.sym(name, size) for name, size in (
            ("filtered", a), ("integral", m), ("error", m), ("force_error", a), ("opening", a))]
        shares, *gains = rest = [ca.SX.sym("shares", a, m), *(ca.SX.sym(name, size) for name, size in (
            ("position", m), ("force", a), ("integral_time", m), ("filter_time", m)))]
        after = feedback(axes, error, shares, force_error, opening, filtered, integral, Gains(*gains), ca.SX(period))
        self.step = OneSample(ca.Function("feedback", [*state, *rest], after))
        self._derivatives = ca.Function("derivatives", rest, [ca.densify(ca.substitute(
            ca.jacobian(ca.vertcat(*after), ca.vertcat(*some)), ca.vertcat(*state), ca.DM.zeros(3 * a + 2 * m)))
            for some in (state[:2], state[2:4])])

    def linear(self, shares: Array, gains: Gains) -> tuple[Array, Array]:
        """Derivatives (a + m, ...) of the added speeds and of the integrals for the next sample while no valve is fully
        open: by those before, and by the errors of positions (m,) and forces (a,).
        """
        by_before, by_errors = self._derivatives(shares, *vars(gains).values())
        return np.asarray(by_before), np.asarray(by_errors)

    def about(self, point: Point, valves: Valves, gains: Gains) -> StateSpace:
        """The linearised controller: from q, forces and supply pressure to commands."""
        import control  # noqa: PLC0415 — codegen reaches this module, and needs no linear systems

        (a, n), axes = point.lever_arm.shape, self.axes
        slopes = valves.slopes(point.speed, point.length, point.pressure, point.supply)
        A, by_errors = self.linear(axes.shares(point.lever_arm), gains)
        B = -by_errors @ block_diag(axes.slopes(point.lever_arm), np.hstack([np.eye(a), np.zeros((a, 1))]))
        by_supply = np.hstack([np.zeros((a, n + a)), slopes.supply[:, None]])
        return control.ss(
            A, B, slopes.speed[:, None] * A[:a], slopes.speed[:, None] * B[:a] + by_supply, self.period,
            states=signals([*(f"{each.actuator.name}.filtered" for each in axes.plant.actuators),
                            *(f"{name}.integral" for name in axes.names)]),
            inputs=readings(axes.plant), outputs=signals(axes.plant.inputs))


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
        self._feedback = Feedback(self.axes, period)
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
        demand, preview = self.demand, self.demand.preview
        error = self._controlled(k, self._position[k] - self.axes.positions(reading.q, reading.length))
        self._filtered, self._integral = self._feedback.step(
            self._filtered, self._integral, error, demand.measured_force[k] - reading.force, self._opening,
            self._shares[k], *vars(self.gains).values())
        factors = self.refit.read(reading) if self.refit else None
        command, self._opening = self.valves.command(self._speed(k, reading), preview.force_rate[k], preview.length[k],
                                                     preview.pressure[k], reading.supply, factors)
        if self.refit:
            self.refit.sent(command)
        return command

    def _controlled(self, k: int, error: Array) -> Array:
        """The part of the axes' errors (m,) that position control answers for: all of it."""
        return error

    def _speed(self, k: int, reading: Reading) -> Array:
        """Demanded speeds (a,) of the actuators."""
        return np.asarray(self.demand.preview.speed[k] + self._filtered)

    def linear(self, point: Point) -> StateSpace:
        """See `Feedback.about`."""
        return self._feedback.about(point, self.valves, self.gains)
