"""Joints of q from readings that depend on them: lengths of cylinders, angles of joints that follow them; by Newton.

No closed form gives such a joint: a tilt cylinder spans the boom, all six cylinders of a platform move all of its
joints, a sensor sits on the rocker of a linkage. Every sample of a log is solved by itself: from mid-range, where the
readings are known, they are led to the measured ones in small steps, so that the joints stay on the branch that
mid-range is on. For generated code a fixed number of Newton's steps starts at a polynomial of the lengths, fitted over
the ranges of the joints; a slide with a cylinder of its own follows from the length in closed form.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from hydroopt.machine.actuators import Cylinder
from hydroopt.machine.general_loops import Start, moved_aside, newton_start, spread
from hydroopt.machine.geometry import Geometry
from hydroopt.model.joint_from_length import joint_from_length
from hydroopt.model.least_squares_by_sample import nearest
from hydroopt.model.model import Model
from hydroopt.model.regressor import Dynamics
from hydroopt.spatial.inertia import Array

ALONG, CORRECTIONS = 16, 2
"""Steps from the readings at mid-range to the measured ones, and Newton's steps in each of them."""
LAST = 4
"""Newton's steps at the measured readings."""
STILL, SINGULAR = 1e-10, 1e7
"""Last step [rad or m] from which on Newton's method counts as converged, and the condition number of the readings'
derivatives from which on they do not tell the joints."""


def joints_from_readings(model: Model, q: Array, solved: Sequence[int], channels: Sequence[str],
                         measured: Array) -> Array:
    """Joint vectors (N, n) at which readings are the measured ones; NaN where Newton's method does not converge.

    Args:
        model: the machine.
        q: (N, n) positions of all other joints; those of the joints that are solved for do not matter.
        solved: places of the joints that are solved for, in q.
        channels: ``<cylinder>.length`` or ``<dependent joint>.q``, at least as many; of more, squares of errors are
            least.
        measured: (N, c) [m or rad] of these channels; angles are those nearest to mid-range, whatever turns they count.

    >>> from hydroopt.machine.machine_file import load_machine
    >>> model = Model(load_machine("excavator_bucket"))
    >>> q = np.array([[0.1, -0.4, -1.6, -0.3]])
    >>> channels = ["stick_cylinder.length", "rocker.q"]
    >>> measured, _ = readings(model, q, channels)
    >>> joints_from_readings(model, q * [1, 1, 0, 0], [2, 3], channels, measured).round(9)
    array([[ 0.1, -0.4, -1.6, -0.3]])
    """
    machine, own = model.machine, list(solved)
    q = q.copy()
    q[:, own] = machine.ranges[own].mean(axis=1)
    begin = readings(model, q, channels)[0]
    turning = [machine.channel_units[channel] == "rad" for channel in channels]
    whole = np.where(turning, 2 * np.pi * np.round((measured - begin) / (2 * np.pi)), 0.0)
    away, moved = measured - whole - begin, np.zeros(len(q))
    for share, count in [*((k / ALONG, CORRECTIONS) for k in range(1, ALONG + 1)), (1.0, LAST)]:
        def rows(own_q: Array, which: NDArray[np.intp], share: float = share) -> tuple[Array, Array]:
            tried = q[which]
            tried[:, own] = own_q
            found, arms = readings(model, tried, channels)
            return found - (begin + share * away)[which], arms[:, :, own]

        q[:, own], _, moved = nearest(rows, q[:, own], steps=count, still=STILL, damped=False)
    arms = readings(model, q, channels)[1][:, :, own]
    q[~(moved < STILL) | ~(np.linalg.cond(arms) < SINGULAR)] = np.nan
    return q


def readings(model: Model, q: Array, channels: Sequence[str]) -> tuple[Array, Array]:
    """Lengths of cylinders, positions of dependent joints (N, c) [m or rad] by channel, and derivatives (N, c, n)."""
    machine = model.machine
    found: dict[str, tuple[Array, Array]] = {}
    if any(channel.endswith(".length") for channel in channels):
        length, _, _, arms, _ = model.over(model.cylinder_kinematics, q, 0 * q, 0 * q)
        found |= {f"{each.name}.length": (length[:, k, 0], arms[:, k]) for k, each in enumerate(machine.cylinders)}
    if any(channel.endswith(".q") for channel in channels):
        position, by_q = model.over(model.dependent_positions, q)
        found |= {f"{joint}.q": (position[:, k, 0], by_q[:, k]) for k, joint in enumerate(machine.dependent_joints)}
    return (np.column_stack([found[channel][0] for channel in channels]),
            np.stack([found[channel][1] for channel in channels], axis=1))


CALIBRATED = 0.01
"""How far [m] calibrated geometry may move lengths from those of the machine file."""


class Slide(NamedTuple):
    """A joint that slides, and the place of the one cylinder that moves it; `sign` is that of its lever arm."""

    joint: int
    cylinder: int
    sign: int

    def solved(self, geometry: Geometry, length: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Position [m] at a length [m], and the square (q + b/2)² in l² = q² + b·q + c: negative where there is none.
        """
        machine, x = geometry.machine, ca.SX.sym("x")
        at, cylinder = {machine.joints[self.joint]: x}, machine.cylinders[self.cylinder]
        square = ca.sumsqr(geometry.pin(cylinder, "rod", at) - geometry.pin(cylinder, "barrel", at))
        half, rest = (ca.substitute(each, x, 0) for each in (ca.jacobian(square, x) / 2, square))
        under = length**2 + half**2 - rest
        return self.sign * ca.sqrt(under) - half, under


class Together(NamedTuple):
    """Joints that lengths of cylinders give together.

    Attributes:
        joints: their places in q.
        cylinders: places of the cylinders that move them, as many or more.
        given: places of other joints that these cylinders move, too.
        start: a polynomial of the cylinders' lengths and of the joints given.
        steps: the number of Newton's steps from it.
    """

    joints: tuple[int, ...]
    cylinders: tuple[int, ...]
    given: tuple[int, ...]
    start: Start
    steps: int

    def solved(self, dynamics: Dynamics, q: ca.SX, length: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Positions of the joints, the last step, and all lever arms there (c, n).

        Args:
            dynamics: the machine's expressions.
            q: (n,) with the joints that are given.
            length: (c,) [m] of these cylinders.
        """
        own, at = list(self.joints), ca.densify(q)
        known, arms = _lengths(dynamics, self.cylinders)
        at[own] = self.start.at(ca.vertsplit(ca.vertcat(length, *(q[k] for k in self.given))))
        step = ca.SX(0)
        for _ in range(self.steps):
            found, slope = ca.substitute([known, arms], [dynamics.coordinates.q], [at])
            step = back(slope[:, own], length - found)
            at[own] += step
        return at[own], step, ca.substitute(arms, dynamics.coordinates.q, at)


def back(arms: ca.SX, lengths: ca.SX) -> ca.SX:
    """Joints that move as lengths do, by lever arms (c, n) of full rank: with least squares where lengths are more."""
    arms = ca.densify(arms)
    if arms.size1() == arms.size2():
        return ca.solve(arms, lengths)
    return ca.solve(arms.T @ arms, arms.T @ lengths)


def _lengths(dynamics: Dynamics, cylinders: tuple[int, ...]) -> tuple[ca.SX, ca.SX]:
    names = [dynamics.machine.cylinders[k].name for k in cylinders]
    length = ca.vertcat(*(dynamics.cylinders[name].length for name in names))
    return length, ca.jacobian(length, dynamics.coordinates.q)


def slides(model: Model) -> tuple[Slide, ...]:
    """The joints that slide and whose cylinder moves nothing else."""
    machine, found = model.machine, []
    for k, cylinder in enumerate(machine.cylinders):
        moved = machine.moved_by(cylinder)
        between = machine.joints_between(cylinder.barrel.link, cylinder.rod.link)
        if moved == between and len(moved) == 1 and machine.drivers[moved[0]] == (cylinder,) and machine.link(
                moved[0]).joint.type == "prismatic":
            j, middle = machine.joints.index(moved[0]), machine.ranges.mean(axis=1)
            arm = model.transmission(middle)[machine.actuators.index(cylinder), j]
            found.append(Slide(j, k, int(np.sign(float(arm)))))
    return tuple(found)


def together(model: Model) -> tuple[Together, ...]:
    """All joints that several lengths give, or one that is no side of a triangle, in groups that share cylinders.

    Left out are groups with fewer cylinders than joints, and those whose lengths do not tell the joints apart.
    """
    machine = model.machine
    alone = [machine.moved_by(each) for each in machine.cylinders]
    known = {found.joint for each in machine.cylinders if (found := joint_from_length(model.geometry, each))
             and alone.count((found.joint,)) == 1} | {machine.joints[one.joint] for one in slides(model)}
    groups: list[tuple[set[str], list[Cylinder]]] = []
    for cylinder in machine.cylinders:
        joints, with_it = set(machine.moved_by(cylinder)) - known, [cylinder]
        if not joints:
            continue
        for group in [each for each in groups if each[0] & joints]:
            groups.remove(group)
            joints, with_it = joints | group[0], [*group[1], *with_it]
        groups.append((joints, with_it))
    made = (_fitted(model, [joint for joint in machine.joints if joint in joints], cylinders)
            for joints, cylinders in groups if len(cylinders) >= len(joints))
    return tuple(each for each in made if each is not None)


def _fitted(model: Model, joints: list[str], cylinders: list[Cylinder]) -> Together | None:
    """A start, and as many steps as bring all samples of the joints' ranges to rounding; None if none do."""
    machine = model.machine
    moved = {joint for each in cylinders for joint in machine.moved_by(each)}
    given = [joint for joint in machine.joints if joint in moved and joint not in joints]
    own, others, read = (tuple(names.index(each) for each in chosen) for names, chosen in (
        (machine.joints, joints), (machine.joints, given), ([each.name for each in machine.cylinders],
                                                            [each.name for each in cylinders])))
    free = [*own, *others]
    drawn = spread(machine.ranges[free])
    q = np.tile(machine.ranges.mean(axis=1)[:, None], (1, drawn.shape[1]))
    q[free] = drawn
    function = ca.Function("lengths", [model.dynamics.coordinates.q],
                           [ca.densify(each) for each in _lengths(model.dynamics, read)])

    def lengths(at: Array) -> tuple[Array, Array]:
        found, arms = (np.array(each) for each in function.map(at.shape[1])(at))
        return found, arms.reshape(len(read), at.shape[1], -1).transpose(1, 0, 2)[:, :, list(own)]

    measured = lengths(q)[0]
    inputs = np.vstack([measured, q[list(others)]])
    other = np.vstack([measured + CALIBRATED * moved_aside(measured), q[list(others)]])

    def step(at: Array) -> Array:
        tried = q.copy()
        tried[list(own)] = at
        found, arms = lengths(tried)
        if not np.all(np.isfinite(found)) or not np.all(np.isfinite(arms)):
            return np.full_like(at, np.nan)
        return np.asarray(at + np.einsum("nji,in->jn", np.linalg.pinv(arms), measured - found))

    made = newton_start(inputs, q[list(own)], lambda start: start.coefficients @ np.array(start.terms(other)), step)
    return Together(own, read, others, *made) if made else None
