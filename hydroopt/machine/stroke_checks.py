"""Whether strokes cover the whole range of the joints: all that do not are named in one refusal."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from hydroopt.machine.actuators import Cylinder
from hydroopt.machine.quantity import ImpossibleError, longer_than_machines
from hydroopt.spatial.cylinder_triangle import Triangle
from hydroopt.spatial.inertia import Array

ROUNDING = 1e-9
"""Length [m] that a stroke may lack."""


ROOM = 195
"""Characters of a sentence for cylinders that it names; those beyond are counted."""
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
    def said(self) -> str:
        """What it needs and what it can do."""
        needed, possible = (f"{least:.3f} to {most:.3f} m" for least, most in (self.needed, self.possible))
        return f"'{self.name}' needs {needed}, not {possible}"


def by_triangle(cylinder: Cylinder, joint: str, sides: Triangle, limits: tuple[float, float],
                hint: str) -> ShortStroke | None:
    """What a cylinder on one revolute joint lacks, exactly; `hint` says what else may be wrong.

    Raises:
        ImpossibleError: it fits at no position of the joint.
    """
    fixed, moving, offset, lateral = (float(v) for v in sides)
    shortest, longest = (np.hypot(fixed + sign * moving, lateral) for sign in (-1, 1))
    retracted, extended = possible(cylinder)
    lower, upper = limits
    # in between, a length is longest or shortest at the dead points
    first = np.ceil((lower + offset) / np.pi)
    angles = np.array([lower, upper, *(np.arange(first, (upper + offset) / np.pi) * np.pi - offset)])
    lengths = np.sqrt(fixed**2 + moving**2 + lateral**2 - 2 * fixed * moving * np.cos(angles + offset))
    if retracted > longest or extended < shortest:
        raise ImpossibleError(
            f"the triangle of '{cylinder.name}' is open at every {joint}: its pins can be {shortest:.3f} to "
            f"{longest:.3f} m apart, the cylinder {retracted:.3f} to {extended:.3f} m long",
            f"correct its pins, dead length or stroke (the joint's range takes {lengths.min():.3f} to "
            f"{lengths.max():.3f} m pin to pin){longer_than_machines(max(longest, extended))}{hint}")
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
    each = [one.said for one in short]
    named = [text for k, text in enumerate(each) if k == 0 or len(", ".join(each[:k + 1])) <= ROOM]
    more = f" and {len(each) - len(named)} more" if len(each) > len(named) else ""
    raise ImpossibleError(f"strokes do not cover the joints' ranges: {', '.join(named)}{more}",
                          "correct lengths, strokes, pins or limits")
