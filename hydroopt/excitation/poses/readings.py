"""What can be read in a pose, and how many minutes it takes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from hydroopt.model.closed_chain import KinematicModel

DRIVE = 2.0
"""Minutes to drive to a posture and come to rest."""
SHOT, TAPE, TOUCH, BY_ITSELF = 0.5, 1.0, 0.5, 0.0
"""Minutes to sight a target, to hold a tape, to set a target down on a datum, and of sensors that are mounted."""
SET_UP = {"instrument": 15.0, "datum": 5.0, "tape": 2.0, "imu": 15.0, "transducer": 0.0, "calibrator": 60.0}
"""Minutes before the first reading: to set up an instrument or a tracker, to lay out a datum, to fetch a tape, to mount
an IMU, to attach a calibrator."""


@dataclass(frozen=True)
class Reading:
    """One reading of a pose.

    Attributes:
        name: of its measurement: ``station.prism``, ``tape``, ``boom_cylinder.length``, ``tip``.
        channels: of the pose table.
        minutes: that it takes; 0 for what reads by itself.
        kind: what it is taken with, a key of `SET_UP`.
    """

    name: str
    channels: tuple[str, ...]
    minutes: float
    kind: str

    @property
    def owner(self) -> str:
        """The instrument, tape, datum, IMU or cylinder that it belongs to."""
        return self.name.partition(".")[0]

    @property
    def by_hand(self) -> bool:
        """Whether somebody must take it."""
        return self.minutes > 0

    def __str__(self) -> str:
        return f"{self.name} ({self.minutes:g} min)"


def readings(model: KinematicModel, channels: Sequence[str]) -> tuple[Reading, ...]:
    """What the machine file lets one read in a pose, of the channels that have a sensor; joints' own sensors are no
    reading: they read in every pose."""
    machine = model.machine
    kinds = {each.name: (kind, spent) for kind, parts, spent in (
        ("instrument", machine.instruments, SHOT), ("tape", machine.distances, TAPE), ("datum", machine.datums, TOUCH),
        ("imu", machine.imus, BY_ITSELF)) for each in parts}
    found = []
    for name in (f"{cylinder.name}.length" for cylinder in machine.cylinders):
        sensor = machine.sensor(name)
        rated = sensor is not None and sensor.rate is not None
        found.append(Reading(name, (name,), TAPE, "transducer" if rated else "tape"))
    if machine.tracker:
        found.append(Reading("tip", tuple(f"tip.{axis}" for axis in "xyz"), SHOT, "instrument"))
    for each in model.measurements:
        kind, spent = kinds.get(each.name.partition(".")[0], ("transducer", BY_ITSELF))
        found.append(Reading(each.name, each.channels, spent, kind))
    return tuple(each for each in found if set(each.channels) <= set(channels))
