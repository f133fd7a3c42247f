"""Linear quadratic Gaussian control about points of a motion: state feedback, Kalman filter and integral action."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import control
import numpy as np

from hydroopt.control.reference import Demand
from hydroopt.control.sampled_plant import Point, Reading
from hydroopt.control.tuning import SLOWNESS
from hydroopt.control.valve_inversion import Valves
from hydroopt.machine.machine import Machine
from hydroopt.model.plant import Plant
from hydroopt.spatial.inertia import Array

CAUTION = 0.7
"""Part of the cascade's position gain that is aimed at: what a model knows of resonances, postures change."""
UNKNOWN = 1e-2
"""Standard deviation of a disturbance of every state, as a part of its typical size, from sample to sample."""
EXACT = 1e-4
"""Standard deviation of an output for which no sensor is stated, as a part of its typical size."""


class Design(NamedTuple):
    """Gains about a point of the motion, for deviations from it.

    Attributes:
        point: where.
        A, B, C: of the sampled plant, its inputs being the demanded speeds.
        feedback: speeds per state and per integral of the lengths' errors.
        filter: states per innovation, Kalman's gain for the state at the next sample.
    """

    point: Point
    A: Array
    B: Array
    C: Array
    feedback: Array
    filter: Array


def design(plant: control.StateSpace, point: Point, valves: Valves, bandwidth: Array, noise: Array) -> Design:
    """By the Riccati equations of regulator and filter (Åström and Wittenmark 1997).

    Speeds are weighed against lengths so that an actuator which were nothing but an integrator would get the part
    `CAUTION` of the gain `bandwidth`, and against integrals so that these took the cascade's integral time of it.

    Args:
        plant: sampled about the point, with delays; its states are scaled.
        point: of the motion.
        valves: as the controller knows them.
        bandwidth: (n,) [1/s].
        noise: (2·n + 1,) standard deviations of the readings of q, forces and supply pressure.
    """
    n, period = len(bandwidth), float(plant.dt)
    A, C, size = plant.A, plant.C, len(plant.A)
    slopes = valves.slopes(point.speed, point.length, point.pressure, point.supply)
    # what the supply's pressure does to the commands is part of the plant
    B = plant.B * slopes.speed
    A = A + plant.B @ np.outer(slopes.supply, C[-1])
    to_length = point.lever_arm @ C[:n]
    both = np.block([[A, np.zeros((size, n))], [period * to_length, np.eye(n)]])
    driven = np.vstack([B, np.zeros((n, n))])
    weights = np.vstack([np.hstack([CAUTION * bandwidth[:, None] * to_length, np.zeros((n, n))]),
                         np.hstack([np.zeros((n, size)), np.diag((CAUTION * bandwidth) ** 2 / SLOWNESS)])])
    K, _, _ = control.dlqr(both, driven, weights.T @ weights, np.eye(n))
    disturbed = np.hstack([B * np.abs(point.speed), UNKNOWN * np.eye(size)])
    # outputs are counted in standard deviations of their noise
    L, _, _ = control.dlqe(A, disturbed, C / noise[:, None], np.eye(n + size), np.eye(len(noise)))
    return Design(point, A, B, C, np.asarray(K), np.asarray(L) / noise)


def reading_noise(plant: Plant) -> Array:
    """Standard deviations (2·n + 1,) of what q, forces and the supply's pressure are read with."""
    machine, found = plant.machine, []
    for joint in machine.joints:
        found.append(_std(machine, f"{joint}.q", EXACT))
    for each in plant.actuators:
        found.append(float(np.linalg.norm([area * _std(machine, name, 1e7 * EXACT)
                                           for area, name in zip(each.areas, each.chambers, strict=True)])))
    return np.array([*found, _std(machine, "pump.p_supply", 1e7 * EXACT)])


def _std(machine: Machine, channel: str, without: float) -> float:
    sensor = machine.sensor(channel)
    if sensor is None:
        return without
    return max(sensor.std, without)


class Lqg:
    """Speeds v = v_r − K·x̂ − K_i·∫e from the deviations of all states as a Kalman filter sees them.

    The gains are those of the nearest point in time; commands follow from speeds as in the cascade.
    """

    def __init__(self, valves: Valves, demand: Demand, designs: Sequence[Design], nearest: Sequence[int],
                 period: float) -> None:
        self.valves, self.demand, self.designs, self.nearest, self.period = valves, demand, designs, nearest, period
        self.reset()

    def reset(self) -> None:
        """Return to the initial state."""
        self._state = np.zeros(len(self.designs[0].A))
        self._integral = np.zeros(self.demand.length.shape[1])

    def command(self, k: int, reading: Reading) -> Array:
        """Commands (n,) at a sample, as the sensors show the machine."""
        ahead, one = self.demand.ahead, self.designs[self.nearest[k]]
        size = len(self._state)
        speed = -one.feedback[:, :size] @ self._state - one.feedback[:, size:] @ self._integral
        command, opening = self.valves.command(ahead.speed[k] + speed, ahead.force_rate[k], ahead.length[k],
                                               ahead.pressure[k], reading.supply)
        readings = np.array([*(reading.q - self.demand.q[k]), *(reading.force - self.demand.shown[k]),
                         reading.supply[0] - one.point.supply[0]])
        self._state = one.A @ self._state + one.B @ speed + one.filter @ (readings - one.C @ self._state)
        error = reading.length - self.demand.length[k]
        self._integral += np.where(np.abs(opening) < 1, self.period * error, 0.0)
        return command

    def linear(self, point: Point) -> control.StateSpace:
        """Small changes of commands per small changes of q, forces and supply pressure.

        The gains are those of the point that is nearest in posture, among those of the same directions first.
        """
        one = min(self.designs, key=lambda d: (int(np.sum(np.sign(d.point.speed) != np.sign(point.speed))),
                                               float(np.linalg.norm(d.point.q - point.q))))
        n, size = len(point.q), len(one.A)
        slopes = self.valves.slopes(point.speed, point.length, point.pressure, point.supply)
        by_speed = np.diag(slopes.speed)
        A = np.block([[one.A - one.filter @ one.C - one.B @ one.feedback[:, :size], -one.B @ one.feedback[:, size:]],
                      [np.zeros((n, size)), np.eye(n)]])
        B = np.vstack([one.filter, np.hstack([self.period * point.lever_arm, np.zeros((n, n + 1))])])
        D = np.hstack([np.zeros((n, 2 * n)), slopes.supply[:, None]])
        return control.StateSpace(A, B, -by_speed @ one.feedback, D, self.period)
