"""Whether strokes cover the whole range of the joints: all that do not are named in one refusal."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from hydroopt.machine.actuators import Cylinder
from hydroopt.machine.quantity import ImpossibleError
from hydroopt.spatial.cylinder_triangle import Triangle
from hydroopt.spatial.inertia import Array

ROUNDING = 1e-9
"""Length [m] that a stroke may lack."""


MOST = 3
"""How many a sentence names."""
WIDE = np.radians(120)
"""Range of a joint beyond which a cylinder pinned to the link itself is rare: a rocker and a coupler stand between."""


class ShortStroke(NamedTuple):
    """A cylinder, or a joint that follows others, and what it cannot do.

    Attributes:
        name: of the cylinder or joint.
        length: one that it would have [m], and the place in words.
        place: where it would have it.
        possible: shortest and longest that it can be [m].
        needed: shortest and longest in the whole range of the joints [m].
        hint: what else may be wrong, or empty.
    """

    name: str
    length: float
    place: str
    possible: tuple[float, float]
    needed: tuple[float, float]
    hint: str = ""

    @property
    def lacks(self) -> str:
        """At which ends it does not do, and by how much."""
        long, short = self.possible[0] - self.needed[0], self.needed[1] - self.possible[1]
        return " and ".join(f"{1e3 * by:.0f} mm too {said}" for by, said in
                            ((long, "long retracted"), (short, "short extended")) if by > ROUNDING)


def by_triangle(cylinder: Cylinder, joint: str, sides: Triangle, lower: float, upper: float) -> ShortStroke | None:
    """What a cylinder on one revolute joint lacks, exactly.

    Raises:
        ImpossibleError: it fits at no position of the joint.
    """
    fixed, moving, offset, lateral = (float(v) for v in sides)
    shortest, longest = (np.hypot(fixed + sign * moving, lateral) for sign in (-1, 1))
    retracted, extended = possible(cylinder)
    hint = "; or state a rocker between rod and link by [[linkages]]" if upper - lower > WIDE else ""
    # in between, a length is longest or shortest at the dead points
    first = np.ceil((lower + offset) / np.pi)
    angles = np.array([lower, upper, *(np.arange(first, (upper + offset) / np.pi) * np.pi - offset)])
    lengths = np.sqrt(fixed**2 + moving**2 + lateral**2 - 2 * fixed * moving * np.cos(angles + offset))
    if retracted > longest or extended < shortest:
        raise ImpossibleError(
            f"the triangle of '{cylinder.name}' is open at every {joint}: its pins can be {shortest:.3f} to "
            f"{longest:.3f} m apart, the cylinder {retracted:.3f} to {extended:.3f} m long",
            f"correct its pins, dead length or stroke (the joint's range takes {lengths.min():.3f} to "
            f"{lengths.max():.3f} m pin to pin){hint}")
    short = by_samples(cylinder.name, lengths, lambda k: f"{joint} = {np.degrees(angles[k]):.1f} deg",
                       (retracted, extended))
    return short and short._replace(hint=hint)


def by_samples(name: str, lengths: Array, place: Callable[[int], str],
               can_be: tuple[float, float]) -> ShortStroke | None:
    """What a cylinder or sliding joint lacks at lengths (N,) [m], of which `place` words where each is."""
    beyond = np.flatnonzero((lengths < can_be[0] - ROUNDING) | (lengths > can_be[1] + ROUNDING))
    if not beyond.size:
        return None
    return ShortStroke(name, float(lengths[beyond[0]]), place(int(beyond[0])), can_be,
                       (float(lengths.min()), float(lengths.max())))


def possible(cylinder: Cylinder) -> tuple[float, float]:
    """Shortest and longest that a cylinder can be [m]."""
    return cylinder.dead_length, cylinder.dead_length + cylinder.stroke


def refuse(short: Sequence[ShortStroke]) -> None:
    """Refuse all strokes that are too short in one sentence.

    Raises:
        ImpossibleError: there are any.
    """
    if not short:
        return
    if len(short) == 1:
        (one,) = short
        raise ImpossibleError(
            f"'{one.name}' would be {one.length:.3f} m long at {one.place} but can only be {one.possible[0]:.3f} to "
            f"{one.possible[1]:.3f} m",
            f"correct dead length and stroke (the whole range takes {one.needed[0]:.3f} to {one.needed[1]:.3f} m), "
            f"pins or the joints' limits{one.hint}")
    each = [f"'{one.name}' is {one.lacks} for {one.needed[0]:.3f} to {one.needed[1]:.3f} m" for one in short]
    more = f" and {len(each) - MOST} more" if len(each) > MOST else ""
    raise ImpossibleError(f"strokes do not cover the joints' ranges: {', '.join(each[:MOST])}{more}",
                          "correct lengths, strokes, pins or limits")
