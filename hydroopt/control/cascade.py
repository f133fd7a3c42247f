"""Cascade control of position, force and valve: feedback of lengths and pressures added to a feedforward."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hydroopt.control.axes import Axes
from hydroopt.control.linear_system import LinearSystem
from hydroopt.control.reference import Demand
from hydroopt.control.sampled_plant import Point, Reading
from hydroopt.control.valve_inversion import Valves
from hydroopt.spatial.inertia import Array


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
    the motion it is computed-force feedforward.
    """

    def __init__(self, valves: Valves, demand: Demand, gains: Gains, period: float) -> None:
        self.valves, self.demand, self.gains, self.period = valves, demand, gains, period
        self.axes = Axes(valves.plant)
        self._pole = np.exp(-period / np.maximum(gains.filter_time[self.axes.of], 1e-9))
        self._position, self._shares = self.axes.positions(demand.q, demand.length), self.axes.shares_along(demand.q)
        self._integral, self._filtered = np.zeros(len(self.axes.names)), np.zeros(len(self._pole))

    def reset(self) -> None:
        """Return to the initial state."""
        self._integral[:] = self._filtered[:] = 0.0

    def command(self, k: int, reading: Reading) -> Array:
        """Commands (a,) at sample k from the readings."""
        demand, gains = self.demand, self.gains
        error = self._controlled(k, self._position[k] - self.axes.positions(reading.q, reading.length))
        feedback = (self._shares[k] @ (gains.position * (error + self._integral))
                    + gains.force * (demand.measured_force[k] - reading.force))
        self._filtered = self._pole * self._filtered + (1 - self._pole) * feedback
        preview = demand.preview
        command, opening = self.valves.command(self._speed(k, reading), preview.force_rate[k], preview.length[k],
                                               preview.pressure[k], reading.supply)
        # anti-windup: the integral is held while a valve is fully open
        self._integral += np.where(self.axes.open(opening), self.period * error / gains.integral_time, 0.0)
        return command

    def _controlled(self, k: int, error: Array) -> Array:
        """The part of the axes' errors (m,) that position control answers for: all of it."""
        return error

    def _speed(self, k: int, reading: Reading) -> Array:
        """Demanded speeds (a,) of the actuators."""
        return np.asarray(self.demand.preview.speed[k] + self._filtered)

    def linear(self, point: Point) -> LinearSystem:
        """The linearised controller: from q, forces and supply pressure to commands.

        It has two kinds of states: the integral of each axis, and the filter of each actuator.
        """
        gains, pole = self.gains, np.diag(self._pole)
        a, m, n = len(pole), len(gains.position), len(point.q)
        rest, along, shares = np.eye(a) - pole, self.axes.slopes(point.lever_arm), self.axes.shares(point.lever_arm)
        slopes = self.valves.slopes(point.speed, point.length, point.pressure, point.supply)
        regulated, by_speed = shares * gains.position, np.diag(slopes.speed)
        to_feedback = np.hstack([-regulated @ along, -np.diag(gains.force), np.zeros((a, 1))])
        to_integral = np.hstack([-np.diag(self.period / gains.integral_time) @ along, np.zeros((m, a + 1))])
        by_integral = rest @ regulated
        supply = np.hstack([np.zeros((a, n + a)), slopes.supply[:, None]])
        return LinearSystem(
            np.block([[np.eye(m), np.zeros((m, a))], [by_integral, pole]]),
            np.vstack([to_integral, rest @ to_feedback]),
            by_speed @ np.hstack([by_integral, pole]), by_speed @ rest @ to_feedback + supply, self.period)
