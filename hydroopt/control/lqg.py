"""Linear quadratic Gaussian control about points of a motion: state feedback, Kalman filter and integral action."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import control
import numpy as np
from control import StateSpace
from scipy.linalg import block_diag

from hydroopt.control.axes import Axes
from hydroopt.control.closed_loop import reading_std
from hydroopt.control.linear_plant import Point, Reading, readings, signals
from hydroopt.control.reference import Demand
from hydroopt.control.tuning import INTEGRAL_RATIO
from hydroopt.control.valve_inversion import Valves
from hydroopt.model.plant import PRESSURE, Plant
from hydroopt.spatial.inertia import Array

BANDWIDTH_SHARE = 0.7
"""Bandwidth of the regulator as a part of the cascade's position gain, since resonances change with the posture."""
PROCESS_NOISE = 1e-2
"""Standard deviation of the process noise of every state per sample, as a part of its typical size."""
FORCE_DRIFT = 1e-2
"""Standard deviation of the change per sample of an error of the demanded force, as a part of an actuator's force at
`PRESSURE`."""
LEAST_PRESSURE = 1e3
"""Standard deviation [Pa] of a pressure's reading that counts at least."""
NEAR = 0.3
"""Part of the designs' spread of postures over which their gains pass into each other."""
LEAST_SPAN = 1e-3
"""Spread of postures [rad or m] that counts at least."""
OTHER_WAY = 0.5
"""Difference of direction over which the gains of two designs pass into each other; opposite directions differ by 2."""


class Matrices(NamedTuple):
    """Model, regulator and filter for deviations from a motion.

    Attributes:
        A, B, C: of the sampled plant, its inputs being the demanded speeds; its last states are the errors of the
            demanded forces, which the readings show and no command changes.
        feedback: speeds per state and per integral of the axes' errors.
        filter: states per innovation, Kalman's gain for the state at the next sample.
    """

    A: Array
    B: Array
    C: Array
    feedback: Array
    filter: Array

    def regulator(self, period: float) -> tuple[Array, Array]:
        """(F, G) of ``x' = F·x + G·y``, whose speeds are ``−feedback·x``.

        x are the states and the integrals (m,) of the axes' errors, y by what readings (n + a + 1,) and positions of
        the axes (m,) are off. `period` is that of the samples [s].
        """
        size, m = len(self.A), self.feedback.shape[1] - len(self.A)
        F = block_diag(self.A - self.filter @ self.C, np.eye(m))
        F[:size] -= self.B @ self.feedback
        return F, block_diag(self.filter, period * np.eye(m))

class Design(NamedTuple):
    """Matrices for deviations from an operating point, and the names of the states that the filter estimates."""

    point: Point
    matrices: Matrices
    states: tuple[str, ...]


class Schedule:
    """Designs blended by posture and direction of motion.

    Each counts by exp(−d²/2), with d² the sum over the joints of the squared distance from its posture, in units of
    `NEAR` times the designs' spread, and over the actuators of the squared difference of direction, in units of
    `OTHER_WAY`. A direction is the speed by that of the design's point, between −1 and 1.
    """

    def __init__(self, designs: Sequence[Design]) -> None:
        postures = np.array([each.point.q for each in designs])
        self._postures, self._span = postures, NEAR * np.maximum(np.ptp(postures, axis=0), LEAST_SPAN)
        speeds = np.array([each.point.speed for each in designs])
        self._ways, self._least = np.sign(speeds), np.min(np.abs(speeds), axis=0)
        self._parts = tuple(np.array(part) for part in zip(*(each.matrices for each in designs), strict=True))

    def at(self, q: Array, speed: Array) -> Matrices:
        """The matrices in a posture (n,) at speeds (a,) of the actuators."""
        way = np.clip(speed / self._least, -1.0, 1.0)
        far = (np.sum(((q - self._postures) / self._span) ** 2, axis=1)
               + np.sum(((way - self._ways) / OTHER_WAY) ** 2, axis=1))
        weight = np.exp(-(far - far.min()) / 2)
        return Matrices(*(np.tensordot(weight / weight.sum(), part, axes=1) for part in self._parts))


def design(point: Point, valves: Valves, bandwidth: Array, noise: Array) -> Design:
    """Regulator and Kalman filter by their Riccati equations (Åström and Wittenmark 1997).

    The weights are those with which an axis that is a pure integrator gets the position gain
    `BANDWIDTH_SHARE`·`bandwidth`, and `INTEGRAL_RATIO` as the ratio of integral time and time constant.

    Args:
        point: of the motion.
        valves: as the controller knows them.
        bandwidth: of the axes (m,) [1/s].
        noise: (n + a + 1,) standard deviations of the readings of q, forces and supply pressure; infinite for what
            the filter does not read.
    """
    axes, n, plant = Axes(valves.plant), len(point.q), point.system
    A, C, size = plant.A, plant.C, len(plant.A)
    slopes = valves.slopes(point.speed, point.length, point.pressure, point.supply)
    # the feedback of the supply pressure to the commands is part of the plant
    B = plant.B * slopes.speed
    A = A + plant.B @ np.outer(slopes.supply, C[-1])
    to_axes = axes.slopes(point.lever_arm) @ C[:n]
    # a shared joint moves at the speeds of all its actuators together
    moved, wanted = np.linalg.norm(axes.shares(point.lever_arm), axis=0), BANDWIDTH_SHARE * bandwidth
    weights = block_diag((moved * wanted)[:, None] * to_axes, np.diag(moved * wanted**2 / INTEGRAL_RATIO))
    K, _, _ = control.dlqr(A, B, weights.T @ weights, np.eye(B.shape[1]), integral_action=plant.dt * to_axes)
    # the errors of the demanded forces drift; readings show them, commands do not answer to them; of a force that is
    # not measured there is none, since nothing would show it
    a, shown = B.shape[1], np.isfinite(noise[n:-1]).astype(float)
    A, C = block_diag(A, np.diag(shown)), np.hstack([C, np.vstack([np.zeros((n, a)), np.eye(a), np.zeros((1, a))])])
    B, K = np.vstack([B, np.zeros((a, a))]), np.hstack([K[:, :size], np.zeros((a, a)), K[:, size:]])
    drift = shown * FORCE_DRIFT * PRESSURE * np.array([each.areas[0] for each in valves.plant.actuators])
    disturbed = np.hstack([B * np.abs(point.speed), np.diag([*np.full(size, PROCESS_NOISE), *drift])])
    # outputs are scaled by the standard deviations of their noise; what is not measured is left out
    measured = np.isfinite(noise)
    L = np.zeros((size + a, len(noise)))
    scaled = C[measured] / noise[measured, None]
    gain, _, _ = control.dlqr(A.T, scaled.T, disturbed @ disturbed.T, np.eye(len(scaled)))  # of the dual system
    L[:, measured] = gain.T / noise[measured]
    errors = (f"{each.actuator.name}.force_error" for each in valves.plant.actuators)
    return Design(point, Matrices(A, B, C, K, L), tuple(f"{name}_estimated" for name in (*plant.state_labels, *errors)))


def reading_noise(plant: Plant) -> Array:
    """Standard deviations (n + a + 1,) of the readings of q, forces and supply pressure; infinite for what is not
    read.

    The supply's pressure is not: a motion draws it down by more than deviations from the motion do, and the inversion
    of the valves answers to it.
    """
    machine = plant.machine
    found = [reading_std(machine, f"{joint}.q") for joint in machine.joints]
    for each in plant.actuators:
        found.append(float(np.linalg.norm([area * reading_std(machine, name, LEAST_PRESSURE) for area, name in
                                           zip(each.areas, each.chambers, strict=True)]))
                     if each.actuator.measured else np.inf)
    return np.array([*found, np.inf])


class Lqg:
    """LQG control: speeds v = v_r − K·x̂ − K_i·∫e, with x̂ the Kalman filter's estimate of the deviations of all states.

    The gains are those of `Schedule` at the reference's posture and speeds; commands are computed from speeds as in the
    cascade.
    """

    def __init__(self, valves: Valves, demand: Demand, designs: Sequence[Design], period: float) -> None:
        self.valves, self.demand, self.schedule, self.period = valves, demand, Schedule(designs), period
        self.axes = Axes(valves.plant)
        self._position = self.axes.positions(demand.q, demand.length)
        self._states = [*designs[0].states, *(f"{name}.integral" for name in self.axes.names)]
        self.reset()

    def reset(self) -> None:
        """Return to the initial state."""
        self._state = np.zeros(len(self._states))

    def command(self, k: int, reading: Reading) -> Array:
        """Commands (a,) at sample k from the readings."""
        demand, preview = self.demand, self.demand.preview
        matrices = self.schedule.at(demand.q[k], preview.speed[k])
        F, G = matrices.regulator(self.period)
        command, opening = self.valves.command(
            preview.speed[k] - matrices.feedback @ self._state, preview.force_rate[k], preview.length[k],
            preview.pressure[k], reading.supply)
        error = self.axes.positions(reading.q, reading.length) - self._position[k]
        off = [reading.q - demand.q[k], reading.force - demand.measured_force[k], [0.0],
               np.where(self.axes.open(opening), error, 0.0)]
        self._state = F @ self._state + G @ np.concatenate(off)
        return command

    def linear(self, point: Point) -> StateSpace:
        """The linearised controller, with the gains that it has at the point: from q, forces and supply pressure to
        commands."""
        (a, n), matrices = point.lever_arm.shape, self.schedule.at(point.q, point.speed)
        slopes = self.valves.slopes(point.speed, point.length, point.pressure, point.supply)
        F, G = matrices.regulator(self.period)
        along = np.hstack([self.axes.slopes(point.lever_arm), np.zeros((len(self.axes.names), a + 1))])
        D = np.hstack([np.zeros((a, n + a)), slopes.supply[:, None]])
        return control.ss(F, G @ np.vstack([np.eye(n + a + 1), along]), -slopes.speed[:, None] * matrices.feedback, D,
                          self.period, states=signals(self._states), inputs=readings(self.axes.plant),
                          outputs=signals(self.axes.plant.inputs))
