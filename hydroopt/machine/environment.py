"""Supply and surroundings of a machine: pump, footprint, workspace, obstacles."""

from __future__ import annotations

from typing import Self

import numpy as np
from pydantic import Field, model_validator

from hydroopt.machine.quantity import (
    Flow,
    ImpossibleError,
    Length,
    Lengths,
    Mass,
    Name,
    Noun,
    Pressure,
    Volume,
    refuse_inverted,
)


class Pump(Noun):
    """The supply that all actuators share: together they take no more than `max_flow` [m³/s], if that is stated.

    It keeps `pressure`, against `tank_pressure`, as long as that flow suffices. With the `volume` of the line behind it
    the supply's pressure gives way within a few percent when much is drawn, and falls when more is; without, it is the
    same whatever is drawn.
    """

    max_flow: Flow | None = Field(None, gt=0)
    pressure: Pressure | None = Field(None, gt=0)
    tank_pressure: Pressure = Field(0.0, ge=0)
    volume: Volume | None = Field(None, gt=0)

    @model_validator(mode="after")
    def _whole(self) -> Self:
        if self.max_flow is None and (self.pressure is None or self.volume is not None):
            raise ImpossibleError("the flow of the pump is not stated", "state it" if self.pressure else
                                  "state it, or its 'pressure'", "max_flow")
        if self.pressure is not None and self.pressure <= self.tank_pressure:
            raise ImpossibleError("the supply's pressure is not above the tank's", "exchange or correct them",
                                  "pressure")
        return self


class Workspace(Noun):
    """Where the far end of the last link may go: between `lower` and `upper` (3,) [m] in the base frame."""

    lower: Lengths
    upper: Lengths

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        refuse_inverted("workspace", self.lower, self.upper)
        return self


class Obstacle(Noun):
    """A ball about `centre` (3,) [m] in the frame of a link or of the base, which the far end of the last link avoids.

    A cab that swings with its machine is attached to the swinging link.
    """

    name: Name
    link: Name
    centre: Lengths
    radius: Length = Field(gt=0)


class Footprint(Noun):
    """What the machine stands on: corners (x, y) [m] of the tracks or outriggers in the base frame, at ground height.

    `mass` and `com` (3,) [m] are those of the chassis below the first joint, in the base frame.
    """

    corners: tuple[tuple[Length, Length], ...] = Field(min_length=3)
    mass: Mass = Field(ge=0)
    com: Lengths

    @model_validator(mode="after")
    def _convex(self) -> Self:
        points = np.array(self.corners)
        edges = np.roll(points, -1, axis=0) - points
        following = np.roll(edges, -1, axis=0)
        if not np.all(edges[:, 0] * following[:, 1] - edges[:, 1] * following[:, 0] > 0):
            raise ImpossibleError("the corners do not go round counter-clockwise, or not round a convex area",
                                  "list them counter-clockwise as seen from above")
        return self
