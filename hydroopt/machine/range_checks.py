"""Whether loops close, cylinders do their work and beams hit the ground over the whole range of a machine's joints."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import NamedTuple

import casadi as ca
import numpy as np

from hydroopt.machine.actuators import Cylinder, GasCylinder, Pinned, Spring
from hydroopt.machine.closures import closures
from hydroopt.machine.geometry import Geometry
from hydroopt.machine.loops import Loop
from hydroopt.machine.machine import BASE, Machine
from hydroopt.machine.mechanism import Assembly, Mechanism, Ways
from hydroopt.machine.quantity import ImpossibleError, longer_than_machines
from hydroopt.machine.sensors import Rangefinder
from hydroopt.spatial.evenly_spread import sobol
from hydroopt.spatial.inertia import Array

POINTS = {1: 721, 2: 61, 3: 25}
"""Points of each joint's range on the grid of one, two or three joints."""
DRAWN = 12
"""Logarithm to the base 2 of the number of samples of more joints."""
FLAT = np.radians(1.0)
"""Angle [rad] between the bars of a loop, or between them stretched, below which it is at a dead point."""
PLANAR = 1e-9
"""Length [m], and part of a unit vector, that counts as out of a loop's plane; lever arm [m] of a dead point."""
WIDE = np.radians(120)
"""Range of a joint beyond which a cylinder pinned to the link itself is rare: a rocker and a coupler stand between."""
ASIDE = 0.2
"""Part of the shorter distance of a pin from a joint's axis, by which pins apart along the axis are suspicious."""
ROUNDING = 1e-9
"""Length [m] that a stroke may lack."""
ROOM = 195
"""Characters of a sentence for cylinders that it names; those beyond are counted."""
NARROW = "correct its pins or narrow the joints' limits"


class Sampled(NamedTuple):
    """Quantities over the ranges of the joints that they depend on.

    Attributes:
        machine, joints: whose joints, by name.
        states: their positions (n, N) [rad or m].
        values: the entries (k, N) of each quantity.
    """

    machine: Machine
    joints: tuple[str, ...]
    states: Array
    values: list[Array]

    def posture(self, sample: int) -> dict[str, float]:
        """Positions by name at a sample."""
        return dict(zip(self.joints, self.states[:, sample].tolist(), strict=True))

    def at(self, sample: int) -> str:
        """Where a sample is, in words."""
        return self.machine.in_words(self.posture(sample))


def expressed(geometry: Geometry, joints: Sequence[str],
              quantities: Callable[[ca.SX, dict[str, ca.SX]], Sequence[ca.SX]]) -> ca.Function:
    """Quantities, stated by positions (n,) of joints and by those of all joints that follow, as a function of (n,)."""
    q = ca.SX.sym("q", len(joints))
    at = Mechanism(geometry.machine).positions(geometry, dict(zip(joints, ca.vertsplit(q), strict=True)))
    return ca.Function("expressed", [q], [ca.vec(ca.densify(ca.SX(each))) for each in quantities(q, at)])


def sampled(geometry: Geometry, joints: Sequence[str], states: Array,
            quantities: Callable[[ca.SX, dict[str, ca.SX]], Sequence[ca.SX]]) -> Sampled:
    """Quantities, see `expressed`, at positions (n, N) of joints."""
    found = expressed(geometry, joints, quantities).call([states])
    return Sampled(geometry.machine, tuple(joints), states, [np.asarray(each) for each in found])


def over(machine: Machine, joints: Sequence[str]) -> Array:
    """Positions (n, N) of joints over their ranges: a grid, or where they are many mid-range, all corners and Sobol's
    sequence between them."""
    ranges, n = np.array([machine.link(joint).joint.range for joint in joints]), len(joints)
    if not n:
        return np.zeros((0, 1))
    if n in POINTS:
        axes = [np.linspace(lower, upper, POINTS[n]) for lower, upper in ranges.tolist()]
        return np.stack([values.ravel() for values in np.meshgrid(*axes, indexing="ij")])
    corners = np.array(np.meshgrid(*[[-1.0, 1.0]] * n, indexing="ij")).reshape(n, -1)
    u = np.hstack([np.zeros((n, 1)), corners, 2 * sobol(n, DRAWN).T - 1])
    return np.asarray(ranges.mean(axis=1)[:, None] + np.ptp(ranges, axis=1)[:, None] / 2 * u)


class LoopRange(NamedTuple):
    """A loop, or several that close together, over the ranges of the joints that they follow.

    Attributes:
        assembly: the loop as it is assembled.
        angle: least angle [rad] in the range between its bars, or by which they miss a straight line: its margin to a
            dead point, in general that of `Mechanism.sines`. Not a number where the loop cannot close.
        at: where this is, in words.
        posture: positions by name of the joints that it follows, where this is.
        ratios: least and greatest speed of each dependent joint per speed of the last joint that it follows.
    """

    assembly: Assembly
    angle: float
    at: str
    posture: dict[str, float]
    ratios: dict[str, tuple[float, float]]


def loop_ranges(machine: Machine) -> tuple[LoopRange, ...]:
    """Every loop of a machine with its margin to the nearest dead point.

    >>> from hydroopt.machine.machine_file import load_machine
    >>> loop_ranges(load_machine("cat215b"))
    ()
    """
    return tuple(_loop_range(Geometry(machine), each) for each in Mechanism(machine).assemblies
                 if not each.closure.linear)


def _loop_range(geometry: Geometry, assembly: Assembly) -> LoopRange:
    closure = assembly.closure
    found = sampled(geometry, closure.follows, over(geometry.machine, closure.follows), lambda q, at: [
        ca.SX(assembly.solved(geometry, at)[1]), *(ca.jacobian(at[joint], q[-1]) for joint in closure.joints)])
    sines, *slopes = (each.ravel() for each in found.values)
    # where the branch changes its sign the loop passes a dead point
    signed = sines * np.sign(sines[np.argmax(np.isfinite(sines))])
    worst = int(np.argmin(np.where(np.isfinite(signed), signed, -2.0)))
    return LoopRange(assembly, float(np.arcsin(min(signed[worst], 1.0))), found.at(worst), found.posture(worst),
                     {joint: (float(np.min(slope)), float(np.max(slope)))
                      for joint, slope in zip(closure.joints, slopes, strict=True)})


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
    return tuple(_span(Geometry(machine), joints) for joints in machine.entangled)


def _span(geometry: Geometry, joints: tuple[str, ...]) -> Span:
    machine, size = geometry.machine, len(joints)
    cylinders = tuple(each for each in machine.cylinders if machine.main_joint(each) in joints)
    around = [joint for joint in machine.joints if any(joint in machine.moved_by(each) for each in cylinders)]
    own = [around.index(joint) for joint in joints]
    found = sampled(geometry, around, over(machine, around), lambda q, at: [
        ca.jacobian(ca.vertcat(*(length(geometry, each, at) for each in cylinders)), q)[:, own]])
    turned = found.values[0].T.reshape(-1, size, len(cylinders)).transpose(0, 2, 1)
    norms = np.linalg.norm(turned, axis=1, keepdims=True)
    turned = turned / np.where(norms > 0, norms, 1.0)  # none of the lengths feels a joint with a column of zeros
    apart = np.linalg.svd(turned, compute_uv=False)[:, -1] > 1e-12
    # a row of the inverse has the length of one over the sine of its joint's angle to the others
    sines = 1 / np.max(np.linalg.norm(np.linalg.pinv(turned), axis=2), axis=1)
    sides = np.sign(np.linalg.det(turned)) if len(cylinders) == size else np.ones(len(turned))
    signed = np.where(apart, sides * sides[0] * sines, 0.0)
    worst = int(np.argmin(signed))
    return Span(joints, cylinders, float(np.arcsin(np.clip(signed[worst], -1, 1))), found.at(worst))


class OverRange(NamedTuple):
    """A part between two pins over the whole range of all joints that move them.

    Attributes:
        lengths: distance (N,) of its pins [m].
        arms: lever arm (N,) on the joint that it is there to move, of a spring on the last one.
        place: words where a sample is.
    """

    lengths: Array
    arms: Array
    place: Callable[[int], str]


def over_range(geometry: Geometry, part: Pinned) -> OverRange:
    """Lengths and lever arms of a cylinder or spring over the range of its joints, at its dead points among others
    where it spans one joint that turns.

    >>> from hydroopt.machine.machine_file import load_machine
    >>> machine = load_machine("wheel_loader")
    >>> print(f"{over_range(Geometry(machine), machine.cylinders[1]).lengths.max():.2f} m")
    1.71 m
    """
    machine = geometry.machine
    joints, triangle = machine.moved_by(part), geometry.triangle(part)
    states = over(machine, joints)
    if triangle and triangle[0] in machine.joints:
        (lower, upper), offset = machine.link(triangle[0]).joint.range, float(triangle[1].offset)
        dead = np.arange(np.ceil((lower + offset) / np.pi), (upper + offset) / np.pi) * np.pi - offset
        states = np.sort(np.hstack([states, dead[None]]))
    moved = joints.index(machine.main_joint(part)) if isinstance(part, Cylinder) else -1

    def quantities(q: ca.SX, at: dict[str, ca.SX]) -> list[ca.SX]:
        distance = length(geometry, part, at)
        return [distance, ca.jacobian(distance, q)[moved]]

    found = sampled(geometry, joints, states, quantities)
    lengths, arms = (each.ravel() for each in found.values)
    return OverRange(lengths, arms, found.at)


def length(geometry: Geometry, part: Pinned, at: Mapping[str, ca.SX]) -> ca.SX:
    """Distance of the pins [m] of a part at positions of joints by name."""
    return ca.norm_2(geometry.pin(part, "rod", at) - geometry.pin(part, "barrel", at))


def check(machine: Machine) -> None:
    """Check loops and cylinders over the ranges of the joints that move them, on a grid or at samples.

    Loops that close by a pin must be planar; all must close everywhere, and keep away from dead points, where their
    bars lie in one line. Strokes must cover the range, also of cylinders that share oil, and lever arms keep their
    sign; of several actuators that are there to move one joint each may pass a dead point, but not all at once.
    Cylinders that only together move several joints, as those of a platform, must do so. The volume of a gas cylinder
    must stay positive and its pins and those of a spring apart. The beam of a rangefinder must hit the
    ground somewhere.

    Raises:
        ImpossibleError: names the loop or cylinder, the posture and the remedy.
    """
    if (found := mistake(machine)) is not None:
        raise ImpossibleError(found.what, _other_way_fits(machine) or found.remedy, found.key)


def mistake(machine: Machine) -> ImpossibleError | None:
    """The first thing that `check` refuses; None if there is none."""
    try:
        return next((each for kind in (_of_loops, _of_parts, _of_beams) for each in kind(machine)), None)
    except ImpossibleError as error:  # of a posture
        return error


def _of_loops(machine: Machine) -> Iterator[ImpossibleError]:
    geometry = Geometry(machine)
    for closure in closures(machine.links, machine.loops, machine.couplings):
        alike = closure.planar and machine.turns(closure.joints[1])
        for statement in closure.statements:
            if isinstance(statement, Loop) and statement.closed_by == "pin":
                yield from _out_of_plane(geometry, statement, alike=alike)
    mechanism, remedy = Mechanism(machine), "correct its pins and lengths, or narrow the joints' limits"
    for each in loop_ranges(machine):
        closure, place = each.assembly.closure, each.assembly.closure.statements[0].place
        if not np.isfinite(each.angle):
            q = {joint: ca.DM(value) for joint, value in each.posture.items()}
            why = each.assembly.why_open(geometry, mechanism.positions(geometry, q))
            yield ImpossibleError(f"{closure} cannot close at {each.at}: {why}", remedy, place)
        elif each.angle < FLAT:
            yield ImpossibleError(f"{closure} would have a dead point at {each.at}, where "
                                  f"{each.assembly.dead(geometry)}", remedy, place)


def _out_of_plane(geometry: Geometry, loop: Loop, *, alike: bool) -> Iterator[ImpossibleError]:
    """A loop in space shows wherever its joints stand; those of a dyad turn `alike`, to the same side."""
    machine = geometry.machine
    joints = machine.joints_between(loop.link, loop.to.link)
    turning = [joint for joint in joints if machine.turns(joint)]
    if not turning:
        yield ImpossibleError(f"no joint of the loop '{loop.name}' turns, but it closes on a pin",
                              "close it over a joint that turns", loop.place)
        return
    first = next((joint for joint in turning if machine.link(joint).joint.dependent), turning[0])
    for joint in joints:
        axis: Array = np.asarray(geometry.from_seat(first, joint, {}).rotation)[:, 2]
        if joint not in turning and abs(axis[2]) > PLANAR:
            yield ImpossibleError(f"the joint '{joint}' in the loop '{loop.name}' slides out of the plane in which "
                                  f"'{first}' turns, but a pin closes planar loops only",
                                  "let it slide across the axes of the others", loop.place)
        if joint in turning and abs((axis[2] if alike else abs(axis[2])) - 1) > PLANAR:
            yield ImpossibleError(f"the axes of '{first}' and '{joint}' in the loop '{loop.name}' do not point the "
                                  "same way, but a pin closes planar loops only",
                                  "make them parallel, to the same side; behind a link with an alpha or beta a locked "
                                  "link carries the pins", loop.place)
    own, target = zip((loop.link, loop.to.link), geometry.loop_ends(loop), strict=True)
    aside = [float(geometry.from_seat(first, link, {}).point(end)[2]) for link, end in (own, target)]
    if abs(aside[1] - aside[0]) > PLANAR:
        yield ImpossibleError(f"the pins at which the loop '{loop.name}' closes are "
                              f"{1e3 * abs(aside[1] - aside[0]):.4g} mm apart along its axes",
                              "let the pin's z, or a joint's d, close this gap", f"{loop.place}.to.pin")


def _of_parts(machine: Machine) -> Iterator[ImpossibleError]:
    geometry, short = Geometry(machine), list(_slides(machine))
    for cylinder in machine.cylinders:
        joint, range_ = machine.main_joint(cylinder), over_range(geometry, cylinder)
        alone = len(machine.drivers[joint]) == 1 and not any(joint in group for group in machine.entangled)
        hint = _hint(geometry, cylinder)
        dead = np.flatnonzero((range_.arms * range_.arms[0] <= 0) | (np.abs(range_.arms) < PLANAR))
        if alone and dead.size:
            yield ImpossibleError(f"'{cylinder.name}' has a dead point at {range_.place(int(dead[0]))}, where its "
                                  f"lever arm on {joint} changes sign", f"{NARROW}{hint}")
        short.append(ShortStroke.of(cylinder.name, range_.lengths, range_.place, (
            cylinder.dead_length, cylinder.dead_length + cylinder.stroke), hint))
    yield from _short([each for each in short if each])
    for joint, several in machine.drivers.items():
        cylinders = [each for each in several if isinstance(each, Cylinder) and machine.moved_by(each) == (joint,)]
        if len(several) == len(cylinders) > 1:
            yield from _dead_at_once(geometry, joint, cylinders)
    for span in spans(machine):
        if span.angle < FLAT:
            yield ImpossibleError(f"'{span.cylinders[0].name}' and {len(span.cylinders) - 1} more do not hold their "
                                  f"joints at {span.at}, where a motion changes none of their lengths", NARROW)
    passive: tuple[GasCylinder | Spring, ...] = (*machine.gas_cylinders, *machine.springs)
    for part in passive:
        range_ = over_range(geometry, part)
        closest = int(np.argmin(range_.lengths))
        if range_.lengths[closest] < ROUNDING:
            yield ImpossibleError(f"the pins of '{part.name}' meet at {range_.place(closest)}, where its force has no "
                                  "direction", NARROW)
        volumes = part.gas_volume(range_.lengths) if isinstance(part, GasCylinder) else np.ones(1)
        smallest = int(np.argmin(volumes))
        if not volumes[smallest] > 0:
            yield ImpossibleError(f"the gas of '{part.name}' would have a volume of {1e3 * volumes[smallest]:.3f} l at "
                                  f"{range_.place(smallest)}", "correct its volume, area, reference length or pins, or "
                                  "narrow the joints' limits")


def _of_beams(machine: Machine) -> Iterator[ImpossibleError]:
    """Rangefinders that read nothing, wherever the joints stand that move them."""
    geometry = Geometry(machine)
    for laser in machine.rangefinders:
        moving = {joint for link in machine.ancestry(laser.link) for joint in machine.followed.get(link, ())}
        joints = [joint for joint in machine.joints if joint in moving]

        def reading(_: ca.SX, at: dict[str, ca.SX], laser: Rangefinder = laser) -> list[ca.SX]:
            pose, beam = geometry.relative_pose(BASE, laser.link, at), ca.DM(laser.direction)
            height = pose.point(geometry.point(laser.name))[2] - machine.ground
            return [-height * ca.norm_2(beam) / (pose.rotation @ beam)[2]]

        found = sampled(geometry, joints, over(machine, joints), reading).values[0]
        if not np.any((found > 0) & (found <= laser.range)):
            yield ImpossibleError(
                f"the beam of '{laser.name}' cannot hit the ground, which is at {machine.ground:.6g} m, within its "
                f"range of {laser.range:.6g} m{', wherever its link stands' * bool(joints)}", "let it start above and "
                "point down, towards -z of the base frame, or correct 'ground', its range or the joints' limits",
                f"rangefinders[{laser.name}].direction")


def _dead_at_once(geometry: Geometry, joint: str, cylinders: Sequence[Cylinder]) -> Iterator[ImpossibleError]:
    """A posture in which none of the cylinders of a joint has a lever arm, or all of them change its sign."""
    states = over(geometry.machine, (joint,))
    found = sampled(geometry, (joint,), states, lambda q, at: [
        ca.jacobian(length(geometry, each, at), q) for each in cylinders])
    signs = np.sign([each.ravel() for each in found.values])
    dead = np.flatnonzero(np.all(signs[:, 1:] * signs[:, :-1] <= 0, axis=0))
    if dead.size:
        names = " and ".join(f"'{each.name}'" for each in cylinders)
        yield ImpossibleError(f"{names} all have a dead point near {found.at(int(dead[0]))}, where nothing moves "
                              f"'{joint}'", NARROW)


class ShortStroke(NamedTuple):
    """A cylinder, or a joint that follows others, and what it cannot do.

    Attributes:
        name: of the cylinder or joint.
        length: the one that it would have [m] which is farthest from what it can be.
        place: where it would have it, in words.
        possible: shortest and longest that it can be [m].
        needed: shortest and longest in the whole range of the joints [m].
        hint: what else may be wrong, or empty.
    """

    name: str
    length: float
    place: str
    possible: tuple[float, float]
    needed: tuple[float, float]
    hint: str

    @classmethod
    def of(cls, name: str, lengths: Array, place: Callable[[int], str], possible: tuple[float, float],
           hint: str = "") -> ShortStroke | None:
        """What a cylinder or sliding joint lacks at lengths (N,) [m], of which `place` words where each is."""
        beyond = np.maximum(possible[0] - lengths, lengths - possible[1])
        worst = int(np.argmax(beyond))
        needed = float(lengths.min()), float(lengths.max())
        return None if beyond[worst] <= ROUNDING else cls(name, float(lengths[worst]), place(worst), possible, needed,
                                                          hint)


def _short(short: Sequence[ShortStroke]) -> Iterator[ImpossibleError]:
    """All strokes that are too short in one sentence."""
    if len(short) == 1:
        (one,) = short
        least, most = one.needed
        yield ImpossibleError(f"'{one.name}' would be {one.length:.3f} m long at {one.place} but can only be "
                              f"{one.possible[0]:.3f} to {one.possible[1]:.3f} m",
                              f"correct dead length and stroke (the whole range takes {least:.3f} to {most:.3f} m), "
                              f"pins or the joints' limits{longer_than_machines(max(most, one.possible[1]))}{one.hint}")
    elif short:
        each = [f"'{one.name}' needs {one.needed[0]:.3f} to {one.needed[1]:.3f} m, not {one.possible[0]:.3f} to "
                f"{one.possible[1]:.3f} m" for one in short]
        named = [text for k, text in enumerate(each) if k == 0 or len(", ".join(each[:k + 1])) <= ROOM]
        more = f" and {len(each) - len(named)} more" if len(each) > len(named) else ""
        yield ImpossibleError(f"strokes do not cover the joints' ranges: {', '.join(named)}{more}",
                              "correct lengths, strokes, pins or limits")


def _slides(machine: Machine) -> Iterator[ShortStroke | None]:
    """What joints lack that slide as others make them, and state how far they can."""
    for closure in closures(machine.links, machine.loops, machine.couplings):
        for joint in closure.joints:
            if machine.link(joint).joint.lower is not None:
                found = sampled(Geometry(machine), closure.follows, over(machine, closure.follows),
                                lambda _, at, joint=joint: [at[joint]])  # type: ignore[misc]
                yield ShortStroke.of(joint, found.values[0].ravel(), found.at, machine.link(joint).joint.range)


def _hint(geometry: Geometry, cylinder: Cylinder) -> str:
    """What else may be wrong of a cylinder that turns one joint: its range, its pins' plane, or that it is pinned to
    the link itself, where a rocker and a coupler stand between."""
    machine, found = geometry.machine, geometry.triangle(cylinder)
    if not found or found[0] not in machine.joints:
        return ""
    joint, (fixed, moving, _, lateral) = found[0], map(float, found[1])
    width = float(np.ptp(machine.link(joint).joint.range))
    if width > 2 * np.pi:
        return f"; '{joint}' turns by {np.degrees(width):.0f} deg, as if deg were meant, not rad"
    if abs(lateral) > ASIDE * min(fixed, moving):
        return (f"; its pins are {1e3 * abs(lateral):.0f} mm apart along the axis of '{joint}': check their y and z, "
                "and alpha of the link before")
    for closure in closures(machine.links, machine.loops, machine.couplings):
        if closure.planar and machine.turns(closure.joints[1]) and closure.follows[-1] == joint:
            return f"; or pin it to '{closure.joints[0]}' of the linkage '{closure.statements[0].name}'"
    return "; or state a rocker between rod and link by [[linkages]]" if width > WIDE else ""


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
            width = float(np.ptp(machine.link(triangle[0]).joint.range))
            found += [(cylinder.name, width)] if width > WIDE + 1e-9 else []
    return tuple(found)


def other_ways(machine: Machine) -> dict[str, str]:
    """Of every loop with a closed form how it is assembled, and whether the machine would fit the other way, too.

    >>> from hydroopt.machine.machine_file import load_machine
    >>> other_ways(load_machine("patu655"))["tilt_linkage"].partition(", coupler")[0]
    'assembled with rocker = 109.3 deg'
    """
    return {ways.loop: _assembled(machine, ways) for ways in Mechanism(machine).ways}


def _assembled(machine: Machine, ways: Ways) -> str:
    turned, words = _turned(machine, ways), machine.in_words
    here = f"assembled with {words(ways.own)} at {words(ways.follows)}"
    if mistake(turned) is not None:
        return f"{here}; the other way does not fit"
    arms = []
    for cylinder in machine.cylinders:
        own, other = (over_range(Geometry(each), cylinder).arms for each in (machine, turned))
        if not np.allclose(own, other, rtol=0, atol=1e-6):
            arms.append(f"{cylinder.name} from {np.abs(other).min():.3f} to {np.abs(other).max():.3f} m")
    return (f"{here}; the other way, {words(ways.other)}, fits as well"
            + f" (lever arm of {', '.join(arms)})" * bool(arms) + ": compare the posture with the machine")


def _other_way_fits(machine: Machine) -> str:
    """What to do where a machine is refused, but fits with a loop assembled the other way; empty if none does."""
    try:
        for ways in Mechanism(machine).ways:
            if mistake(_turned(machine, ways)) is None:
                joint = next(iter(ways.own))
                return (f"correct the posture of '{ways.loop}': the other way to assemble it, with "
                        f"{machine.in_words({joint: ways.other[joint]})} at {machine.in_words(ways.follows)}, fits; or "
                        "dead length, stroke, pins or limits")
    except ImpossibleError:
        pass
    return ""


def _turned(machine: Machine, ways: Ways) -> Machine:
    """The machine with one loop assembled the other way."""
    posture = ways.follows | ways.other
    return machine.model_copy(update={"loops": tuple(
        loop.model_copy(update={"posture": posture}) if loop.name == ways.loop else loop for loop in machine.loops)})
