"""Loops: pins, balls and rods that close a linkage beside the joints of the tree."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from hydroopt.machine.quantity import ImpossibleError, Length, Lengths, Name, Noun, Position


class SharedPin(Noun):
    """A pin (3,) [m] of a link, in its frame P_i (or the base frame)."""

    link: str
    pin: Lengths


class Loop(Noun):
    """The far end of `link`, or a `pin` (3,) [m] of it, is held at a pin of another link, for which joints depend.

    By a `pin` it turns about an axis: two equations, in the loop's plane. By a `ball` it is held in space: three
    equations. A rigid rod of a `length` [m] with a ball at each end keeps the distance of both: one equation.

    A loop can be assembled in several ways. `posture` tells which: positions [rad or m] of the joints that the loop
    follows, and roughly where dependent joints stand then.
    """

    name: Name
    link: str
    pin: Lengths | None = None
    to: SharedPin
    closed_by: Literal["pin", "ball", "rod"] = "pin"
    length: Length | None = Field(None, gt=0)
    posture: dict[str, Position] = Field(min_length=1)

    @model_validator(mode="after")
    def _rod_has_a_length(self) -> Self:
        if (self.closed_by == "rod") != (self.length is not None):
            raise ImpossibleError("a rod has a length, a pin or ball has none",
                                  "state 'closed_by = \"rod\"' with its 'length', or neither", "length")
        return self

    @property
    def equations(self) -> int:
        """How many joints it determines."""
        return {"pin": 2, "ball": 3, "rod": 1}[self.closed_by]
