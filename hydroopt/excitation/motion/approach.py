"""From where a machine stands to the first posture of a motion, slowly and within all limits.

Edges of the path are straight in the joints' positions, from rest to rest. If the direct one breaks a limit, two trees
of random postures grow towards each other (RRT-Connect, Kuffner and LaValle 2000), and what they find is shortened. A
machine may stand closer to a limit than reserves allow, with its bucket on the ground: there the approach keeps at
least what the machine has at its start.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from hydroopt.errors import ProblemError
from hydroopt.excitation.motion.basis import Spline
from hydroopt.excitation.motion.problem import State
from hydroopt.limits.limits import ROUNDING, Limits
from hydroopt.machine.machine import Machine
from hydroopt.results.readable import readable
from hydroopt.simulation.passive_joints import passive_motion
from hydroopt.simulation.simulate import Trajectory
from hydroopt.spatial.inertia import Array

PACE = 0.25
"""Part of the joints' largest speeds and accelerations that an approach uses."""
UNSTATED = 0.2
"""Part of a joint's range that counts as its largest speed and acceleration where none is stated."""
FINE = 0.005
"""Distance of the postures at which an edge is checked, as a part of the joints' ranges."""
STEP, TRIES = 0.15, 3000
"""Longest edge of a tree, as a part of the joints' ranges, and how many random postures are tried."""
SHORTCUTS, SLOWER, ROUNDS = 60, 1.4, 14
"""How many shortcuts are tried; the factor of time by which an edge that breaks a limit is slowed, and how often."""
BACK_OFF = 0.004
"""Part of a limit's scale that postures on the way keep beyond it."""


@dataclass(frozen=True, eq=False)
class Approach:
    """A safe motion from where the machine stands.

    Attributes:
        postures: (k, n) from the start to the first posture of the motion, between which it moves straight.
        arrivals: (k,) times [s] at which it rests there.
        trajectory: its samples.
        short: names of the limits of which the machine has less at its start than the reserves.
    """

    postures: Array
    arrivals: Array
    trajectory: Trajectory
    short: tuple[str, ...]


def start_of(machine: Machine, stated: Mapping[str, float], goal: Array) -> Array:
    """Where a machine stands (n,): joints that are not stated stand at the goal (n,).

    Raises:
        ProblemError: a joint does not exist, or stands out of its range.
    """
    found = np.array(goal, dtype=float)
    for name, value in stated.items():
        if name not in machine.joints:
            raise ProblemError(f"'{name}' is not a moving joint", where="--start",
                               remedy=f"use {', '.join(machine.joints)}")
        lower, upper = machine.link(name).joint.range
        if not lower <= value <= upper:
            at, low, high = (readable(each, machine.channel_units[f"{name}.q"], 4) for each in (value, lower, upper))
            raise ProblemError(f"joint '{name}' cannot stand at {at}: its range is {low} to {high}", where="--start",
                               remedy="give a position within its range")
        found[machine.joints.index(name)] = value
    return found


def approach(limits: Limits, start: Array, goal: Array, rate: float, *, seed: int = 0) -> Approach:
    """A motion from rest at one posture (n,) to rest at another one within all limits.

    Args:
        limits: with the reserves to keep.
        start: where the machine stands.
        goal: where the motion begins.
        rate: samples per second.
        seed: of the random postures.

    Raises:
        ProblemError: the machine stands where a limit is broken, or no way was found; the sentence names limits.

    Example:
        >>> import hydroopt as ho
        >>> limits = Limits(ho.Model(ho.load_machine("cat215b")))
        >>> found = approach(limits, np.array([0.0, -0.5, 2.4]), np.array([0.5, -0.2, 2.0]), 50.0)
        >>> found.trajectory.q[[0, -1]].round(3).tolist()
        [[0.0, -0.5, 2.4], [0.5, -0.2, 2.0]]
    """
    return _Search(limits, start, goal, seed).found(rate)


class _Search:
    def __init__(self, limits: Limits, start: Array, goal: Array, seed: int) -> None:
        self.limits, self.rng = limits, np.random.default_rng(seed)
        self.low, self.high = limits.model.machine.ranges.T
        self.size = self.high - self.low
        self.start, self.goal = limits.hanging.postures(np.array([start, goal]))
        at_start = self._at_rest(self.start[None])[0]
        itself = limits.without_reserves()
        self._refuse(itself)
        # a start that leaves less than the reserves is left by motion, which takes a little of it, never of the limit
        self.lower = np.minimum(limits.lower, np.maximum(at_start - BACK_OFF,
                                                         np.minimum(itself.lower, at_start - ROUNDING)))
        self.upper = np.maximum(limits.upper, np.minimum(at_start + BACK_OFF,
                                                         np.maximum(itself.upper, at_start + ROUNDING)))
        # postures on the way keep a little more than both ends leave, since motion adds to what they ask for
        ends = self._at_rest(np.array([self.start, self.goal]))
        self.at_rest = (np.minimum(limits.lower + BACK_OFF, np.min(ends, axis=0) - ROUNDING),
                        np.maximum(limits.upper - BACK_OFF, np.max(ends, axis=0) + ROUNDING))
        self.short = tuple(limits.names(limits.excess(at_start[None])[0] > 0))

    def _refuse(self, itself: Limits) -> None:
        """Refuse a start that breaks a limit even without reserves."""
        still = np.zeros((1, len(self.start)))
        excess = itself.excess(itself.values(self.start[None], still, still))[0]
        k = int(np.argmax(excess))
        if excess[k] > ROUNDING:
            row = itself.rows[k]
            raise ProblemError(f"where the machine stands, {row.name} is beyond its limit by "
                               f"{excess[k] * row.scale:.3g} {row.unit}", where="--start",
                               remedy="correct the posture, or the limit in the machine file")

    def _at_rest(self, q: Array) -> Array:
        return self.limits.values(q, 0 * q, 0 * q)

    def _kept(self, values: Array) -> bool:
        return bool(np.all((values >= self.lower) & (values <= self.upper)))

    def _kept_at_rest(self, q: Array) -> bool:
        values, (lower, upper) = self._at_rest(q), self.at_rest
        return bool(np.all((values >= lower) & (values <= upper)))

    def _free(self, one: Array, other: Array) -> bool:
        """Whether all postures of an edge keep limits at rest."""
        count = int(np.ceil(np.max(np.abs(other - one) / self.size) / FINE)) + 2
        q = one + np.linspace(0, 1, count)[:, None] * (other - one)
        return self._kept_at_rest(self.limits.hanging.postures(q))

    def found(self, rate: float) -> Approach:
        """The approach at some samples per second."""
        path = self._shortened(self._path())
        edges = [self._timed(one, other, rate) for one, other in pairwise(path)]
        arrivals = np.cumsum([0.0, *(each.t[-1] for each in edges)])
        times = [at + each.t for at, each in zip(arrivals, edges, strict=False)]
        t, q, qd, qdd = (np.concatenate([some[0][:1], *(each[1:] for each in some)]) for some in (
            times, *([getattr(each, key) for each in edges] for key in State._fields)))
        return Approach(path, arrivals, Trajectory(t, q, qd, qdd), self.short)

    def _path(self) -> Array:
        if self._free(self.start, self.goal):
            return np.array([self.start, self.goal])
        if not self._kept(self._at_rest(self.goal[None])):
            raise ProblemError("the motion's first posture does not keep limits at rest", where="approach",
                               remedy="design the motion anew")
        trees = [([self.start], [-1]), ([self.goal], [-1])]
        for k in range(TRIES):
            growing, other = trees[k % 2], trees[1 - k % 2]
            drawn = self.rng.uniform(self.low, self.high)
            if self.limits.hanging.joints:
                drawn = self.limits.hanging.postures(drawn[None])[0]
            new = self._grown(growing, drawn)
            if new is None:
                continue
            while (near := self._grown(other, new)) is not None and np.any(near != new):
                pass
            if near is not None:
                ways = [_way(growing), _way(other)]
                first, last = ways if k % 2 == 0 else ways[::-1]
                return np.array([*first[::-1], *last[1:]])
        raise ProblemError(f"no way was found from where the machine stands to the motion's first posture: "
                           f"{', '.join(self._between())} cannot be kept in between", where="--start",
                           remedy="drive the machine nearer by hand, state another start, or keep smaller reserves")

    def _between(self) -> list[str]:
        """Limits that the direct way breaks."""
        q = self.start + np.linspace(0, 1, 100)[:, None] * (self.goal - self.start)
        return self._broken(self._at_rest(self.limits.hanging.postures(q))) or ["limits"]

    def _broken(self, values: Array) -> list[str]:
        return self.limits.names(np.any((values < self.lower) | (values > self.upper), axis=0))

    def _grown(self, tree: tuple[list[Array], list[int]], towards: Array) -> Array | None:
        """The posture that a step from the nearest one of a tree reaches, if the way there is free."""
        nodes, parents = tree
        away = (towards - np.array(nodes)) / self.size
        nearest = int(np.argmin(np.max(np.abs(away), axis=1)))
        distance = float(np.max(np.abs(away[nearest])))
        new = towards if distance <= STEP else nodes[nearest] + STEP / distance * (towards - nodes[nearest])
        if distance == 0:
            return new
        if not self._free(nodes[nearest], new):
            return None
        nodes.append(new)
        parents.append(nearest)
        return new

    def _shortened(self, path: Array) -> Array:
        for _ in range(SHORTCUTS if len(path) > 2 else 0):
            one, other = sorted(self.rng.choice(len(path), 2, replace=False))
            if other > one + 1 and self._free(path[one], path[other]):
                path = np.vstack([path[: one + 1], path[other:]])
            if len(path) == 2:
                break
        return path

    def _timed(self, one: Array, other: Array, rate: float) -> Trajectory:
        """The edge from rest to rest, as slow as limits ask for."""
        model, change = self.limits.model, other - one
        joints = [model.machine.link(joint).joint for joint in model.machine.joints]
        speed, acceleration = (np.array([PACE * (getattr(joint, key) or UNSTATED * size) for joint, size
                                         in zip(joints, self.size, strict=True)])
                               for key in ("max_speed", "max_acceleration"))
        # a spline of one piece has the speed 1.875 and the acceleration 5.774 at most, in units of way and duration
        duration = max(float(np.max(1.875 * np.abs(change) / speed)),
                       float(np.sqrt(np.max(5.774 * np.abs(change) / acceleration))), 2 / rate)
        for _ in range(ROUNDS):
            t = np.arange(int(np.ceil(duration * rate)) + 1) / rate
            states = State(*(part @ np.array([one, other]) for part in Spline(float(t[-1]), 1).rows(t)))
            moved = passive_motion(model, t, states, model.parameters.nominal)
            if self._kept(self.limits.values(*moved)):
                return Trajectory(t, *moved)
            duration *= SLOWER
        names = ", ".join(self._broken(self.limits.values(*moved)))
        raise ProblemError(f"{names} cannot be kept on the way to the motion's first posture, however slowly",
                           where="--start", remedy="drive the machine nearer by hand, or keep smaller reserves")


def _way(tree: tuple[list[Array], list[int]]) -> list[Array]:
    """From the last posture of a tree to its root."""
    nodes, parents = tree
    at, found = len(nodes) - 1, []
    while at >= 0:
        found.append(nodes[at])
        at = parents[at]
    return found
