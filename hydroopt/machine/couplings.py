"""Couplings: linear relations between positions of joints, by chains, belts, gears, racks and parallelograms."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pydantic import Field

from hydroopt.machine.quantity import Name, Noun, Position, Ratio


class Coupling(Noun):
    """position of `joint` = Σ ratio · position of another joint + `offset`.

    One of its joints is dependent and follows from the others.
    """

    name: Name
    """Name of the coupling."""
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

    def determined(self, joint: str, position: Callable[[str], Any], value: Callable[[str], Any], *,
                   offset: bool = True) -> Any:
        """Position of one of its joints from those of the others; without `offset` it is the same of rates.

        Args:
            joint: which one follows from the others.
            position: position or rate of each other joint by name.
            value: the coupling's numbers by their keys, ``offset`` and ``ratio.JOINT``.
        """
        total = value("offset") if offset else 0.0
        for other in self.ratios:
            if other != joint:
                total += value(f"ratio.{other}") * position(other)
        return total if joint == self.joint else (position(self.joint) - total) / value(f"ratio.{joint}")
