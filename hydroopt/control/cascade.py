"""Position, force and valve in cascade: feedback of lengths and pressures about what a motion demands."""

from __future__ import annotations

from dataclasses import dataclass

import control
import numpy as np

from hydroopt.control.reference import Demand
from hydroopt.control.sampled_plant import Point, Reading
from hydroopt.control.valve_inversion import Valves
from hydroopt.spatial.inertia import Array


@dataclass(frozen=True, eq=False)
class Gains:
    """Feedback of each actuator (n,).

    Attributes:
        position: speed per error of the length [1/s].
        force: speed per error of the force [m/(s·N) or rad/(s·N·m)].
        integral_time: time in which the integral of an error asks for as much as the error itself [s].
        filter_time: time constant of a low pass on all feedback [s]; 0 for none.
    """

    position: Array
    force: Array
    integral_time: Array
    filter_time: Array


class Cascade:
    """v = v_r + K_x·(e + ∫e/T_i) + K_f·(f_r − f), and the command at which the valve gives this speed.

    e is the error of the actuator's length, f its force by the pressures, v_r and f_r what the motion demands. Read
    from outside to inside: the position loop asks for a force f_r + K_x/K_f·(e + ∫e/T_i), the force loop for a speed
    beside that of the motion, and the valve's flow equation is solved for the command (position, force, valve: as in
    Sirouspour and Salcudean 2001, with linear feedback in place of their Lyapunov design). A force that is off by Δf so
    puts the length off by K_f/K_x·Δf until the integral has found it.

    With the demand of gravity alone (v_r = 0) it is the PI controller with gravity compensation, with that of a motion
    the computed-force feedforward.
    """

    def __init__(self, valves: Valves, demand: Demand, gains: Gains, period: float) -> None:
        self.valves, self.demand, self.gains, self.period = valves, demand, gains, period
        self._pole = np.exp(-period / np.maximum(gains.filter_time, 1e-9))
        self._integral, self._filtered = np.zeros(len(self._pole)), np.zeros(len(self._pole))

    def reset(self) -> None:
        """Return to the initial state."""
        self._integral[:] = self._filtered[:] = 0.0

    def command(self, k: int, reading: Reading) -> Array:
        """Commands (n,) at a sample, as the sensors show the machine."""
        demand, gains = self.demand, self.gains
        error = demand.length[k] - reading.length
        feedback = gains.position * (error + self._integral) + gains.force * (demand.shown[k] - reading.force)
        self._filtered = self._pole * self._filtered + (1 - self._pole) * feedback
        ahead = demand.ahead
        command, opening = self.valves.command(ahead.speed[k] + self._filtered, ahead.force_rate[k], ahead.length[k],
                                               ahead.pressure[k], reading.supply)
        # a valve that is fully open lets no integral grow
        self._integral += np.where(np.abs(opening) < 1, self.period * error / gains.integral_time, 0.0)
        return command

    def linear(self, point: Point) -> control.StateSpace:
        """Small changes of commands per small changes of q, forces and supply pressure.

        Two states each: integral and filter.
        """
        gains, pole = self.gains, np.diag(self._pole)
        n = len(pole)
        rest = np.eye(n) - pole
        slopes = self.valves.slopes(point.speed, point.length, point.pressure, point.supply)
        to_feedback = np.hstack([-np.diag(gains.position) @ point.lever_arm, -np.diag(gains.force), np.zeros((n, 1))])
        to_integral = np.hstack([-np.diag(self.period / gains.integral_time) @ point.lever_arm, np.zeros((n, n + 1))])
        by_integral, by_speed = rest * gains.position, np.diag(slopes.speed)
        supply = np.hstack([np.zeros((n, 2 * n)), slopes.supply[:, None]])
        return control.StateSpace(
            np.block([[np.eye(n), np.zeros((n, n))], [by_integral, pole]]),
            np.vstack([to_integral, rest @ to_feedback]),
            by_speed @ np.hstack([by_integral, pole]), by_speed @ rest @ to_feedback + supply, self.period)
