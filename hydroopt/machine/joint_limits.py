"""Joint limits that strokes permit: limits of a machine file are often assumed or rounded, strokes are not."""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca
import numpy as np

from hydroopt.machine.actuators import Cylinder
from hydroopt.machine.geometry import Geometry
from hydroopt.machine.loop_checks import FLAT
from hydroopt.machine.machine import Machine
from hydroopt.machine.mechanism import Mechanism
from hydroopt.spatial.cylinder_triangle import Triangle, triangle_angle

INSIDE = 1e-6
"""How far inside the end of a stroke, or inside a dead point, a limit is set [rad]."""


class NarrowedLimits(NamedTuple):
    """Limits (lower, upper) [rad] of a joint before and after, and the cylinder whose stroke ends sooner."""

    joint: str
    cylinder: str
    before: tuple[float, float]
    after: tuple[float, float]


def within_strokes(machine: Machine) -> tuple[Machine, tuple[NarrowedLimits, ...]]:
    """The machine with limits that no stroke contradicts, and which limits this narrowed.

    Only cylinders that one joint moves count, through a linkage or on one revolute joint. A joint that its cylinder can
    move nowhere keeps its limits: the check of the machine file says what is wrong.

    >>> from hydroopt.machine.machine_file import load_machine
    >>> narrower, changes = within_strokes(load_machine("cat215b").with_values({"boom_cylinder.dead_length": 1.3}))
    >>> [(change.joint, change.cylinder) for change in changes]
    [('boom', 'boom_cylinder')]
    """
    geometry, changes = Geometry(machine), []
    for cylinder in machine.cylinders:
        found, moved = geometry.triangle(cylinder), machine.moved_by(cylinder)
        if found is None or len(moved) > 1:
            continue
        joint = moved[0]
        lower, upper = machine.link(joint).joint.range
        alone = len(machine.drivers[joint]) == 1
        reach = (_reach(cylinder, found[1], (lower + upper) / 2) if alone and found[0] == joint
                 else _reach_on_grid(geometry, cylinder, joint, alone=alone))
        if reach is None:
            continue
        after = max(lower, reach[0]), min(upper, reach[1])
        if after != (lower, upper) and after[0] < after[1]:
            changes.append(NarrowedLimits(joint, cylinder.name, (lower, upper), after))
    return machine.with_joint_limits({change.joint: change.after for change in changes}), tuple(changes)


def _reach_on_grid(geometry: Geometry, cylinder: Cylinder, joint: str, *, alone: bool) -> tuple[float, float] | None:
    """Angles [rad] about the middle of a joint's range that stroke, lever arm and loops allow; None if none.

    A cylinder that is not `alone` at its joint may pass its dead point.
    """
    q, (lower, upper) = ca.SX.sym("q"), geometry.machine.link(joint).joint.range
    mechanism = Mechanism(geometry.machine)
    at = mechanism.positions(geometry, {joint: q})
    length = ca.norm_2(geometry.pin(cylinder, "rod", at) - geometry.pin(cylinder, "barrel", at))
    sines = ca.vertcat(*mechanism.sines(geometry, {joint: q}))
    function = ca.Function("length", [q], [length, ca.jacobian(length, q), sines])
    middle = (lower + upper) / 2
    sign = np.sign(float(function(middle)[1]))

    def usable(angle: float) -> bool:
        found, arm, clear = (np.asarray(values).ravel() for values in function(angle))
        stroke = found[0] - cylinder.dead_length
        works = arm[0] * sign > 0 or not alone
        return bool(0 <= stroke <= cylinder.stroke and works and np.all(np.abs(clear) > np.sin(FLAT)))

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
