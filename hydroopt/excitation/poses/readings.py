"""What can be read in a pose, and how many minutes it takes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from hydroopt.model.closed_chain import KinematicModel

DRIVE = 2.0
"""Minutes to drive to a posture and come to rest."""
SHOT, TAPE, TOUCH, BY_ITSELF = 0.5, 1.0, 0.5, 0.0
"""Minutes to sight a target, to hold a tape, to set a target down on a datum, and of sensors that are mounted."""


@dataclass(frozen=True)
class Reading:
    """One reading of a pose.

    Attributes:
        name: of its measurement: ``station.prism``, ``tape``, ``boom_cylinder.length``, ``tip``.
        channels: of the pose table.
        minutes: that it takes; 0 for what reads by itself.
    """

    name: str
    channels: tuple[str, ...]
    minutes: float

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
    minutes = {each.name: spent for parts, spent in (
        (machine.instruments, SHOT), (machine.distances, TAPE), (machine.datums, TOUCH)) for each in parts}
    found = [Reading(f"{cylinder.name}.length", (f"{cylinder.name}.length",), TAPE) for cylinder in machine.cylinders]
    if machine.tracker:
        found.append(Reading("tip", tuple(f"tip.{axis}" for axis in "xyz"), SHOT))
    found += [Reading(each.name, each.channels, minutes.get(each.name.partition(".")[0], BY_ITSELF))
              for each in model.measurements]
    return tuple(each for each in found if set(each.channels) <= set(channels))
