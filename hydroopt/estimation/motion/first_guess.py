"""A first guess of the motion: from sample to sample, by rates ahead and by angles, lengths and inclination back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import LogError
from hydroopt.estimation.motion.observations import Observations
from hydroopt.machine.machine import Machine
from hydroopt.model.sensor_readings import SensorReadings
from hydroopt.spatial.inertia import Array

STEP = 0.1
"""Time [s] over which readings are averaged."""
ACCELERATION = 0.7
"""How much links accelerate [m/s²], which a guess by the inclination of gravity leaves out."""
COARSE = {"q": 0.01, "qd": 0.02, "qdd": 1.0, "length": 0.01, "gyro": 0.02, "accel": ACCELERATION, "roll": 0.05,
          "pitch": 0.05, "x": 0.05, "y": 0.05, "z": 0.05}
"""How much readings may differ from a guess [SI], by the kind of channel."""
RATES = ("qd", "gyro")
"""Kinds of channels that tell speeds."""
DRIFT = 0.02
"""How much a joint's speed by the guess errs [rad/s or m/s]."""
SETTLE = 30
"""Steps towards the first posture."""
LARGEST = 0.3
"""Largest step of a joint in one of them [rad or m]."""


def first_guess(machine: Machine, readings: Mapping[tuple[str, ...], SensorReadings],
                data: Sequence[Observations]) -> tuple[Array, Array]:
    """Times (M,) and joint positions (M, n) over a stretch, by a filter with the nominal geometry.

    Args:
        machine: the machine.
        readings: by channels.
        data: what was read along the stretch; every group of channels by its own stamps.

    Raises:
        LogError: no reading depends on some joint.
    """
    begin, end = min(each.stamped[0] for each in data), max(each.stamped[-1] for each in data)
    count = int((end - begin) / STEP) + 1
    means = [_means(each, begin, count) for each in data]
    parts = [_Part.of(readings[each.channels]) for each in data]
    ranges = np.array([machine.link(joint).joint.range for joint in machine.joints])
    q, spread = ranges.mean(axis=1), np.diag(np.ptp(ranges, axis=1) ** 2)
    speed, depends = np.zeros_like(q), np.zeros(len(q), dtype=bool)
    path = np.empty((count, len(q)))
    for k in range(count):
        ahead = spread + np.eye(len(q)) * (DRIFT * STEP) ** 2
        predicted = q + speed * STEP * (k > 0)
        found = predicted
        for _ in range(SETTLE if k == 0 else 1):
            information, right = np.linalg.inv(ahead), np.linalg.solve(ahead, predicted)
            turning, turned = np.eye(len(q)), np.zeros(len(q))  # speeds are of the order of one
            for part, (values, weight) in zip(parts, means, strict=True):
                state = found[None]
                expected, by_q, by_qd, _, _ = part.made(state, 0 * state, 0 * state, part.g)
                own = weight[k] & np.isfinite(expected[0])
                depends |= np.any(by_q[0] != 0, axis=0) | np.any(by_qd[0] != 0, axis=0)
                left = (values[k] - expected[0]) / part.noise
                placed = own & ~part.rates
                rows = by_q[0][placed] / part.noise[placed, None]
                information += rows.T @ rows
                right += rows.T @ (left[placed] + rows @ found)
                placed = own & part.rates
                rows = by_qd[0][placed] / part.noise[placed, None]
                turning += rows.T @ rows
                turned += rows.T @ left[placed]
            step = np.linalg.solve(information, right) - found
            found = found + np.clip(step, -LARGEST, LARGEST)
        speed = np.linalg.solve(turning, turned)
        q, spread = found, np.linalg.inv(information)
        path[k] = q
    if not depends.all():
        joint = machine.joints[int(np.flatnonzero(~depends)[0])]
        turns = machine.position_unit(joint) == "rad"  # of a joint that slides, an IMU tells accelerations at most
        raise LogError(f"no reading depends on the joint '{joint}'" if turns else
                       f"no reading determines the position of the joint '{joint}', which slides", where=data[0].name,
                       remedy="record its angle, the length of its cylinder, or an IMU on the link that it moves"
                       if turns else "record it, or the length of its cylinder")
    return np.asarray(begin + STEP * (np.arange(count) + 0.5), dtype=np.float64), path


class _Part:
    """Readings of a group, how much they may differ from a guess, and which tell speeds."""

    def __init__(self, made: SensorReadings, noise: Array, rates: Array) -> None:
        self.made, self.noise, self.rates = made, noise, rates.astype(bool)
        self.g = np.array([number.value for number in made.numbers])

    @classmethod
    def of(cls, made: SensorReadings) -> _Part:
        """Of the readings of some channels."""
        kinds = [channel.rpartition(".")[2].partition("_")[0] for channel in made.channels]
        return cls(made, np.array([COARSE[kind] for kind in kinds]), np.array([kind in RATES for kind in kinds]))


def _means(data: Observations, begin: float, count: int) -> tuple[Array, NDArray[np.bool_]]:
    """Means (count, m) over steps of time, and which of them hold a reading."""
    bins = np.minimum(((data.stamped - begin) / STEP).astype(int), count - 1)
    number, total = np.zeros((2, count, len(data.channels)))
    np.add.at(number, bins, data.used)
    np.add.at(total, bins, np.where(data.used, data.values, 0.0))
    held = number > 0
    return np.divide(total, number, out=np.zeros((count, len(data.channels))), where=held), held
