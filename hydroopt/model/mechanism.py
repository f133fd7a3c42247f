"""Motion of all joints of the tree from that of the independent ones: what loops and couplings determine, with rates.

With the angles α₁, α₂ of a dyad's bars (`hydroopt.machine.planar_loops`) and the rate of the span w between their ends

    ẇ = α̇₁·u₁⊥ + α̇₂·u₂⊥,   ẅ + α̇₁²·u₁ + α̇₂²·u₂ = α̈₁·u₁⊥ + α̈₂·u₂⊥.

Rates of any other loop follow from its equations c = 0 by implicit differentiation: with J the derivative of c by the
dependent joints x, J·ẋ is what the joints before leave of ċ, and J·ẍ what they and ẋ leave of c̈.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple, TypeVar

import casadi as ca

from hydroopt.machine.closures import Closure
from hydroopt.machine.general_loops import closure_equations
from hydroopt.machine.geometry import Geometry
from hydroopt.machine.mechanism import Assembly, Mechanism
from hydroopt.machine.planar_loops import Bars, PlanarAssembly, angles
from hydroopt.model.kinematics import Coordinates, rate

Parts = TypeVar("Parts")
JointMotion = dict[str, tuple[ca.SX, ca.SX, ca.SX]]
"""Position, rate and acceleration of joints by name."""


class TreeMotion(NamedTuple):
    """Motion of all moving joints of the tree, in the order of ``machine.tree_joints``.

    Expressions of the tree are built from `symbols`, in which nothing depends on anything; `closed` replaces those of
    dependent joints by what loops and couplings make of the independent ones, `values`. `sines` are those of
    `hydroopt.machine.mechanism.Mechanism.sines`, in the independent joints.
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
    mechanism = Mechanism(machine)
    if not mechanism.assemblies:
        return TreeMotion(independent, independent)
    given = {joint: tuple(column[k] for column in independent) for k, joint in enumerate(machine.joints)}
    symbols = {joint: given.get(joint) or tuple(ca.SX.sym(f"{joint}{dots}") for dots in ("", "_d", "_dd"))
               for joint in machine.tree_joints}
    tree = _stacked(symbols)
    values = dict(symbols)
    for assembly in mechanism.assemblies:
        # in terms of the tree, where a loop may follow the joints of another one, which is closed before
        values |= TreeMotion(tree, _stacked(values)).closed(_joint_motion(geometry, assembly, tree))
    at = dict(zip(machine.joints, ca.vertsplit(independent.q), strict=True))
    return TreeMotion(tree, _stacked(values), tuple(mechanism.sines(geometry, at)))


def _stacked(joints: Mapping[str, tuple[ca.SX, ...]]) -> Coordinates:
    return Coordinates(*(ca.vertcat(*column) for column in zip(*joints.values(), strict=True)))


def _joint_motion(geometry: Geometry, assembly: Assembly, tree: Coordinates) -> JointMotion:
    """Position, rate and acceleration of a closure's dependent joints."""
    if isinstance(assembly, PlanarAssembly) and geometry.machine.turns(assembly.closure.joints[1]):
        return _dyad_motion(geometry, assembly, tree)
    names, own = geometry.machine.tree_joints, assembly.closure.joints
    q = dict(zip(names, ca.vertsplit(tree.q), strict=True))
    places = [names.index(joint) for joint in own]
    equations = closure_equations(geometry, assembly.closure.statements, q)
    before = Coordinates(*(ca.SX(column) for column in tree))
    before.qd[places] = before.qdd[places] = 0
    found = [ca.vertcat(*(ca.SX(assembly.solved(geometry, q)[0][joint]) for joint in own))]
    J = ca.jacobian(equations, tree.q[places])
    speed = rate(equations, tree)
    # with the rates before alone, then with all rates and the accelerations before alone
    first = ca.jtimes(equations, tree.q, before.qd)
    second = ca.jtimes(speed, ca.vertcat(tree.q, tree.qd), ca.vertcat(tree.qd, before.qdd))
    for left in (first, second):
        found.append(ca.solve(J, -left))
        known = [tree.q[places], tree.qd[places]][:len(found) - 1]
        found[-1] = ca.substitute(found[-1], ca.vertcat(*known), ca.vertcat(*found[:-1]))
    return {joint: (found[0][k], found[1][k], found[2][k]) for k, joint in enumerate(own)}


def _dyad_motion(geometry: Geometry, assembly: PlanarAssembly, tree: Coordinates) -> JointMotion:
    (one, other), names = assembly.closure.joints, geometry.machine.tree_joints
    made = assembly.dyad(geometry, dict(zip(names, ca.vertsplit(tree.q), strict=True)))
    found = assembly.bars(made)
    speed = rate(made.span, tree)
    first, second = _turns(found, speed)
    drawn = rate(speed, tree) + first**2 * found.first + second**2 * found.second
    first_rate, second_rate = _turns(found, drawn)
    # the second joint turns against the first bar, or against its seat
    against = (first, first_rate)
    if made.seat is not None:
        against = _seat_turn(geometry, assembly.closure, tree)
    q = angles(made, found)
    return {one: (q[0], first, first_rate), other: (q[1], second - against[0], second_rate - against[1])}


def _turns(found: Bars, rates: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Rates of both bars that move the end of the second one as stated."""
    return ca.dot(rates, found.second) / found.across, -ca.dot(rates, found.first) / found.across


def _seat_turn(geometry: Geometry, closure: Closure, tree: Coordinates) -> tuple[ca.SX, ca.SX]:
    """Rate and acceleration at which the second joint's seat turns against the first one's."""
    machine = geometry.machine
    here, there = (machine.link(name).parent for name in closure.joints)
    total = [ca.SX(0), ca.SX(0)]
    for joint in machine.joints_between(here, there):
        if not machine.turns(joint):
            continue
        sign, k = (1 if joint in machine.ancestry(there) else -1), machine.tree_joints.index(joint)
        total = [total[0] + sign * tree.qd[k], total[1] + sign * tree.qdd[k]]
    return total[0], total[1]
