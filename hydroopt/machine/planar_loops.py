"""Planar loops that a pin closes, in closed form: two joints that turn, or one that turns and one that slides.

Bars of lengths r₁ and r₂ of a *dyad* meet at a pin, and the vector w = u₁ + u₂ between their other ends is a function
of the joints before. With L² = w·w

    u₁ = a·w + h·w⊥,   a = (L² + r₁² − r₂²) / 2L²,   h = ±√(r₁²/L² − a²).

Seen from where the turning joint of a *slider* sits, the line of the sliding one is a + s·e with |e| = 1, and the pin
lies on it at the distance r from the turning joint's axis:

    s = −a·e ± √(r² − (e × a)²).

The line turns with the joint (a sleeve on a lever), and then |a + s·e| reaches to a given pin; or it stands still and
the joint turns a bar of length r whose end lies on it (a slider crank). All vectors (2,) [m] are in the plane of the
first joint, seen from where it sits.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import casadi as ca

from hydroopt.machine.closures import Closure
from hydroopt.machine.geometry import Geometry
from hydroopt.machine.loops import Loop
from hydroopt.machine.quantity import longer_than_machines
from hydroopt.spatial.poses import rotation_z


class Dyad(NamedTuple):
    """Two bars of a loop.

    Attributes:
        span: w, from the axis of the first joint to the far end of the second bar.
        squares: r₁² and r₂² [m²].
        zeros: directions of the bars where their joints stand at zero: of the first in its seat, of the second relative
            to the first bar, or in its own seat if both bars are not on one side of the pin.
        seat: x and y axis (2, 2) of the second joint's seat, if they are not.
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


class _Slider(NamedTuple):
    """A line and a bar: `at` and `along` are a and e, `reach` is what turns by the first joint and ends at the pin that
    it stands at zero for, None where this is the line; `sign` is that of s as the sliding joint moves."""

    at: ca.SX
    along: ca.SX
    bar: ca.SX | None
    pin: ca.SX
    sign: int


class PlanarAssembly(NamedTuple):
    """A planar closure as it is assembled; `branch` is ±1, the sign of the root."""

    closure: Closure
    branch: int

    def solved(self, geometry: Geometry, q: Mapping[str, Any]) -> tuple[dict[str, Any], ca.SX]:
        """Positions of its joints from those before, by name, and a sine, see `GeneralAssembly.solved`: that of the
        angle between the bars, or between the bar and the normal of the line."""
        first, second = self.closure.joints
        if geometry.machine.turns(second):
            made = self.dyad(geometry, q)
            found = self.bars(made)
            return (dict(zip(self.closure.joints, angles(made, found), strict=True)),
                    found.across / ca.sqrt(made.squares[0] * made.squares[1]))
        line = self._slider(geometry, q)
        square = ca.sumsqr(line.pin)
        root = self.branch * ca.sqrt(square - _cross(line.along, line.at)**2)
        shift = root - ca.dot(line.at, line.along)
        pin = line.at + shift * line.along
        turned = _angle(pin, line.pin) if line.bar is None else _angle(line.bar, pin)
        return {first: turned, second: line.sign * shift}, root / ca.sqrt(square)

    def why_open(self, geometry: Geometry, q: Mapping[str, Any]) -> str:
        """Why it cannot close at positions, in words."""
        if not geometry.machine.turns(self.closure.joints[1]):
            line = self._slider(geometry, q)
            return (f"its bar reaches {float(ca.norm_2(line.pin)):.3f} m, its line is "
                    f"{abs(float(_cross(line.along, line.at))):.3f} m away")
        made = self.dyad(geometry, q)
        one, other, apart = (float(ca.sqrt(square)) for square in (*made.squares, ca.sumsqr(made.span)))
        return (f"its bars span {abs(one - other):.3f} to {one + other:.3f} m, their ends are {apart:.3f} m apart"
                f"{longer_than_machines(max(one, other, apart))}")

    def dead(self, geometry: Geometry) -> str:
        """What happens at a dead point, in words."""
        first, second = self.closure.joints
        return (f"'{first}' and '{second}' lie in one line" if geometry.machine.turns(second) else
                f"the bar about '{first}' stands across the line of '{second}'")

    def _ends(self, geometry: Geometry) -> tuple[tuple[str, ca.SX], tuple[str, ca.SX]]:
        """The loop's ends, each with its link: first the one that the first joint carries."""
        (loop,) = self.closure.statements
        assert isinstance(loop, Loop)
        own, target = zip((loop.link, loop.to.link), geometry.loop_ends(loop), strict=True)
        return (own, target) if self.closure.joints[0] in geometry.machine.ancestry(loop.link) else (target, own)

    def dyad(self, geometry: Geometry, q: Mapping[str, Any]) -> Dyad:
        """The bars at joint positions by name; only those that move its span are used."""
        first, second = self.closure.joints
        carrier, value = geometry.machine.link(second).parent, geometry.value
        (own_link, own), (far_link, far) = self._ends(geometry)
        if first in geometry.machine.ancestry(second):
            span = geometry.from_seat(first, far_link, q).point(far)
            seat = geometry.between(first, carrier) @ geometry.seat(second)
            inner, outer = seat.origin, geometry.between(second, own_link).point(own)
            after = _product(seat.rotation[:2, 0], _turned_to(outer, value[f"{second}.theta"]))
            zeros = _turned_to(inner, value[f"{first}.theta"]), _product(_conjugate(_unit(inner[:2])), after)
            return Dyad(span[:2], (ca.sumsqr(inner[:2]), ca.sumsqr(outer[:2])), zeros, None)
        inner, outer = geometry.between(first, own_link).point(own), geometry.between(second, far_link).point(far)
        seat = geometry.from_seat(first, carrier, q) @ geometry.seat(second)
        zeros = _turned_to(inner, value[f"{first}.theta"]), _turned_to(outer, value[f"{second}.theta"])
        return Dyad(seat.origin[:2], (ca.sumsqr(inner[:2]), ca.sumsqr(outer[:2])), zeros, seat.rotation[:2, :2])

    def bars(self, made: Dyad) -> Bars:
        """Both bars; their cross product is not a number where the loop cannot close."""
        square, (r1, r2) = ca.sumsqr(made.span), made.squares
        along = (square + (r1 - r2)) / (2 * square)
        aside = self.branch * ca.sqrt(r1 / square - along**2)
        first = along * made.span + aside * ca.vertcat(-made.span[1], made.span[0])
        return Bars(first, made.span - first, -aside * square)

    def _slider(self, geometry: Geometry, q: Mapping[str, Any]) -> _Slider:
        turns, line = self.closure.joints
        q = {**q, turns: 0.0, line: 0.0}
        here, there = (geometry.from_seat(turns, link, q).point(end)[:2] for link, end in self._ends(geometry))
        along = geometry.from_seat(turns, line, q).rotation[:2, 2]
        if turns in geometry.machine.ancestry(line):
            return _Slider(here, along, None, there, 1)
        # where the sliding joint carries the turning one, the pin moves the other way as seen from there
        return _Slider(there, along, here, here, -1 if line in geometry.machine.ancestry(turns) else 1)


def angles(made: Dyad, found: Bars) -> tuple[ca.SX, ca.SX]:
    """Positions [rad] of the first and the second joint of a dyad."""
    relative = (ca.vertcat(ca.dot(found.first, found.second), found.across) if made.seat is None else
                made.seat.T @ -found.second)
    return _angle(made.zeros[0], found.first), _angle(made.zeros[1], relative)


def _unit(vector: ca.SX) -> ca.SX:
    if isinstance(vector, ca.DM) and float(vector[1]) == 0:  # along x this is exact, and costs no operations later
        return ca.DM([1 if float(vector[0]) > 0 else -1, 0])
    return vector / ca.norm_2(vector)


def _turned_to(bar: ca.SX, theta: Any) -> ca.SX:
    """Direction of a bar (3,) of a link whose joint stands at zero, seen from the joint's seat."""
    return _unit(rotation_z(theta)[:2, :2] @ bar[:2])


def _product(a: ca.SX, b: ca.SX) -> ca.SX:
    """Of two vectors the one whose angle is the sum of theirs."""
    return ca.vertcat(a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0])


def _conjugate(a: ca.SX) -> ca.SX:
    return ca.vertcat(a[0], -a[1])


def _cross(a: ca.SX, b: ca.SX) -> ca.SX:
    return a[0] * b[1] - a[1] * b[0]


def _angle(zero: ca.SX, vector: ca.SX) -> ca.SX:
    """Angle [rad] from a direction to a vector."""
    turned = _product(_conjugate(zero), vector)
    return ca.atan2(turned[1], turned[0])
