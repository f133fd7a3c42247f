"""Joint limits that strokes permit: limits of a machine file are often assumed or rounded, strokes are not."""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca
import numpy as np

from hydroopt.machine.actuators import Cylinder
from hydroopt.machine.cylinder_checks import FEW
from hydroopt.machine.geometry import Geometry
from hydroopt.machine.loop_checks import FLAT
from hydroopt.machine.machine import Machine
from hydroopt.machine.mechanism import Mechanism
from hydroopt.spatial.cylinder_triangle import Triangle, triangle_angle

INSIDE = 1e-6
"""How far inside the end of a stroke, or inside a dead point, a limit is set [rad, m]."""
POINTS = 25
"""Of the range of each other joint that moves a cylinder, as many as its check has."""


class NarrowedLimits(NamedTuple):
    """Limits (lower, upper) [rad, m] of a joint before and after, and the cylinder whose stroke ends sooner.

    Of a cylinder that `others` move, too, it covers the limits wherever those stand.
    """

    joint: str
    cylinder: str
    before: tuple[float, float]
    after: tuple[float, float]
    others: tuple[str, ...] = ()


def within_strokes(machine: Machine) -> tuple[Machine, tuple[NarrowedLimits, ...]]:
    """The machine with limits that no stroke contradicts, and which limits this narrowed.

    A cylinder that several joints move narrows the one that it is there to move; those that only together move their
    joints, as of a platform, narrow none. A joint that its cylinder can move nowhere keeps its limits: the check of the
    machine file says what is wrong.

    >>> from hydroopt.machine.machine_file import load_machine
    >>> narrower, changes = within_strokes(load_machine("cat215b").with_values({"boom_cylinder.dead_length": 1.3}))
    >>> [(change.joint, change.cylinder) for change in changes]
    [('boom', 'boom_cylinder')]
    """
    geometry, drivers, changes = Geometry(machine), machine.drivers, []
    entangled = {joint for group in machine.entangled for joint in group}
    for cylinder in sorted(machine.cylinders, key=lambda each: len(machine.moved_by(each))):
        joint, moved = machine.main_joint(cylinder), machine.moved_by(cylinder)
        if joint in entangled or len(moved) > FEW:
            continue
        others = tuple(name for name in moved if name != joint)
        lower, upper = machine.link(joint).joint.range
        alone, found = len(drivers[joint]) == 1, geometry.triangle(cylinder)
        reach = (_reach(cylinder, found[1], (lower + upper) / 2) if alone and found and (found[0],) == moved
                 else _reach_on_grid(machine, cylinder, joint, others, alone=alone))
        if reach is None:
            continue
        after = max(lower, reach[0]), min(upper, reach[1])
        if after != (lower, upper) and after[0] < after[1]:
            changes.append(NarrowedLimits(joint, cylinder.name, (lower, upper), after, others))
            machine = machine.with_joint_limits({joint: after})
    return machine, tuple(changes)


def _reach_on_grid(machine: Machine, cylinder: Cylinder, joint: str, others: tuple[str, ...], *,
                   alone: bool) -> tuple[float, float] | None:
    """Positions [rad, m] about the middle of a joint's range that stroke, lever arm and loops allow wherever other
    joints stand; None if none.

    A cylinder that is not `alone` at its joint may pass its dead point.
    """
    geometry, mechanism = Geometry(machine), Mechanism(machine)
    q = {name: ca.SX.sym(name) for name in (joint, *others)}
    lower, upper = machine.link(joint).joint.range
    at = mechanism.positions(geometry, q)
    length = ca.norm_2(geometry.pin(cylinder, "rod", at) - geometry.pin(cylinder, "barrel", at))
    sines = ca.vertcat(*mechanism.sines(geometry, q))
    function = ca.Function("length", list(q.values()), [length, ca.jacobian(length, q[joint]), sines])
    axes = [np.linspace(*machine.link(name).joint.range, POINTS) for name in others]
    beside = [values.reshape(1, -1) for values in np.meshgrid(*axes, indexing="ij")]
    middle = (lower + upper) / 2
    sign = np.sign(float(function(middle, *(np.median(values) for values in beside))[1]))

    def usable(angle: float) -> bool:
        lengths, arms, clear = (np.asarray(values) for values in function(
            np.full(beside[0].shape if beside else (1, 1), angle), *beside))
        strokes = lengths - cylinder.dead_length
        works = np.all(arms * sign > 0) or not alone
        return bool(np.all((strokes >= 0) & (strokes <= cylinder.stroke)) and works
                    and np.all(np.abs(clear) > np.sin(FLAT)))

    if not usable(middle):
        return None
    ends = []
    for end in (lower, upper):
        grid = np.linspace(middle, end, 181)
        bad = next((k for k, angle in enumerate(grid) if not usable(float(angle))), None)
        if bad is None:
            ends.append(float(end))
            continue
        good, past = float(grid[bad - 1]), float(grid[bad])
        while abs(past - good) > INSIDE / 10:
            half = (good + past) / 2
            good, past = (half, past) if usable(half) else (good, half)
        ends.append(good - np.copysign(INSIDE, end - middle))
    return ends[0], ends[1]


def _reach(cylinder: Cylinder, sides: Triangle, middle: float) -> tuple[float, float] | None:
    """Angles [rad] about the one given that the stroke covers without a dead point; None if there are none."""
    fixed, moving, offset, lateral = (float(side) for side in sides)
    branch = 1 if np.sin(middle + offset) > 0 else -1
    shortest, longest = (float(np.hypot(fixed + sign * moving, lateral)) for sign in (-1, 1))
    # not quite as far as the triangle folds or stretches, where its angle is lost in rounding
    rounding = 1e-12 * longest
    ends = np.clip([cylinder.dead_length, cylinder.dead_length + cylinder.stroke], shortest + rounding,
                   longest - rounding)
    if ends[0] >= ends[1]:
        return None
    # at a clipped end pins and axis lie in one line, a dead point
    low, high = sorted(float(triangle_angle(sides, end, branch, middle)) for end in ends)
    return low + INSIDE, high - INSIDE
