"""From the independent joints q to all joints of the tree: which loop determines which joints, in closed form.

A planar loop whose two dependent joints are connected by rigid bars is a dyad: bars of lengths r₁ and r₂ meet at a pin,
and the vector w = u₁ + u₂ between their other ends is a function of the joints before. With L² = w·w

    u₁ = a·w + h·w⊥,   a = (L² + r₁² − r₂²) / 2L²,   h = ±√(r₁²/L² − a²).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from hydroopt.machine.geometry import Geometry
from hydroopt.machine.loops import Closure, closures
from hydroopt.machine.machine import Machine
from hydroopt.machine.quantity import ImpossibleError
from hydroopt.spatial.poses import rotation_z

NEAR, WITHIN = 0.5, np.radians(45.0)
"""A posture tells how a loop is assembled if it is nearer to one of the two ways than this part of the distance to the
other, and than this angle [rad]."""


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


def dyad(geometry: Geometry, closure: Closure, q: Mapping[str, Any]) -> Dyad:
    """The bars of a loop at joint positions by name; only those that move its span are used."""
    first, second, loop = closure.first, closure.second, closure.loop
    on_link = first in geometry.machine.ancestry(loop.link)
    ends = {True: (loop.link, geometry.far_end(loop.link).origin), False: (loop.to.link, geometry.point(loop.name))}
    carrier = geometry.machine.link(second).parent
    if closure.serial:
        target_link, target = ends[not on_link]
        span = geometry.from_seat(first, target_link, q).point(target)
        seat = geometry.between(first, carrier) @ geometry.seat(second)
        end_link, end = ends[on_link]
        inner, outer = seat.origin, geometry.between(second, end_link).point(end)
        after = _product(seat.rotation[:2, 0], _turned_to(outer, geometry.value[f"{second}.theta"]))
        zeros = _turned_to(inner, geometry.value[f"{first}.theta"]), _product(_conjugate(_unit(inner[:2])), after)
        return Dyad(span[:2], (ca.sumsqr(inner[:2]), ca.sumsqr(outer[:2])), zeros, None)
    own_link, own = ends[on_link]
    far_link, far = ends[not on_link]
    inner, outer = (geometry.between(first, own_link).point(own), geometry.between(second, far_link).point(far))
    seat = (geometry.from_seat(first, carrier, q) @ geometry.seat(second))
    zeros = (_turned_to(inner, geometry.value[f"{first}.theta"]), _turned_to(outer, geometry.value[f"{second}.theta"]))
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
    return _angle(made.zeros[0], found.first), _angle(made.zeros[1], relative)


class Mechanism:
    """The loops of a machine, each with the way in which it is assembled.

    Attributes:
        closures: see `hydroopt.machine.loops.closures`.
        branches: the sign of h of each, as its posture states it.

    Raises:
        ImpossibleError: a posture does not tell which way a loop is assembled.

    >>> from hydroopt.machine.machine_file import load_machine
    >>> Mechanism(load_machine("cat215b")).closures
    ()
    """

    def __init__(self, machine: Machine) -> None:
        self._machine = machine
        self.closures = closures(machine.links, machine.loops)
        self.branches: tuple[int, ...] = ()
        for closure in self.closures:
            self.branches += (_branch(self, Geometry(machine), closure),)

    def positions(self, geometry: Geometry, q: Mapping[str, Any]) -> dict[str, Any]:
        """Positions of all moving joints of the tree by name, from those of the independent ones.

        Loops that follow a joint that `q` leaves out are left out too.
        """
        found = dict(q)
        for closure, branch in zip(self.closures, self.branches, strict=False):  # its own branches while it is made
            if not all(joint in q for joint in closure.follows):
                continue
            made = dyad(geometry, closure, found)
            found[closure.first], found[closure.second] = angles(made, bars(made, branch))
        return found

    def sines(self, geometry: Geometry, q: Mapping[str, Any]) -> list[ca.SX]:
        """Sine of the angle between the bars of each loop: zero at a dead point, not a number where it cannot close."""
        at, found = self.positions(geometry, q), []
        for closure, branch in zip(self.closures, self.branches, strict=True):
            made = dyad(geometry, closure, at)
            found.append(bars(made, branch).sine(made))
        return found

    def turned_round(self, geometry: Geometry, joint: str, other: str, value: float) -> Mechanism | None:
        """The mechanism in which a joint of q follows a dependent one that follows it alone; None if there is none.

        It is assembled as this one is where `joint` stands at `value`.
        """
        at = {name: float(each) for name, each in self.positions(geometry, {joint: ca.DM(value)}).items()}
        flags = {joint: True, other: False}
        links = tuple(link.model_copy(update={"joint": link.joint.model_copy(update={"dependent": flags[link.name]})})
                      if link.name in flags else link for link in self._machine.links)
        loops = tuple(loop.model_copy(update={"posture": at}) for loop in self._machine.loops
                      if self._follows(loop.name) == (joint,))
        try:
            return Mechanism(self._machine.model_copy(update={"links": links, "loops": loops}))
        except ImpossibleError:  # not in a closed form
            return None

    def _follows(self, loop: str) -> tuple[str, ...]:
        return next(closure.follows for closure in self.closures if closure.loop.name == loop)


def _branch(before: Mechanism, geometry: Geometry, closure: Closure) -> int:
    """The sign of h with which a loop comes nearer to its stated posture."""
    loop, where = closure.loop, f"loops[{closure.loop.name}].posture"
    own = (closure.first, closure.second)
    known = {*closure.follows, *own}
    for joint in loop.posture:
        if joint not in known:
            raise ImpossibleError(f"the posture of '{loop.name}' names '{joint}', which its loop does not move",
                                  f"use {', '.join(sorted(known))}", where)
    missing = [joint for joint in closure.follows if joint not in loop.posture]
    stated = [joint for joint in own if joint in loop.posture]
    if missing or not stated:
        raise ImpossibleError(f"the posture of '{loop.name}' does not state "
                              f"{', '.join(missing) or f'where {own[0]} or {own[1]} stands then'}",
                              "state one posture: the joints that the loop follows, and about where a dependent one "
                              "stands", where)
    q = {joint: ca.DM(loop.posture[joint]) for joint in closure.follows}
    made = dyad(geometry, closure, before.positions(geometry, q))
    at = ", ".join(f"{joint} = {np.degrees(loop.posture[joint]):.1f} deg" for joint in closure.follows)
    turned = {}
    for branch in (1, -1):
        found = dict(zip(own, (float(angle) for angle in angles(made, bars(made, branch))), strict=True))
        turned[branch] = found
    if not all(np.isfinite(angle) for found in turned.values() for angle in found.values()):
        raise ImpossibleError(f"the loop '{loop.name}' cannot close in its own posture, {at}: {gap(made)}",
                              "correct its pins and lengths, or the posture", where)
    far = {branch: max(abs(_wrapped(found[joint] - loop.posture[joint])) for joint in stated)
           for branch, found in turned.items()}
    best = min(far, key=lambda branch: far[branch])
    if far[best] > min(NEAR * far[-best], WITHIN):
        ways = " or ".join(", ".join(f"{joint} = {np.degrees(found[joint]):.1f} deg" for joint in stated)
                           for found in turned.values())
        raise ImpossibleError(f"the posture of '{loop.name}' is not near one of the two ways to assemble it: at {at} "
                              f"stands {ways}", "state the one that the machine has", where)
    return best


def gap(made: Dyad) -> str:
    """Between which distances two bars close, in words."""
    first, second = (float(ca.sqrt(square)) for square in made.squares)
    return (f"its bars span {abs(first - second):.3f} to {first + second:.3f} m, their ends are "
            f"{float(ca.norm_2(made.span)):.3f} m apart")


def _wrapped(angle: float) -> float:
    return float(np.arctan2(np.sin(angle), np.cos(angle)))


def _unit(vector: ca.SX) -> ca.SX:
    # of a bar along x this is exact, and costs no operations later
    return vector / ca.norm_2(vector) if not (along := _along_x(vector)) else ca.DM([along, 0])


def _along_x(vector: ca.SX) -> int:
    if not isinstance(vector, ca.DM) or float(vector[1]) != 0:
        return 0
    return 1 if float(vector[0]) > 0 else -1


def _turned_to(bar: ca.SX, theta: Any) -> ca.SX:
    """Direction of a bar (3,) of a link whose joint stands at zero, seen from the joint's seat."""
    return _unit(rotation_z(theta)[:2, :2] @ bar[:2])


def _product(a: ca.SX, b: ca.SX) -> ca.SX:
    """Of two vectors (2,) the one whose angle is the sum of theirs."""
    return ca.vertcat(a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0])


def _conjugate(a: ca.SX) -> ca.SX:
    return ca.vertcat(a[0], -a[1])


def _angle(zero: ca.SX, vector: ca.SX) -> ca.SX:
    """Angle [rad] from a direction to a vector, both (2,)."""
    turned = _product(_conjugate(zero), vector)
    return ca.atan2(turned[1], turned[0])
