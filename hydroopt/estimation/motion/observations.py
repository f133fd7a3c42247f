"""Readings that the motion must explain: channels sampled together, with their noise and what is not counted."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hydroopt.logs.any_log import AnyLog
from hydroopt.logs.log import Log
from hydroopt.logs.readings import reading
from hydroopt.machine.machine import Machine
from hydroopt.spatial.inertia import Array

MOTION = ("q", "qd", "qdd", "length", "gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z", "roll", "pitch",
          "x", "y", "z")
"""Endings of the channels that tell the motion."""
DERIVED = ("qd", "qdd", "roll", "pitch")
"""Endings of those that a unit may have derived from others, by filters of its own: they count where the machine file
states their accuracy."""
FULL = 0.999
"""Part of a sensor's range beyond which it counts as saturated."""


@dataclass(frozen=True, eq=False)
class Observations:
    """Channels sampled together.

    Attributes:
        name: of the log.
        t: (N,) times [s], or numbers of postures.
        channels: their names.
        values: (N, m) in SI.
        sigma: (m,) standard deviation of one reading.
        used: (N, m) False where there is no reading, or none that counts.
        biased: (m,) standard deviation of a constant bias; 0 where there is none.
        delay: standard deviation [s] of how much later than stamped the readings were taken; 0 where they were not.
        drift: standard deviation of the relative error of their clock; 0 where it has none.
    """

    name: str
    t: Array
    channels: tuple[str, ...]
    values: Array
    sigma: Array
    used: NDArray[np.bool_]
    biased: Array
    delay: float = 0.0
    drift: float = 0.0

    def thinned(self, keep: NDArray[np.bool_]) -> Observations:
        """Those of some samples (N,)."""
        return replace(self, t=self.t[keep], values=self.values[keep], used=self.used[keep])


def motion_channels(machine: Machine, log: AnyLog) -> tuple[str, ...]:
    """The channels of a log that tell the machine's motion."""
    known = machine.channel_units
    tips = machine.calibrator is not None and machine.tracker is not None and not machine.calibrator.links
    calibrator = {link.name for link in machine.calibrator.links} if machine.calibrator else set()
    return tuple(channel for channel in log.channels
                 if channel in known and channel.rpartition(".")[2] in MOTION
                 and (channel.rpartition(".")[2] not in DERIVED or machine.sensor(channel))
                 and channel.partition(".")[0] not in calibrator and (tips or not channel.startswith("tip.")))


def observations(machine: Machine, log: Log) -> Observations:
    """What a log tells of the motion."""
    channels = motion_channels(machine, log)
    values = np.column_stack([reading(machine, log, channel) for channel in channels]) if channels else np.zeros(
        (log.size, 0))
    sigma = np.array([_sigma(machine, channel, values[:, k]) for k, channel in enumerate(channels)])
    limits, biases = np.full(len(channels), np.inf), np.zeros(len(channels))
    for imu in machine.imus:
        for channel in set(imu.channels) & set(channels):
            part = imu.part(channel)
            assert part is not None
            biases[channels.index(channel)] = part.bias
            limits[channels.index(channel)] = np.inf if part.range is None else part.range
    used = np.isfinite(values) & (np.abs(values) < FULL * limits)
    return Observations(log.path or log.name, log.t, channels, np.where(used, values, 0.0), sigma, used, biases)


def _sigma(machine: Machine, channel: str, values: Array) -> float:
    """Standard deviation of a reading: stated, or by its fourth differences, which hardly hold motion."""
    sensor = machine.sensor(channel)
    if sensor is not None and sensor.std > 0:
        return sensor.std
    rough = np.diff(values[np.isfinite(values)], 4)
    size = float(np.median(np.abs(rough))) / 0.6745 / np.sqrt(70) if rough.size else 0.0
    return max(size, 1e-6)
