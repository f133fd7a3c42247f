"""The closed chain of kinematic calibration: calibrator, fixtures, tracker, distances, stages (chapter 3)."""

from __future__ import annotations

from typing import Self

from pydantic import Field, model_validator

from hydroopt.machine.links import Link
from hydroopt.machine.quantity import Angle, ImpossibleError, Length, Lengths, Name, Noun


class Calibrator(Noun):
    """A sensed linkage from the far end of a machine's link to a ball that sits in a fixture (Section 3.5.1).

    Its links form a serial chain, the first one on the machine's link `parent`. `tip` is the ball's centre (3,)
    [m] in the frame at the far end of the last link. Without links of its own it is a rigid tool with a ball.
    """

    parent: Name
    links: tuple[Link, ...] = ()
    tip: Lengths = (0.0, 0.0, 0.0)

    @model_validator(mode="after")
    def _serial(self) -> Self:
        before = self.parent
        for link in self.links:
            if link.parent != before:
                raise ImpossibleError(f"link '{link.name}' is attached to '{link.parent}', not to '{before}'",
                                      "list a calibrator's links in their order, each on the one before")
            before = link.name
        return self


class Fixture(Noun):
    """A passive ball joint fixed in the base frame (the task of Section 3.3.2): `position` (3,) [m].

    `play` [m] is the standard deviation, in each direction, of the ball's centre in its socket. A fixture that `moves`
    has another position in every stage, and `position` is the initial guess of all of them.
    """

    name: Name
    position: Lengths
    play: Length = Field(0.0, ge=0)
    moves: bool = False


class Tracker(Noun):
    """An instrument that tracks the tip: its position in the base frame (3,) [m], and its roll, pitch, yaw [rad]."""

    position: Lengths = (0.0, 0.0, 0.0)
    orientation: tuple[Angle, Angle, Angle] = (0.0, 0.0, 0.0)


class Distance(Noun):
    """A known distance [m] between two fixtures: it determines the scale of a closed chain (Section 3.6.4)."""

    name: Name
    between: tuple[Name, Name]
    length: Length = Field(gt=0)


class Stage(Noun):
    """Poses measured one after another: which joints move without a sensor, and the approximate angles [rad] of locked
    ones.

    A locked joint keeps its unknown angle in the following stages until one of them moves it. Leaking cylinders let it
    drift linearly during a stage, by an angle with the standard deviation `drift` [rad]. Joints with readings in the
    pose table need not be named.
    """

    name: Name
    moves: tuple[Name, ...] = ()
    locked: dict[Name, Angle] = Field(default_factory=dict)
    drift: Angle = Field(0.0, ge=0)

    @model_validator(mode="after")
    def _one_state(self) -> Self:
        both = sorted(set(self.moves) & set(self.locked))
        if both:
            raise ImpossibleError(f"'{both[0]}' both moves and is locked", "name it once")
        return self
