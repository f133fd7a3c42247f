"""Cascade control of position, force and valve: feedback of lengths and pressures added to a feedforward."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hydroopt.control.python_control import control
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
        integral_time: T_i of the integral action on the length's error [s].
        filter_time: time constant of a low pass on all feedback [s]; 0 for none.
    """

    position: Array
    force: Array
    integral_time: Array
    filter_time: Array


class Cascade:
    """v = v_r + K_x·(e + ∫e/T_i) + K_f·(f_r − f), and the command at which the valve gives this speed.

    e is the error of the actuator's length, f its force computed from pressures; v_r and f_r are speed and force of the
    reference. The outer position loop demands the force f_r + K_x/K_f·(e + ∫e/T_i), the force loop adds a speed to
    v_r, and the valve's flow equation is solved for the command (position, force, valve: as in Sirouspour and
    Salcudean 2001, with linear feedback in place of their Lyapunov design). An error Δf of the feedforward force
    causes a length error of K_f/K_x·Δf until the integral action has removed it.

    With v_r = 0 and the static forces as f_r this is PI control with gravity compensation; with speeds and forces of
    the motion it is computed-force feedforward.
    """

    def __init__(self, valves: Valves, demand: Demand, gains: Gains, period: float) -> None:
        self.valves, self.demand, self.gains, self.period = valves, demand, gains, period
        self._pole = np.exp(-period / np.maximum(gains.filter_time, 1e-9))
        self._integral, self._filtered = np.zeros(len(self._pole)), np.zeros(len(self._pole))

    def reset(self) -> None:
        """Return to the initial state."""
        self._integral[:] = self._filtered[:] = 0.0

    def command(self, k: int, reading: Reading) -> Array:
        """Commands (n,) at sample k from the readings."""
        demand, gains = self.demand, self.gains
        error = self._controlled(k, demand.length[k] - reading.length)
        feedback = gains.position * (error + self._integral) + gains.force * (demand.measured_force[k] - reading.force)
        self._filtered = self._pole * self._filtered + (1 - self._pole) * feedback
        preview = demand.preview
        command, opening = self.valves.command(self._speed(k, reading), preview.force_rate[k], preview.length[k],
                                               preview.pressure[k], reading.supply)
        # anti-windup: the integral is held while the valve is fully open
        self._integral += np.where(np.abs(opening) < 1, self.period * error / gains.integral_time, 0.0)
        return command

    def _controlled(self, k: int, error: Array) -> Array:
        """The part of the lengths' errors (n,) that position control answers for: all of it."""
        return error

    def _speed(self, k: int, reading: Reading) -> Array:
        """Demanded speeds (n,) of the actuators."""
        return np.asarray(self.demand.preview.speed[k] + self._filtered)

    def linear(self, point: Point) -> control.StateSpace:
        """The linearised controller: from q, forces and supply pressure to commands.

        It has two states per actuator: integral and filter.
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
