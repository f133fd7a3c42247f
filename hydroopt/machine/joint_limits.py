"""Joint limits that strokes permit: limits of a machine file are often assumed or rounded, strokes are not."""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca
import numpy as np

from hydroopt.machine.actuators import Cylinder
from hydroopt.machine.geometry import Geometry
from hydroopt.machine.machine import Machine
from hydroopt.machine.mechanism import Mechanism
from hydroopt.machine.range_checks import FLAT, POINTS, expressed, length
from hydroopt.spatial.inertia import Array

INSIDE = 1e-6
"""How far inside the end of a stroke, or inside a dead point, a limit is set [rad, m]."""
BESIDE = 25
"""Points of the range of each other joint that moves a cylinder."""


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
    drivers, changes = machine.drivers, []
    entangled = {joint for group in machine.entangled for joint in group}
    for cylinder in sorted(machine.cylinders, key=lambda each: len(machine.moved_by(each))):
        joint, moved = machine.main_joint(cylinder), machine.moved_by(cylinder)
        if joint in entangled or len(moved) not in POINTS:
            continue
        others = tuple(name for name in moved if name != joint)
        before = machine.link(joint).joint.range
        after = _reach(machine, cylinder, joint, others, alone=len(drivers[joint]) == 1)
        if after is not None and after != before and after[0] < after[1]:
            changes.append(NarrowedLimits(joint, cylinder.name, before, after, others))
            machine = machine.with_joint_limits({joint: after})
    return machine, tuple(changes)


def _reach(machine: Machine, cylinder: Cylinder, joint: str, others: tuple[str, ...], *,
           alone: bool) -> tuple[float, float] | None:
    """The part of a joint's range [rad, m] nearest to its middle in which stroke, lever arm and loops allow all
    positions, wherever other joints stand; None if there is none.

    A cylinder that is not `alone` at its joint may pass its dead point.
    """
    geometry, mechanism, names = Geometry(machine), Mechanism(machine), (joint, *others)
    function = expressed(geometry, names, lambda q, at: [ca.vertcat(
        (found := length(geometry, cylinder, at)) - cylinder.dead_length, ca.jacobian(found, q[0]),
        *mechanism.sines(geometry, {name: at[name] for name in names}))])
    axes = [np.linspace(*machine.link(name).joint.range, BESIDE) for name in others]
    beside = np.stack([values.ravel() for values in np.meshgrid(*axes, indexing="ij")]) if others else np.zeros((0, 1))

    def sign(positions: Array) -> Array:
        """Of the lever arm at positions (N,) where all of them are usable, else 0."""
        states = np.vstack([np.repeat(positions, beside.shape[1]), np.tile(beside, len(positions))])
        stroke, arm, *clear = np.asarray(function(states)).reshape(-1, len(positions), beside.shape[1])
        works = (stroke >= 0) & (stroke <= cylinder.stroke) & np.all(np.abs(clear) > np.sin(FLAT), axis=0)
        turns = np.sign(arm[:, :1]) if alone else np.ones((len(positions), 1))
        return np.asarray(np.where(np.all(works & (turns * arm > 0 if alone else True), axis=1), turns[:, 0], 0.0))

    lower, upper = machine.link(joint).joint.range
    grid = np.linspace(lower, upper, 361)
    found = sign(grid)
    if not found.any():
        return None
    start = min(np.flatnonzero(found), key=lambda k: abs(k - len(grid) // 2))
    ends = []
    for end in (0, len(grid) - 1):
        step = 1 if end else -1
        bad = next((k for k in range(start, end + step, step) if found[k] != found[start]), None)
        if bad is None:
            ends.append(float(grid[end]))
            continue
        good, past = float(grid[bad - step]), float(grid[bad])
        while abs(past - good) > 1e-5 * INSIDE:
            half = (good + past) / 2
            good, past = (half, past) if sign(np.array([half]))[0] == found[start] else (good, half)
        ends.append(good - step * INSIDE)
    return ends[0], ends[1]
