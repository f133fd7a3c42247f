"""Motion of all joints of the tree from that of the independent ones: loops in closed form, with their rates.

With the angles α₁, α₂ of a loop's bars (`hydroopt.machine.mechanism`) and the rate of the span w between their ends

    ẇ = α̇₁·u₁⊥ + α̇₂·u₂⊥,   ẅ + α̇₁²·u₁ + α̇₂²·u₂ = α̈₁·u₁⊥ + α̈₂·u₂⊥.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple, TypeVar

import casadi as ca

from hydroopt.machine.geometry import Geometry
from hydroopt.machine.loops import Closure
from hydroopt.machine.mechanism import Bars, Mechanism, angles, bars, dyad
from hydroopt.model.kinematics import Coordinates, rate

Parts = TypeVar("Parts")


class TreeMotion(NamedTuple):
    """Motion of all moving joints of the tree, in the order of ``machine.tree_joints``.

    Expressions of the tree are built from `symbols`, in which nothing depends on anything; `closed` replaces those of
    dependent joints by what loops make of the independent ones, `values`. `sines` are those of the angles between the
    bars of each loop, in the independent joints: zero at a dead point, not a number where the loop cannot close.
    """

    symbols: Coordinates
    values: Coordinates
    sines: tuple[ca.SX, ...] = ()

    def closed(self, parts: Parts) -> Parts:
        """The same mappings and tuples of expressions, in the independent joints."""
        if self.symbols is self.values:
            return parts
        flat = [ca.SX(each) for each in _leaves(parts)]
        found = iter(ca.substitute(flat, [ca.vertcat(*self.symbols)], [ca.vertcat(*self.values)]))
        made: Parts = _filled(parts, found)
        return made


def _leaves(parts: Any) -> Iterator[Any]:
    if isinstance(parts, dict | tuple):
        for part in parts.values() if isinstance(parts, dict) else parts:
            yield from _leaves(part)
    else:
        yield parts


def _filled(parts: Any, leaves: Iterator[Any]) -> Any:
    if isinstance(parts, dict):
        return {key: _filled(part, leaves) for key, part in parts.items()}
    if isinstance(parts, tuple):
        made = [_filled(part, leaves) for part in parts]
        return type(parts)(*made) if hasattr(parts, "_fields") else tuple(made)
    return next(leaves)


def tree_motion(geometry: Geometry, independent: Coordinates) -> TreeMotion:
    """Motion of the tree's joints from that of the independent ones, in the order of ``machine.joints``."""
    machine = geometry.machine
    if not machine.loops:
        return TreeMotion(independent, independent)
    mechanism = Mechanism(machine)
    given = {joint: tuple(column[k] for column in independent) for k, joint in enumerate(machine.joints)}
    symbols = {joint: given.get(joint) or tuple(ca.SX.sym(f"{joint}{dots}") for dots in ("", "_d", "_dd"))
               for joint in machine.tree_joints}
    tree = _stacked(symbols)
    values = dict(symbols)
    for closure, branch in zip(mechanism.closures, mechanism.branches, strict=True):
        # in terms of the tree, where a loop may follow the joints of another one, which is closed before
        values |= TreeMotion(tree, _stacked(values)).closed(_joint_motion(geometry, closure, branch, tree))
    at = dict(zip(machine.joints, ca.vertsplit(independent.q), strict=True))
    return TreeMotion(tree, _stacked(values), tuple(mechanism.sines(geometry, at)))


def _stacked(joints: Mapping[str, tuple[ca.SX, ...]]) -> Coordinates:
    return Coordinates(*(ca.vertcat(*column) for column in zip(*joints.values(), strict=True)))


def _joint_motion(geometry: Geometry, closure: Closure, branch: int,
                  tree: Coordinates) -> dict[str, tuple[ca.SX, ca.SX, ca.SX]]:
    """Position, rate and acceleration of a loop's dependent joints."""
    names = geometry.machine.tree_joints
    made = dyad(geometry, closure, dict(zip(names, ca.vertsplit(tree.q), strict=True)))
    found = bars(made, branch)
    speed = rate(made.span, tree)
    first, second = _turns(found, speed)
    drawn = rate(speed, tree) + first**2 * found.first + second**2 * found.second
    first_rate, second_rate = _turns(found, drawn)
    # the second joint turns against the first bar, or against its seat
    against = (first, first_rate)
    if not closure.serial:
        against = _seat_turn(geometry, closure, tree)
    q = angles(made, found)
    return {closure.first: (q[0], first, first_rate),
            closure.second: (q[1], second - against[0], second_rate - against[1])}


def _turns(found: Bars, rates: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Rates of both bars that move the end of the second one as told."""
    return ca.dot(rates, found.second) / found.across, -ca.dot(rates, found.first) / found.across


def _seat_turn(geometry: Geometry, closure: Closure, tree: Coordinates) -> tuple[ca.SX, ca.SX]:
    """Rate and acceleration at which the second joint's seat turns against the first one's."""
    machine = geometry.machine
    here, there = (machine.link(name).parent for name in (closure.first, closure.second))
    total = [ca.SX(0), ca.SX(0)]
    for joint in machine.joints_between(here, there):
        sign, k = (1 if joint in machine.ancestry(there) else -1), machine.tree_joints.index(joint)
        total = [total[0] + sign * tree.qd[k], total[1] + sign * tree.qdd[k]]
    return total[0], total[1]
