"""Two joints that turn and are connected by rigid bars: where a loop holds them, in closed form.

Bars of lengths r₁ and r₂ meet at a pin, and the vector w = u₁ + u₂ between their other ends is a function of the joints
before. With L² = w·w

    u₁ = a·w + h·w⊥,   a = (L² + r₁² − r₂²) / 2L²,   h = ±√(r₁²/L² − a²).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import casadi as ca

from hydroopt.machine.assembly import Solved
from hydroopt.machine.closures import DyadClosure
from hydroopt.machine.geometry import Geometry
from hydroopt.machine.plane import angle_between, conjugate, product, turned_to, unit
from hydroopt.machine.quantity import longer_than_machines


class Dyad(NamedTuple):
    """Two bars of a loop in the plane of the first joint, all vectors (2,) [m] seen from where this joint sits.

    Attributes:
        span: w, from the axis of the first joint to the far end of the second bar.
        squares: r₁² and r₂² [m²].
        zeros: directions of the bars where their joints stand at zero: of the first in its seat, of the second relative
            to the first bar, or in its own seat if the loop is not serial.
        seat: x and y axis (2, 2) of the second joint's seat, if the loop is not serial.
    """

    span: ca.SX
    squares: tuple[Any, Any]
    zeros: tuple[ca.SX, ca.SX]
    seat: ca.SX | None


class Bars(NamedTuple):
    """Both bars u₁ and u₂ (2,) [m] of a dyad, and u₁ × u₂ [m²]."""

    first: ca.SX
    second: ca.SX
    across: ca.SX

    def sine(self, of: Dyad) -> ca.SX:
        """Sine of the angle between both bars."""
        return self.across / ca.sqrt(of.squares[0] * of.squares[1])


def dyad(geometry: Geometry, closure: DyadClosure, q: Mapping[str, Any]) -> Dyad:
    """The bars of a loop at joint positions by name; only those that move its span are used."""
    first, second, loop = closure.first, closure.second, closure.loop
    on_link = first in geometry.machine.ancestry(loop.link)
    own_end, target_end = geometry.loop_ends(loop)
    ends = {True: (loop.link, own_end), False: (loop.to.link, target_end)}
    carrier = geometry.machine.link(second).parent
    if closure.serial:
        target_link, target = ends[not on_link]
        span = geometry.from_seat(first, target_link, q).point(target)
        seat = geometry.between(first, carrier) @ geometry.seat(second)
        end_link, end = ends[on_link]
        inner, outer = seat.origin, geometry.between(second, end_link).point(end)
        after = product(seat.rotation[:2, 0], turned_to(outer, geometry.value[f"{second}.theta"]))
        zeros = turned_to(inner, geometry.value[f"{first}.theta"]), product(conjugate(unit(inner[:2])), after)
        return Dyad(span[:2], (ca.sumsqr(inner[:2]), ca.sumsqr(outer[:2])), zeros, None)
    own_link, own = ends[on_link]
    far_link, far = ends[not on_link]
    inner, outer = (geometry.between(first, own_link).point(own), geometry.between(second, far_link).point(far))
    seat = (geometry.from_seat(first, carrier, q) @ geometry.seat(second))
    zeros = (turned_to(inner, geometry.value[f"{first}.theta"]), turned_to(outer, geometry.value[f"{second}.theta"]))
    return Dyad(seat.origin[:2], (ca.sumsqr(inner[:2]), ca.sumsqr(outer[:2])), zeros, seat.rotation[:2, :2])


def bars(made: Dyad, branch: int) -> Bars:
    """Both bars; `branch` is ±1, the sign of h. Their cross product is not a number where the loop cannot close."""
    square, (r1, r2) = ca.sumsqr(made.span), made.squares
    along = (square + (r1 - r2)) / (2 * square)
    aside = branch * ca.sqrt(r1 / square - along**2)
    first = along * made.span + aside * ca.vertcat(-made.span[1], made.span[0])
    return Bars(first, made.span - first, -aside * square)


def angles(made: Dyad, found: Bars) -> tuple[ca.SX, ca.SX]:
    """Positions [rad] of the first and the second dependent joint."""
    if made.seat is None:
        relative = ca.vertcat(ca.dot(found.first, found.second), found.across)
    else:
        relative = made.seat.T @ -found.second
    return angle_between(made.zeros[0], found.first), angle_between(made.zeros[1], relative)


class DyadAssembly(NamedTuple):
    """A dyad as it is assembled; `branch` is ±1, the sign of h."""

    closure: DyadClosure
    branch: int

    def solved(self, geometry: Geometry, q: Mapping[str, Any]) -> Solved:
        """Positions of its joints, from those before."""
        made = dyad(geometry, self.closure, q)
        found = bars(made, self.branch)
        return Solved(dict(zip(self.closure.joints, angles(made, found), strict=True)), found.sine(made))

    def why_open(self, geometry: Geometry, q: Mapping[str, Any]) -> str:
        """Between which distances its bars close, in words."""
        made = dyad(geometry, self.closure, q)
        first, second = (float(ca.sqrt(square)) for square in made.squares)
        apart = float(ca.norm_2(made.span))
        return (f"its bars span {abs(first - second):.3f} to {first + second:.3f} m, their ends are {apart:.3f} m apart"
                f"{longer_than_machines(max(first, second, apart))}")

    @property
    def dead(self) -> str:
        """What happens at a dead point, in words."""
        return f"'{self.closure.first}' and '{self.closure.second}' lie in one line"
