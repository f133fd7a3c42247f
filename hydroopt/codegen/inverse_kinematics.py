"""The routine of inverse kinematics: the posture in which the tip is at a place, on the branch that the caller names.

A slewing joint and two parallel ones after it, or one or two parallel joints alone, have a closed form. It starts
Newton's method on the geometry as it is calibrated, whose axes are parallel and perpendicular only nearly.
"""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca
import numpy as np

from hydroopt.codegen.symbols import Field, Guard, Kind, Routine, Symbols
from hydroopt.machine.geometry import Geometry
from hydroopt.machine.machine import BASE
from hydroopt.machine.mechanism import Mechanism
from hydroopt.spatial.poses import Pose, rotation_z

STEPS = 5
"""Steps of Newton's method: axes that are 0.1 rad from parallel need four of them."""
ALIGNED = 0.98
"""Cosine of the angle between axes from which they count as nearly parallel."""
ACROSS = 0.2
"""Cosine of the angle between axes up to which they count as nearly perpendicular."""
FOLDED = 0.9999
"""Cosine of the angle between two parts of the arm at which Newton's method starts at most."""
BEYOND = 1.02
"""Cosine of that angle from which the target is out of reach, however the axes lean."""
GAP = 1e-4
"""Distance [m] of the tip from the target from which it counts as missed."""
SHORTEST = 1e-6
"""Length [m] of a part of the arm below which it counts as none."""
STRETCHED = 1e-3
"""Volume of the directions in which the joints move the tip, below which these do not determine the posture."""


class Arm(NamedTuple):
    """The joints that are solved for, from the base to the tip, and those that are held."""

    solved: tuple[str, ...]
    held: tuple[str, ...]


def arm(api: Symbols) -> Arm:
    """The first three joints that move the tip, or as many as there are, and all others."""
    machine = api.machine
    onto = [name for name in reversed(machine.ancestry(machine.tip)) if name in machine.joints]
    return Arm(tuple(onto[:3]), tuple(joint for joint in machine.joints if joint not in onto[:3]))


def no_arm(api: Symbols) -> str:
    """Why a machine has no closed form; "" if it has one."""
    solved, machine = arm(api).solved, api.machine
    followed = machine.followed
    for joint in machine.ancestry(machine.tip):
        if joint in followed and joint not in machine.joints and (not solved or {*solved} & {*followed[joint]}):
            return f"{joint}, which moves the tip, follows {', '.join(followed[joint])} through a linkage"
    if not solved:
        return "no joint moves the tip"
    if any(machine.link(joint).joint.type != "revolute" for joint in solved):
        return f"{', '.join(solved)} do not all turn"
    frames, tip = _steps(Geometry(machine), solved, {})
    steps = [np.array(ca.DM(step.rotation))[2, 2] for step in frames[1:]]
    if (len(solved) == 3 and abs(steps[0]) > ACROSS) or (len(solved) > 1 and abs(steps[-1]) < ALIGNED):
        return f"{', '.join(solved)} are not one joint with two parallel ones across it, nor parallel"
    if not ca.symvar(ca.SX(tip)) and _off_axis(tip) < SHORTEST:
        return f"the tip, the far end of {machine.tip}, lies on the axis of {solved[-1]}, which cannot move it"
    if len(solved) > 1 and _off_axis(frames[-1].origin) < SHORTEST:
        return f"the axes of {solved[-2]} and {solved[-1]} coincide"
    return ""


def _off_axis(point: ca.SX) -> float:
    """Distance [m] of a point from the z axis."""
    x, y = np.array(ca.DM(point)).ravel()[:2]
    return float(np.hypot(x, y))


def _steps(geometry: Geometry, solved: tuple[str, ...], q: dict[str, ca.SX]) -> tuple[list[Pose], ca.SX]:
    """Frame of each solved joint at zero in the frame of the one before it, and the tip in the last one."""
    machine, steps, before = geometry.machine, [], BASE
    for joint in solved:
        steps.append(geometry.far_end(before) @ geometry.relative_pose(before, joint, {}))
        before = joint
    tip = geometry.far_end(before)
    if machine.tip != before:
        at = Mechanism(machine).positions(geometry, q)
        tip = tip @ geometry.relative_pose(before, machine.tip, at) @ geometry.far_end(machine.tip)
    return steps, tip.origin


def inverse_kinematics(api: Symbols) -> Routine:
    """Joints that bring the tip to a place."""
    machine, (solved, held) = api.machine, arm(api)
    api.kinds["held"] = Kind(held, tuple(machine.channel_units[f"{joint}.q"] for joint in held))
    position = api.symbol("position", 3)
    given = {joint: api.symbol("held", len(held))[k] for k, joint in enumerate(held)}
    steps, tip = _steps(api.dynamics.geometry, solved, given)
    nominal = np.array(ca.DM(_steps(Geometry(machine), solved, {})[0][-1].rotation))
    target = steps[0].inverse().point(position)
    signs = {name: ca.sign(ca.sign(api.symbol(name, 1)) + 0.5) for name in ("reach", "elbow")[3 - len(solved):]}
    start, cosines = _closed_form(steps, tip, target, signs, 1.0 if nominal[2, 2] > 0 else -1.0)
    angles, volume, gap = _newton(steps, tip, target, start)
    found = {joint: _near(angle, sum(machine.link(joint).joint.range) / 2)
             for joint, angle in zip(solved, angles, strict=True)} | given
    q = ca.vertcat(*(found[joint] for joint in machine.joints))
    lower, upper = machine.ranges.T
    texts = {"reach": "1 or -1: which of the two ways the first joint turns the arm to the target",
             "elbow": "1 or -1: which of the two ways the arm bends"}
    takes = api.struct(
        "target", "A place for the tip, and the branch of the arm.",
        Field("position", (3,), "m", f"far end of {machine.tip} in the base frame: x, y, z"),
        *(Field(name, (1,), "1", texts[name]) for name in signs),
        Field("held", ("held",), "rad or m", "position of each joint that is held"))
    gives = api.struct(
        "posture", "The posture in which the tip is there, on one branch.",
        Field("q", ("joint",), "rad or m", "position of each joint"),
        Field("outside", ("joint",), "rad or m", "how far each joint is outside its limits, 0 inside; the limits are "
              "part of the code"))
    guards = (*(Guard(cosine, "<", BEYOND, "UNREACHABLE", absolute=True) for cosine in cosines),
              Guard(volume, ">", STRETCHED, "SINGULAR", absolute=True), Guard(gap, "<", GAP, "UNREACHABLE"))

    def there(value: ca.SX) -> ca.SX:
        return ca.substitute(value, api.coordinates.q, q)

    guards += tuple(guard._replace(value=there(guard.value)) for guard in api.guards(levers=True))
    return Routine("inverse_kinematics", f"The posture that brings the tip to a place by {', '.join(solved)}"
                   f"{', while the others are held' if held else ''}. Call it for each value of "
                   f"{' and '.join(signs)} to have all branches." if signs else
                   f"The posture that brings the tip to a place by {solved[0]}.", takes,
                   ("position", *signs, *(("held",) if held else ())), gives,
                   {"q": q, "outside": ca.fmax(ca.fmax(lower - q, q - upper), 0.0)}, guards,
                   None if api.lengths is None else there(api.lengths))


def _closed_form(steps: list[Pose], tip: ca.SX, target: ca.SX, signs: dict[str, ca.SX],
                 turn: float) -> tuple[list[ca.SX], list[ca.SX]]:
    """Angles of the arm as if its axes were exactly parallel and perpendicular, and the cosines that must be in reach.

    `turn` is 1 where the axes of the last two joints point the same way, −1 where they are opposed.
    """
    if len(steps) == 1:
        return [_direction(target) - _direction(tip)], []
    angles, cosines = [], []
    if len(steps) == 3:
        # the plane in which the arm moves has the normal n and the tip's height over it, whatever the last angles
        axis, normal = steps[1].origin, steps[1].rotation[:, 2]
        height = steps[2].point(ca.vertcat(0, 0, tip[2]))[2] + ca.dot(normal, axis) - normal[2] * target[2]
        cosine = height / (ca.norm_2(normal[:2]) * ca.norm_2(target[:2]))
        angles.append(_direction(target) - _direction(normal) + signs["reach"] * _bend(cosine))
        target = steps[1].inverse().point(rotation_z(-angles[0]) @ target)
        cosines.append(cosine)
    elbow = steps[-1]
    first, second = elbow.origin, elbow.rotation @ ca.vertcat(tip[0], tip[1], 0)
    lengths = ca.norm_2(first[:2]), ca.norm_2(tip[:2])
    cosine = (ca.sumsqr(target[:2]) - lengths[0]**2 - lengths[1]**2) / (2 * lengths[0] * lengths[1])
    last = turn * (signs["elbow"] * _bend(cosine) - _direction(second) + _direction(first))
    whole = elbow.point(rotation_z(last) @ tip)
    return [*angles, _direction(target) - _direction(whole), last], [*cosines, cosine]


def _newton(steps: list[Pose], tip: ca.SX, target: ca.SX, start: list[ca.SX]) -> tuple[list[ca.SX], ca.SX, ca.SX]:
    """Angles that bring the tip to the target, volume of the directions in which they move it, and its distance left.

    Fewer than three joints have parallel axes: they bring it there across these axes alone.
    """
    count = len(steps)

    def place(angles: list[ca.SX]) -> tuple[ca.SX, list[ca.SX]]:
        """The tip, and how each joint moves it, in the frame of the first joint."""
        frame, origins, axes = Pose(rotation_z(angles[0]), ca.SX(3, 1)), [ca.SX(3, 1)], [ca.SX([0, 0, 1])]
        for step, angle in zip(steps[1:], angles[1:], strict=True):
            frame = frame @ step
            origins, axes = [*origins, frame.origin], [*axes, frame.rotation[:, 2]]
            frame = frame @ Pose(rotation_z(angle), ca.SX(3, 1))
        there = frame.point(tip)
        return there, [ca.cross(axis, there - origin) for axis, origin in zip(axes, origins, strict=True)]

    angles = start
    for _ in range(STEPS if count > 1 else 0):
        there, ways = place(angles)
        gap = target - there
        if count == 2:
            ways, gap = [*(ca.vertcat(way[:2], 0) for way in ways), ca.SX([0, 0, 1])], ca.vertcat(gap[:2], 0)
        a, b, c = ways
        across = ca.cross(b, c), ca.cross(c, a), ca.cross(a, b)
        volume = ca.dot(a, across[0])
        angles = [angle + ca.dot(each, gap) / volume for angle, each in zip(angles, across, strict=False)]
    there, ways = place(angles)
    if count == 1:
        volume = ca.norm_2(ways[0][:2])
    elif count == 2:
        volume = (ways[0][0] * ways[1][1] - ways[0][1] * ways[1][0]) / (ca.norm_2(ways[0][:2]) * ca.norm_2(ways[1][:2]))
    else:
        volume = ca.dot(ways[0], ca.cross(ways[1], ways[2])) / (
            ca.norm_2(ways[0]) * ca.norm_2(ways[1]) * ca.norm_2(ways[2]))
    return angles, volume, ca.norm_2(target - there)


def _bend(cosine: ca.SX) -> ca.SX:
    return ca.acos(ca.fmax(ca.fmin(cosine, FOLDED), -FOLDED))


def _direction(vector: ca.SX) -> ca.SX:
    return ca.atan2(vector[1], vector[0])


def _near(angle: ca.SX, middle: float) -> ca.SX:
    """The same angle within half a turn of the middle of a joint's range."""
    return middle + ca.atan2(ca.sin(angle - middle), ca.cos(angle - middle))
