"""A joint that turns and one that slides: where a loop holds a pin on a line, in closed form.

Seen from where the turning joint sits, the line is a + s·e with |e| = 1, and the pin lies on it at the distance r from
the turning joint's axis:

    s = −a·e ± √(r² − (e × a)²).

The line turns with the joint (a sleeve on a lever), and then |a + s·e| reaches to a given pin; or it stands still and
the joint turns a bar of length r whose end lies on it (a slider crank).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import casadi as ca

from hydroopt.machine.assembly import Solved
from hydroopt.machine.closures import SliderClosure
from hydroopt.machine.geometry import Geometry
from hydroopt.machine.plane import angle_between


class Slider(NamedTuple):
    """A line and a bar in the plane of the turning joint, all vectors (2,) [m] seen from where this joint sits.

    Attributes:
        at, along: a and e.
        bar: where the joint stands at zero: the bar; of a line that is `carried`, not needed.
        square: r² [m²].
        sign: of s, as the sliding joint moves.
        target: the pin that a carried line reaches to.
    """

    at: ca.SX
    along: ca.SX
    bar: ca.SX | None
    square: ca.SX
    sign: int
    target: ca.SX | None


def slider(geometry: Geometry, closure: SliderClosure, q: Mapping[str, Any]) -> Slider:
    """Line and bar of a loop at joint positions by name; its own joints count as zero."""
    loop, turns, slides = closure.loop, closure.turns, closure.slides
    q = {**q, turns: 0.0, slides: 0.0}
    on_link = turns in geometry.machine.ancestry(loop.link)
    ends = dict(zip((True, False), zip((loop.link, loop.to.link), geometry.loop_ends(loop), strict=True), strict=True))
    (own_link, own), (far_link, far) = ends[on_link], ends[not on_link]
    here = geometry.from_seat(turns, own_link, q).point(own)[:2]
    there = geometry.from_seat(turns, far_link, q).point(far)[:2]
    along = geometry.from_seat(turns, slides, q).rotation[:2, 2]
    if closure.carried:
        return Slider(here, along, None, ca.sumsqr(there), 1, there)
    # where the sliding joint carries the turning one, the pin moves the other way as seen from there
    return Slider(there, along, here, ca.sumsqr(here), -1 if closure.serial else 1, None)


class SliderAssembly(NamedTuple):
    """A slider as it is assembled; `branch` is ±1, the sign of the root."""

    closure: SliderClosure
    branch: int

    def solved(self, geometry: Geometry, q: Mapping[str, Any]) -> Solved:
        """Positions of its joints, from those before."""
        made = slider(geometry, self.closure, q)
        aside = made.along[0] * made.at[1] - made.along[1] * made.at[0]
        root = self.branch * ca.sqrt(made.square - aside**2)
        shift = root - ca.dot(made.at, made.along)
        pin = made.at + shift * made.along
        turned = angle_between(pin, made.target) if made.bar is None else angle_between(made.bar, pin)
        return Solved({self.closure.turns: turned, self.closure.slides: made.sign * shift},
                      root / ca.sqrt(made.square))

    def why_open(self, geometry: Geometry, q: Mapping[str, Any]) -> str:
        """How far the line is away and the bar reaches, in words."""
        made = slider(geometry, self.closure, q)
        aside = abs(float(made.along[0] * made.at[1] - made.along[1] * made.at[0]))
        return f"its bar reaches {float(ca.sqrt(made.square)):.3f} m, its line is {aside:.3f} m away"

    @property
    def dead(self) -> str:
        """What happens at a dead point, in words."""
        return f"the bar about '{self.closure.turns}' stands across the line of '{self.closure.slides}'"
