"""Supply and surroundings of a machine: pump, footprint, workspace, obstacles."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from pydantic import Field

from hydroopt.machine.quantity import (
    Flow,
    ImpossibleError,
    Length,
    Lengths,
    Mass,
    Name,
    Noun,
    Part,
    Pressure,
    Volume,
)

STEEPEST = np.radians(45)
"""Slope from which on the base's z axis does not say what is high."""
CHASSIS = ("footprint.mass", "footprint.com")
"""Paths of the chassis's numbers, whose `sigma` counts in what keeps the machine from tipping over."""


class Pump(Noun):
    """The supply that all actuators share.

    With the `volume` of the line behind it the supply's pressure gives way within a few percent when much is drawn, and
    falls when more is; without, it is the same whatever is drawn.
    """

    max_flow: Flow | None = Field(None, gt=0)
    """What all actuators together take at most."""
    pressure: Pressure | None = Field(None, gt=0)
    """Pressure that it keeps as long as that flow suffices."""
    tank_pressure: Pressure = Field(0.0, ge=0)
    """Pressure in the tank."""
    volume: Volume | None = Field(None, gt=0)
    """Volume of the line behind the pump."""

    def _mistakes(self) -> Iterator[ImpossibleError]:
        if self.max_flow is None and (self.pressure is None or self.volume is not None):
            yield ImpossibleError("the flow of the pump is not stated", "state it" if self.pressure else
                                  "state it, or its 'pressure'", "max_flow")
        if self.pressure is not None and self.pressure <= self.tank_pressure:
            yield ImpossibleError("the supply's pressure is not above the tank's", "exchange or correct them",
                                  "pressure")

class Obstacle(Part):
    """A ball that links and cylinders avoid, but for what is pinned to its link.

    A cab that swings with its machine is attached to the swinging link.
    """

    link: Name
    """Link that carries it, or `base`."""
    centre: Lengths
    """Centre (3,) in that link's frame."""
    radius: Length = Field(gt=0)
    """Radius."""


class Footprint(Noun):
    """What the machine stands on, and the chassis that keeps it from tipping over.

    The chassis counts as exact where no `sigma` of its mass and of its centre of mass is stated.
    """

    corners: tuple[tuple[Length, Length], ...] = Field(min_length=3)
    """Corners (x, y) of tracks or outriggers in the base frame, at ground height."""
    mass: Mass = Field(ge=0)
    """Mass of the chassis below the first joint."""
    com: Lengths
    """Its centre of mass (3,) in the base frame."""

    def _mistakes(self) -> Iterator[ImpossibleError]:
        points = np.array(self.corners)
        edges = np.roll(points, -1, axis=0) - points
        following = np.roll(edges, -1, axis=0)
        if not np.all(edges[:, 0] * following[:, 1] - edges[:, 1] * following[:, 0] > 0):
            yield ImpossibleError("the corners do not go round counter-clockwise, or not round a convex area",
                                  "list them counter-clockwise as seen from above")

    @property
    def middle(self) -> tuple[float, float]:
        """Centre (x, y) of its area [m].

        >>> Footprint(corners=((0, 0), (2, 0), (2, 1), (0, 1)), mass=0, com=(0, 0, 0)).middle
        (1.0, 0.5)
        """
        points = np.array(self.corners)
        after = np.roll(points, -1, axis=0)
        twice = points[:, 0] * after[:, 1] - after[:, 0] * points[:, 1]
        x, y = (twice @ (points + after) / (3 * np.sum(twice))).tolist()
        return x, y
