"""Linear quadratic Gaussian control about points of a motion: state feedback, Kalman filter and integral action."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_discrete_are

from hydroopt.control.axes import Axes
from hydroopt.control.linear_system import LinearSystem
from hydroopt.control.reference import Demand
from hydroopt.control.sampled_plant import Point, Reading
from hydroopt.control.tuning import INTEGRAL_RATIO
from hydroopt.control.valve_inversion import Valves
from hydroopt.machine.machine import Machine
from hydroopt.model.plant import Plant
from hydroopt.spatial.inertia import Array

BANDWIDTH_SHARE = 0.7
"""Bandwidth of the regulator as a part of the cascade's position gain, since resonances change with the posture."""
PROCESS_NOISE = 1e-2
"""Standard deviation of the process noise of every state per sample, as a part of its typical size."""
DEFAULT_NOISE = 1e-4
"""Standard deviation of the measurement noise where no sensor is stated, as a part of the typical size."""


class Design(NamedTuple):
    """Gains for deviations from a point of the motion.

    Attributes:
        point: the operating point.
        A, B, C: of the sampled plant, its inputs being the demanded speeds.
        feedback: speeds per state and per integral of the axes' errors.
        filter: states per innovation, Kalman's gain for the state at the next sample.
    """

    point: Point
    A: Array
    B: Array
    C: Array
    feedback: Array
    filter: Array


def design(plant: LinearSystem, point: Point, valves: Valves, bandwidth: Array, noise: Array) -> Design:
    """Regulator and Kalman filter by their Riccati equations (Åström and Wittenmark 1997).

    The weights are those with which an axis that is a pure integrator gets the position gain
    `BANDWIDTH_SHARE`·`bandwidth`, and `INTEGRAL_RATIO` as the ratio of integral time and time constant.

    Args:
        plant: sampled about the point, with delays; its states are scaled.
        point: of the motion.
        valves: as the controller knows them.
        bandwidth: of the axes (m,) [1/s].
        noise: (n + a + 1,) standard deviations of the readings of q, forces and supply pressure.
    """
    axes, n, m, period = Axes(valves.plant), len(point.q), len(bandwidth), plant.period
    A, C, size = plant.A, plant.C, len(plant.A)
    slopes = valves.slopes(point.speed, point.length, point.pressure, point.supply)
    # the feedback of the supply pressure to the commands is part of the plant
    B = plant.B * slopes.speed
    A = A + plant.B @ np.outer(slopes.supply, C[-1])
    to_axes = axes.slopes(point.lever_arm) @ C[:n]
    both = np.block([[A, np.zeros((size, m))], [period * to_axes, np.eye(m)]])
    driven = np.vstack([B, np.zeros((m, B.shape[1]))])
    # a shared joint moves at the speeds of all its actuators together
    moved, wanted = np.linalg.norm(axes.shares(point.lever_arm), axis=0), BANDWIDTH_SHARE * bandwidth
    weights = np.vstack([np.hstack([(moved * wanted)[:, None] * to_axes, np.zeros((m, m))]),
                         np.hstack([np.zeros((m, size)), np.diag(moved * wanted**2 / INTEGRAL_RATIO)])])
    K = regulator(both, driven, weights.T @ weights)
    disturbed = np.hstack([B * np.abs(point.speed), PROCESS_NOISE * np.eye(size)])
    # outputs are scaled by the standard deviations of their noise
    L = regulator(A.T, (C / noise[:, None]).T, disturbed @ disturbed.T).T
    return Design(point, A, B, C, K, L / noise)


def regulator(A: Array, B: Array, Q: Array) -> Array:
    """Feedback K (m, n) of x⁺ = A·x + B·u for which the sum of x'·Q·x + u'·u is least."""
    P = solve_discrete_are(A, B, Q, np.eye(B.shape[1]))
    return np.asarray(np.linalg.solve(np.eye(B.shape[1]) + B.T @ P @ B, B.T @ P @ A))


def reading_noise(plant: Plant) -> Array:
    """Standard deviations (n + a + 1,) of the readings of q, forces and supply pressure; infinite for what is not
    measured."""
    machine, found = plant.machine, []
    for joint in machine.joints:
        found.append(_std(machine, f"{joint}.q", DEFAULT_NOISE))
    for each in plant.actuators:
        found.append(float(np.linalg.norm([area * _std(machine, name, 1e7 * DEFAULT_NOISE) for area, name in
                                           zip(each.areas, each.chambers, strict=True)]))
                     if each.actuator.measured else np.inf)
    return np.array([*found, _std(machine, "pump.p_supply", 1e7 * DEFAULT_NOISE)])


def _std(machine: Machine, channel: str, without: float) -> float:
    sensor = machine.sensor(channel)
    if sensor is None:
        return without
    return max(sensor.std, without)


class Lqg:
    """LQG control: speeds v = v_r − K·x̂ − K_i·∫e, with x̂ the Kalman filter's estimate of the deviations of all states.

    The gains are those of the nearest point in time; commands are computed from speeds as in the cascade.
    """

    def __init__(self, valves: Valves, demand: Demand, designs: Sequence[Design], nearest: Sequence[int],
                 period: float) -> None:
        self.valves, self.demand, self.designs, self.nearest, self.period = valves, demand, designs, nearest, period
        self.axes = Axes(valves.plant)
        self._position = self.axes.positions(demand.q, demand.length)
        self.reset()

    def reset(self) -> None:
        """Return to the initial state."""
        self._state = np.zeros(len(self.designs[0].A))
        self._integral = np.zeros(len(self.axes.names))

    def command(self, k: int, reading: Reading) -> Array:
        """Commands (a,) at sample k from the readings."""
        preview, active = self.demand.preview, self.designs[self.nearest[k]]
        size = len(self._state)
        speed = -active.feedback[:, :size] @ self._state - active.feedback[:, size:] @ self._integral
        command, opening = self.valves.command(preview.speed[k] + speed, preview.force_rate[k], preview.length[k],
                                               preview.pressure[k], reading.supply)
        readings = np.array([*(reading.q - self.demand.q[k]), *(reading.force - self.demand.measured_force[k]),
                         reading.supply[0] - active.point.supply[0]])
        self._state = active.A @ self._state + active.B @ speed + active.filter @ (readings - active.C @ self._state)
        error = self.axes.positions(reading.q, reading.length) - self._position[k]
        self._integral += np.where(self.axes.open(opening), self.period * error, 0.0)
        return command

    def linear(self, point: Point) -> LinearSystem:
        """The linearised controller: from q, forces and supply pressure to commands.

        The gains are those of the point with the same directions of motion, if there is one, that is nearest in
        posture.
        """
        active = min(self.designs, key=lambda d: (int(np.sum(np.sign(d.point.speed) != np.sign(point.speed))),
                                               float(np.linalg.norm(d.point.q - point.q))))
        (a, m), n, size = self.axes.shares(point.lever_arm).shape, len(point.q), len(active.A)
        slopes = self.valves.slopes(point.speed, point.length, point.pressure, point.supply)
        by_speed = np.diag(slopes.speed)
        A = np.block([[active.A - active.filter @ active.C - active.B @ active.feedback[:, :size],
                       -active.B @ active.feedback[:, size:]],
                      [np.zeros((m, size)), np.eye(m)]])
        along = self.period * self.axes.slopes(point.lever_arm)
        B = np.vstack([active.filter, np.hstack([along, np.zeros((m, a + 1))])])
        D = np.hstack([np.zeros((a, n + a)), slopes.supply[:, None]])
        return LinearSystem(A, B, -by_speed @ active.feedback, D, self.period)
