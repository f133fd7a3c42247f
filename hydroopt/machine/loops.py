"""Loops and couplings, which determine the dependent joints of a tree of links."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar, Literal

from pydantic import Field

from hydroopt.machine.quantity import ImpossibleError, Length, Lengths, Noun, Part, Position, Ratio


class SharedPin(Noun):
    """A pin of a link."""

    link: str
    """The link, or `base`."""
    pin: Lengths
    """Its place (3,) in that link's frame P_i (or the base frame)."""


class Loop(Part):
    """A link is held at a pin of another one, for which joints depend.

    By a `pin` it turns about an axis: two equations, in the loop's plane. By a `ball` it is held in space: three
    equations. A rigid `rod` with a ball at each end keeps the distance of both: one equation.
    """

    kind: ClassVar = "loop"
    link: str
    """The link that is held."""
    pin: Lengths | None = None
    """Point (3,) of it that is held; its far end if not stated."""
    to: SharedPin
    """The pin of the other link."""
    closed_by: Literal["pin", "ball", "rod"] = "pin"
    """How it is held."""
    length: Length | None = Field(None, gt=0)
    """Length of the rod."""
    posture: dict[str, Position] = Field(min_length=1)
    """In which of several ways the loop is assembled: positions of the joints that it follows, and roughly where
    dependent joints stand then."""

    def _mistakes(self) -> Iterator[ImpossibleError]:
        if (self.closed_by == "rod") != (self.length is not None):
            yield ImpossibleError("a rod has a length, a pin or ball has none",
                                  "state 'closed_by = \"rod\"' with its 'length', or neither", "length")

    @property
    def equations(self) -> int:
        """How many joints it determines."""
        return {"pin": 2, "ball": 3, "rod": 1}[self.closed_by]

    @property
    def place(self) -> str:
        """Place in the machine file."""
        return f"loops[{self.name}]"


class Coupling(Part):
    """position of `joint` = Σ ratio · position of another joint + `offset`: by chains, belts, gears, racks.

    One of its joints is dependent and follows from the others.
    """

    kind: ClassVar = "coupling"
    equations: ClassVar = 1
    joint: str
    """The joint on the left."""
    ratios: dict[str, Ratio] = Field(min_length=1)
    """Position of `joint` per position of each other joint: 1 between joints of one kind, m/rad or rad/m between one
    that slides and one that turns."""
    offset: Position = 0.0
    """Position of `joint` where all others are zero."""

    @property
    def joints(self) -> tuple[str, ...]:
        """All joints that it relates."""
        return (self.joint, *self.ratios)

    @property
    def place(self) -> str:
        """Place in the machine file."""
        return f"couplings[{self.name}]"


Statement = Loop | Coupling
