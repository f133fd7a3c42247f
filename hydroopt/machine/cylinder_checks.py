"""Whether the cylinders of a machine can do their work over the whole range of their joints."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import NamedTuple

import casadi as ca
import numpy as np

from hydroopt.machine import stroke_checks
from hydroopt.machine.actuators import Cylinder, GasCylinder
from hydroopt.machine.closures import DyadClosure, closures
from hydroopt.machine.geometry import Geometry
from hydroopt.machine.loop_checks import FLAT
from hydroopt.machine.machine import Machine
from hydroopt.machine.mechanism import Mechanism
from hydroopt.machine.posture import said_posture
from hydroopt.machine.quantity import ImpossibleError
from hydroopt.machine.springs import Pinned, Spring
from hydroopt.machine.stroke_checks import ShortStroke
from hydroopt.spatial.cylinder_triangle import Triangle
from hydroopt.spatial.evenly_spread import sobol
from hydroopt.spatial.inertia import Array

FEW = 3
"""Up to how many joints are checked on a grid."""
WIDE = np.radians(120)
"""Range of a joint beyond which a cylinder pinned to the link itself is rare: a rocker and a coupler stand between."""
ASIDE = 0.2
"""Part of the shorter distance of a pin from a joint's axis, by which pins apart along the axis are suspicious."""
DRAWN = 12
"""Logarithm to the base 2 of the number of samples of more joints."""


def check(machine: Machine) -> None:
    """Check every cylinder over the range of the joints it moves.

    The triangle must close, the stroke must cover the range, also of cylinders that share oil, and the lever arm must
    keep its sign; of several actuators that are there to move one joint each may pass a dead point, but not all at
    once. Cylinders that only together move several joints, as those of a platform, must do so. For a cylinder on one
    revolute joint this is exact; any other is checked on a grid of its joints, or at samples of them where they are
    more than `FEW`. The volume of a gas cylinder must stay positive and its pins and those of a spring apart, also
    checked on a grid.

    Raises:
        ImpossibleError: names the cylinder, the place and the remedy.
    """
    geometry = Geometry(machine)
    drivers = machine.drivers
    short = list(_slides(geometry))
    for cylinder in machine.cylinders:
        found, main = geometry.triangle(cylinder), machine.main_joint(cylinder)
        alone = len(drivers[main]) == 1 and not any(main in group for group in machine.entangled)
        if found is None or found[0] not in machine.joints:
            short.append(_check_on_grid(geometry, cylinder, alone=alone))
            continue
        joint, sides = found
        hint = _axis_hint(machine, joint, sides) or _rocker_hint(machine, joint)
        if alone:
            _lever_arm_keeps_sign(cylinder, joint, float(sides.offset), machine.link(joint).joint.range, hint)
        short.append(stroke_checks.by_triangle(cylinder, joint, sides, machine.link(joint).joint.range, hint))
    stroke_checks.refuse([one for one in short if one])
    for joint, several in drivers.items():
        cylinders = [each for each in several if isinstance(each, Cylinder) and machine.moved_by(each) == (joint,)]
        if len(several) == len(cylinders) > 1:
            _not_dead_at_once(geometry, joint, cylinders)
    for span in spans(machine):
        if span.angle < FLAT:
            raise ImpossibleError(f"'{span.cylinders[0].name}' and {len(span.cylinders) - 1} more do not hold their "
                                  f"joints at {span.at}, where a motion changes none of their lengths",
                                  "correct their pins or narrow the joints' limits")
    for gas in machine.gas_cylinders:
        _gas_has_room(geometry, gas)
    for spring in machine.springs:
        _apart(geometry, spring)


class Span(NamedTuple):
    """Joints that only several cylinders together move, over their ranges.

    Attributes:
        joints, cylinders: at least as many cylinders as joints.
        angle: least angle [rad] in the ranges between the direction in which one joint changes the lengths and those
            of all others together: the margin to a singular posture. Negative beyond such a posture.
        at: where this is, in words.
    """

    joints: tuple[str, ...]
    cylinders: tuple[Cylinder, ...]
    angle: float
    at: str


def spans(machine: Machine) -> tuple[Span, ...]:
    """Every group of joints that only several cylinders together move, with its margin to a singular posture.

    >>> from hydroopt.machine.machine_file import load_machine
    >>> spans(load_machine("cat215b"))
    ()
    """
    geometry, found = Geometry(machine), []
    for joints in machine.entangled:
        cylinders = tuple(each for each in machine.cylinders if machine.main_joint(each) in joints)
        around = [joint for joint in machine.joints if any(joint in machine.moved_by(each) for each in cylinders)]
        q = ca.SX.sym("q", len(around))
        at = Mechanism(machine).positions(geometry, {joint: q[k] for k, joint in enumerate(around)})
        lengths = ca.vertcat(*(_length(geometry, each, at) for each in cylinders))
        arms = ca.densify(ca.jacobian(lengths, q)[:, [around.index(joint) for joint in joints]])
        states = _samples(machine, around)
        size = len(joints)
        values = np.asarray(ca.Function("arms", [q], [arms]).map(states.shape[1])(states))
        turned = values.reshape(len(cylinders), -1, size).transpose(1, 0, 2)
        norms = np.linalg.norm(turned, axis=1, keepdims=True)
        turned = turned / np.where(norms > 0, norms, 1.0)  # none of the lengths feels a joint with a column of zeros
        if len(cylinders) > size:  # the triangle of the same lengths and angles, whose corner keeps its sign
            corner = np.asarray(np.linalg.qr(turned, mode="r"))
            turned = corner * np.sign(np.diagonal(corner, axis1=1, axis2=2))[:, :, None]
        volumes = np.linalg.det(turned)
        # a row of the inverse has the length of one over the sine of its joint's angle to the others
        usable: Array = np.where((np.abs(volumes) > 1e-12)[:, None, None], turned, np.eye(size))
        sines = 1 / np.max(np.linalg.norm(np.linalg.inv(usable), axis=2), axis=1)
        signed = np.where(np.abs(volumes) > 1e-12, np.sign(volumes) * np.sign(volumes[0]) * sines, 0.0)
        worst = int(np.argmin(signed))
        found.append(Span(joints, cylinders, float(np.arcsin(np.clip(signed[worst], -1, 1))),
                          said_posture(machine, dict(zip(around, states[:, worst].tolist(), strict=True)))))
    return tuple(found)


def _length(geometry: Geometry, part: Pinned, at: Mapping[str, ca.SX]) -> ca.SX:
    return ca.norm_2(geometry.pin(part, "rod", at) - geometry.pin(part, "barrel", at))


def _samples(machine: Machine, joints: Sequence[str]) -> Array:
    """Positions (n, N) of joints over their ranges: a grid, or where they are many mid-range, all corners and Sobol's
    sequence between them."""
    ranges = np.array([machine.link(joint).joint.range for joint in joints])
    if len(joints) <= FEW:
        points = 721 if len(joints) == 1 else 25
        axes = [np.linspace(lower, upper, points) for lower, upper in ranges.tolist()]
        return np.stack([values.ravel() for values in np.meshgrid(*axes, indexing="ij")])
    n = len(joints)
    corners = np.array(np.meshgrid(*[[-1.0, 1.0]] * n, indexing="ij")).reshape(n, -1)
    between = 2 * sobol(n, DRAWN).T - 1
    u = np.hstack([np.zeros((n, 1)), corners, between])
    return np.asarray(ranges.mean(axis=1)[:, None] + np.ptp(ranges, axis=1)[:, None] / 2 * u)


class OverRange(NamedTuple):
    """A cylinder over the whole range of all joints that move its pins.

    Attributes:
        lengths: distance (N,) of its pins [m].
        arms: lever arm (N,) on the joint that it is there to move, of a spring on the last one.
        place: words where a sample is.
    """

    lengths: Array
    arms: Array
    place: Callable[[int], str]


def over_range(geometry: Geometry, part: Pinned) -> OverRange:
    """Lengths and lever arms of a cylinder or spring over the range of its joints.

    >>> from hydroopt.machine.machine_file import load_machine
    >>> machine = load_machine("wheel_loader")
    >>> print(f"{over_range(Geometry(machine), machine.cylinders[1]).lengths.max():.2f} m")
    1.71 m
    """
    machine = geometry.machine
    joints = machine.moved_by(part)
    q, states, place = _range_of(machine, joints)
    length = _length(geometry, part, Mechanism(machine).positions(geometry, q))
    symbols = ca.vertcat(*q.values())
    moved = joints.index(machine.main_joint(part)) if isinstance(part, Cylinder) else -1
    function = ca.Function("length", [symbols], [length, ca.jacobian(length, symbols)[moved]])
    lengths, arms = (np.asarray(values).ravel() for values in function(states))
    return OverRange(lengths, arms, place)


def _range_of(machine: Machine, joints: Sequence[str]) -> tuple[dict[str, ca.SX], Array, Callable[[int], str]]:
    """Symbols of joints by name, their positions (n, N) over their ranges, and the words for a sample's place."""
    states = _samples(machine, joints)

    def place(sample: int) -> str:
        slides = [machine.link(joint).joint.type == "prismatic" for joint in joints]
        return ", ".join(f"{joint} = {value:.3f} m" if slide else f"{joint} = {np.degrees(value):.1f} deg"
                         for joint, value, slide in zip(joints, states[:, sample], slides, strict=True))

    return {joint: ca.SX.sym(joint) for joint in joints}, states, place


def _apart(geometry: Geometry, part: GasCylinder | Spring) -> tuple[Array, Callable[[int], str]]:
    """Lengths [m] of a part over its joints, and the place of each; refuses one whose pins meet."""
    lengths, _, place = over_range(geometry, part)
    if (closed := np.flatnonzero(lengths < 1e-9)).size:
        raise ImpossibleError(f"the pins of '{part.name}' meet at {place(int(closed[0]))}, where its force has no "
                              "direction", "correct its pins or narrow the joints' limits")
    return lengths, place


def _gas_has_room(geometry: Geometry, gas: GasCylinder) -> None:
    lengths, place = _apart(geometry, gas)
    volumes = gas.gas_volume(lengths)
    smallest = int(np.argmin(volumes))
    if not volumes[smallest] > 0:
        raise ImpossibleError(
            f"the gas of '{gas.name}' would have a volume of {1e3 * volumes[smallest]:.3f} l at {place(smallest)}",
            "correct its volume, area, reference length or pins, or narrow the joints' limits")


def _not_dead_at_once(geometry: Geometry, joint: str, cylinders: Sequence[Cylinder]) -> None:
    """Refuse a posture in which none of the cylinders of a joint has a lever arm, or all of them change its sign."""
    grids = [over_range(geometry, each) for each in cylinders]
    signs = np.sign([each.arms for each in grids])
    dead = np.flatnonzero(np.all(signs[:, 1:] * signs[:, :-1] <= 0, axis=0))
    if dead.size:
        names = " and ".join(f"'{each.name}'" for each in cylinders)
        raise ImpossibleError(f"{names} all have a dead point near {grids[0].place(int(dead[0]))}, where nothing "
                              f"moves '{joint}'",
                              "correct their pins or narrow the joint's limits")


def _check_on_grid(geometry: Geometry, cylinder: Cylinder, *, alone: bool) -> ShortStroke | None:
    """What its stroke lacks; refuses a dead point."""
    lengths, arms, place = over_range(geometry, cylinder)
    if (short := stroke_checks.by_samples(cylinder.name, lengths, place, stroke_checks.possible(cylinder))):
        return short
    turned = np.flatnonzero(arms * arms[0] <= 0)
    if turned.size and alone:
        raise ImpossibleError(
            f"'{cylinder.name}' has a dead point near {place(int(turned[0]))}, where its lever arm on "
            f"{geometry.machine.main_joint(cylinder)} changes sign", "correct its pins or narrow the joints' limits")
    return None


def _slides(geometry: Geometry) -> Iterator[ShortStroke | None]:
    """What joints lack that slide as others make them, and state how far they can."""
    machine = geometry.machine
    for closure in closures(machine.links, machine.loops, machine.couplings):
        for joint in closure.joints:
            if machine.link(joint).joint.lower is None:
                continue
            q, states, place = _range_of(machine, closure.follows)
            at = Mechanism(machine).positions(geometry, q)[joint]
            lengths = np.asarray(ca.Function("slide", [ca.vertcat(*q.values())], [at])(states)).ravel()
            yield stroke_checks.by_samples(joint, lengths, place, machine.link(joint).joint.range)


def _axis_hint(machine: Machine, joint: str, sides: Triangle) -> str:
    """What else may be wrong where a joint turns by more than a turn, or not in the plane of a cylinder's pins."""
    lower, upper = machine.link(joint).joint.range
    if upper - lower > 2 * np.pi:
        return f"; '{joint}' turns by {np.degrees(upper - lower):.0f} deg, as if deg were meant, not rad"
    fixed, moving, _, lateral = (float(value) for value in sides)
    if abs(lateral) > ASIDE * min(fixed, moving):
        return (f"; its pins are {1e3 * abs(lateral):.0f} mm apart along the axis of '{joint}': check their y and z, "
                "and alpha of the link before")
    return ""


def straight_and_wide(machine: Machine) -> tuple[tuple[str, float], ...]:
    """Cylinders that alone, pinned to its link itself, turn a joint by more than `WIDE`; each with that range [rad].

    >>> from hydroopt.machine.machine_file import load_machine
    >>> straight_and_wide(load_machine("excavator_bucket"))
    ()
    """
    geometry, found = Geometry(machine), []
    for cylinder in machine.cylinders:
        triangle = geometry.triangle(cylinder)
        if triangle and triangle[0] in machine.joints and len(machine.drivers[triangle[0]]) == 1:
            lower, upper = machine.link(triangle[0]).joint.range
            if upper - lower > WIDE + 1e-9:
                found.append((cylinder.name, upper - lower))
    return tuple(found)


def _rocker_hint(machine: Machine, joint: str) -> str:
    """What else may be wrong of a cylinder that is pinned to a link itself: a rocker and a coupler stand between."""
    for closure in closures(machine.links, machine.loops, machine.couplings):
        if isinstance(closure, DyadClosure) and closure.follows[-1] == joint:
            return f"; or pin it to '{closure.first}' of the linkage '{closure.loop.name}'"
    lower, upper = machine.link(joint).joint.range
    return "; or state a rocker between rod and link by [[linkages]]" if upper - lower > WIDE else ""


def _lever_arm_keeps_sign(cylinder: Cylinder, joint: str, offset: float, limits: tuple[float, float],
                          hint: str) -> None:
    # the lever arm fixed·moving·sin(θ + offset)/length is zero where the pins and the axis lie in one line; a passive
    # gas cylinder may pass such a point (a counterbalance works on both sides of it), an actuator may not
    lower, upper = limits
    first = np.ceil((lower + offset) / np.pi)
    dead = first * np.pi - offset
    if dead <= upper:
        raise ImpossibleError(
            f"'{cylinder.name}' has a dead point at {joint} = {np.degrees(dead):.2f} deg, inside the joint's range "
            f"{np.degrees(lower):.1f} to {np.degrees(upper):.1f} deg",
            f"correct its pins or narrow the joint's limits{hint}")
