"""Readings of one actuator between two gaps of a log: motion, pressures, supply, and how far each may err."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hydroopt.errors import ProblemError
from hydroopt.logs.joint_angles import angle_noise, measured_angles
from hydroopt.logs.log import Log
from hydroopt.logs.readings import bridged, reading
from hydroopt.logs.smoothing import Motion, SmoothingSpline, condition
from hydroopt.machine.actuators import Cylinder
from hydroopt.model.plant import Plant
from hydroopt.spatial.inertia import Array

QUANTITIES = ("length", "p_a", "p_b", "p_supply", "p_tank")
"""What is read at each sample: a cylinder's length or the angle of a motor's joint, pressures of both chambers, supply
and tank."""
PIECE = 0.005
"""Duration [s] of the pieces of an interval over which flows are integrated, at most."""


@dataclass(frozen=True, eq=False)
class Readings:
    """One actuator over N samples without a gap.

    Attributes:
        t: (N,) times [s].
        times: (N - 1, parts) when each piece of an interval begins [s].
        command: (N,) given at the samples, before it arrives.
        values: (N, 5) the `QUANTITIES`.
        variance: (N, 5) of their errors, which differ at every sample.
        chambers: whose pressures are read, 0 or 1 or both.
        begin: first interval that counts: before, the spool's place may still be another than its first command's.
        lever: (N, g) change of the length per standard deviation of each uncertain number of the geometry; none where
            the length itself is read.
    """

    t: Array
    times: Array
    command: Array
    values: Array
    variance: Array
    chambers: tuple[int, ...]
    begin: int
    lever: Array

    @cached_property
    def dt(self) -> Array:
        """(N - 1,) durations of the intervals [s]."""
        return np.diff(self.t)

    @property
    def used(self) -> int:
        """Number of intervals that count."""
        return len(self.dt) - self.begin

    @property
    def balances(self) -> int:
        """Number of balances: one for each chamber that is read in each interval that counts."""
        return self.used * len(self.chambers)


def pieces(t: Array) -> Array:
    """(N - 1, parts) beginnings of an even number of pieces, the same in all intervals of the times (N,)."""
    dt = np.diff(t)
    parts = 2 * max(1, int(np.ceil(float(np.median(dt)) / PIECE / 2 - 1e-6)))
    return np.asarray(t[:-1, None] + dt[:, None] * np.arange(parts) / parts)


class MotionReadings:
    """The motion in samples without a gap; nothing is computed before it is asked for."""

    def __init__(self, plant: Plant, log: Log) -> None:
        self.plant, self.log = plant, log

    @cached_property
    def q(self) -> Array:
        """(N, n) joint positions as read."""
        return measured_angles(self.plant.model, self.log)

    @cached_property
    def smooth(self) -> Motion:
        """The motion up to the machine's bandwidth."""
        machine, log = self.plant.machine, self.log
        return condition(log.t, self.q, log.segment, SmoothingSpline(bandwidth=machine.bandwidth),
                         names=machine.joints, where=log.path or log.name)

    def length(self, actuator: int) -> tuple[Array, Array, Array]:
        """A cylinder's length (N,), or the angle of a motor's joint; its variance; what the geometry may change.

        A length that is logged is taken as it is; lever arms are then of no account. Otherwise the joints' angles give
        it by the geometry.
        """
        plant, log, each = self.plant, self.log, self.plant.actuators[actuator].actuator
        channel = f"{each.name}.length"
        if isinstance(each, Cylinder) and channel in log.channels:
            sensor = plant.machine.sensor(channel)
            std = sensor.std if sensor else 0.0
            return bridged(reading(plant.machine, log, channel)), np.full(log.size, std**2), np.zeros((log.size, 0))
        noise = angle_noise(plant.model, log)
        arms = np.asarray(plant.transmission.map(log.size)(self.q.T)).T.reshape(log.size, -1, len(plant.actuators))
        spread = arms[:, :, actuator] * np.where(np.any(arms[:, :, actuator], axis=0), noise, 0.0)
        if not np.all(np.isfinite(spread)):
            raise ProblemError(f"no accuracy is stated for the angles that give the length of '{each.name}'",
                               where=f"machine '{plant.machine.name}'", remedy="state it in [[sensors]]")
        length = np.asarray(plant.actuator_motion.map(log.size)(self.q.T, 0 * self.q.T)[0])[actuator]
        return length, np.sum(spread**2, axis=1), np.zeros((log.size, 0))

    def pressure(self, actuator: int, channel: str) -> Array:
        """(N,) a pressure that the log lacks: what the nominal force leaves for it beside the other chamber's."""
        plant, each = self.plant, self.plant.actuators[actuator]
        model, place = plant.model, plant.machine.actuators.index(each.actuator)
        known = next(other for other in each.chambers if other in self.log.channels)
        extra = [np.zeros((self.log.size, len(plant.machine.actuators)))] if model.needs_pressure else []
        motion = self.smooth
        force = model.over(model.inverse_dynamics, motion.q, motion.qd, motion.qdd, *extra,
                           model.parameters.nominal)[0][:, place, 0]
        factors = each.actuator.effort_factors
        other = bridged(reading(plant.machine, self.log, known))
        return np.maximum((force - factors[known] * other) / factors[channel], 0.0)
