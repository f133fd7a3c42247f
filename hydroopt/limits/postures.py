"""The limits that postures at rest keep, with their reserves, and that straight moves between them keep.

At rest nothing flows: speeds and the pump's flow do not count, and of pressures and valves what it takes to hold the
posture under the uncertain masses. The machine does not tip over. A calibrator's joints stay above ground, and its
links away from obstacles. Its weight does not count, and its distance from the machine's own parts is not looked at.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from copy import copy
from typing import NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from hydroopt.limits.limits import ROUNDING, Limits
from hydroopt.limits.reserves import DEFAULT, Reserves
from hydroopt.machine.machine import BASE, Machine
from hydroopt.machine.survey import TIP
from hydroopt.model.closed_chain import KinematicModel
from hydroopt.model.model import Model
from hydroopt.spatial.inertia import Array

FINE = 0.02
"""Distance of the postures at which a move is looked at, as a part of the joints' ranges."""
NAMED = 4
"""Limits that a sentence names at most."""


class LeftOut(NamedTuple):
    """Random postures that were left out to keep reserves.

    Attributes:
        drawn: postures that close within joints' limits and strokes.
        out: how many of them were left out.
        by_limit: how many each limit alone would leave out; a posture may use several reserves.

    >>> LeftOut(100, 30, {"stick above ground": 30, "tipping over edge 1": 4}).sentence
    '30 of 100 random postures were left out to keep reserves: stick above ground 30, tipping over edge 1 4.'
    """

    drawn: int = 0
    out: int = 0
    by_limit: Mapping[str, int] = {}

    def with_more(self, other: LeftOut) -> LeftOut:
        """Both together."""
        return LeftOut(self.drawn + other.drawn, self.out + other.out,
                       dict(Counter(self.by_limit) + Counter(other.by_limit)))

    @property
    def limits(self) -> str:
        """The limits in words, those that leave out most first."""
        most = sorted(self.by_limit.items(), key=lambda each: -each[1])
        more = [f"{len(most) - NAMED} more"] if len(most) > NAMED else []
        return ", ".join([*(f"{name} {count}" for name, count in most[:NAMED]), *more])

    @property
    def sentence(self) -> str:
        """How many, and by which limits."""
        if not self.out:
            return f"All {self.drawn} random postures keep the reserves."
        return f"{self.out} of {self.drawn} random postures were left out to keep reserves: {self.limits}."


class PostureLimits:
    """What of a machine's limits postures at rest must keep; n joints of machine and calibrator.

    Args:
        chain: machine with its calibrator.
        reserves: that are kept of the limits.

    Attributes:
        limits: of the machine in motion.

    Example:
        >>> import hydroopt as ho
        >>> kept = PostureLimits(ho.KinematicModel(ho.load_machine("excavator_bucket")))
        >>> q = np.array([[0.0, 0.6, -1.2, -0.4], [0.0, -0.6, -0.3, 0.0]])
        >>> {name: broken.tolist() for name, broken in kept.broken(q).items() if name.startswith("stick above")}
        {'stick above ground': [False, True]}
    """

    def __init__(self, chain: KinematicModel, reserves: Reserves = DEFAULT) -> None:
        self.chain, self.machine = chain, chain.machine
        self.limits = Limits(Model(_without_seals(chain.machine)), reserves)
        self.places = [chain.joints.index(joint) for joint in self.machine.joints]
        self._size = np.ptp(self.machine.ranges, axis=1)
        obstacles = self.machine.obstacles
        poses = self.limits.model.dynamics.links
        centres = [ca.SX(ca.DM(each.centre)) if each.link == BASE else poses[each.link].pose.point(ca.DM(each.centre))
                   for each in obstacles]
        self._centres = ca.Function("centres", [self.limits.model.coordinates.q],
                                    [ca.densify(ca.horzcat(ca.SX(3, 0), *centres))])

    def while_resting(self, joints: Collection[str]) -> PostureLimits:
        """The same limits while some joints rest."""
        made = copy(self)
        made.limits = self.limits.while_resting([joint for joint in joints if joint in self.machine.joints])
        return made

    def hung(self, q: Array) -> Array:
        """Postures (N, n) in which passive joints of the machine hang; all others as given."""
        found = np.array(q, dtype=float)
        found[:, self.places] = self.limits.hanging.postures(found[:, self.places])
        return found

    def broken(self, q: Array, *, held: str = "", closed: bool = False, geometry: Array | None = None
               ) -> dict[str, NDArray[np.bool_]]:
        """Which postures (N, n) use the reserve of which limit, (N,) by its name.

        Args:
            q: joints of machine and calibrator [rad, m].
            held: link that is held at the ground or touches it, see `held_link`.
            closed: whether something holds the machine's tip, so that passive joints need not hang.
            geometry: (p,) of the chain, by which the calibrator stands; nominal by default.
        """
        found = self._of_machine(q[:, self.places], held, closed=closed)
        return found | dict(self._of_calibrator(q, self.chain.parameters.nominal if geometry is None else geometry))

    def move(self, start: Array, end: Array, *, held: tuple[str, ...] = (), closed: bool = False) -> tuple[str, ...]:
        """Limits of the machine whose reserves a move uses in which all joints go straight from one posture (n,) to
        another."""
        one, other = start[self.places], end[self.places]
        count = int(np.ceil(np.max(np.abs(other - one) / self._size, initial=0.0) / FINE)) + 2
        path = one + np.linspace(0, 1, count)[:, None] * (other - one)
        if not closed:
            path = self.limits.hanging.postures(path)
        return tuple(name for name, broken in self._of_machine(path, *held, closed=closed).items() if np.any(broken))

    def _of_machine(self, q: Array, *held: str, closed: bool) -> dict[str, NDArray[np.bool_]]:
        limits, found = self.limits, dict[str, NDArray[np.bool_]]()
        excess = limits.excess(limits.values(q, 0 * q, 0 * q)) > ROUNDING
        for k, row in enumerate(limits.rows):
            if not ((row.low and row.low in held) or (closed and row.passive)):
                found[row.name] = found.get(row.name, np.zeros(len(q), dtype=bool)) | excess[:, k]
        return found

    def _of_calibrator(self, q: Array, geometry: Array) -> Iterator[tuple[str, NDArray[np.bool_]]]:
        own, reserve = self.machine.calibrator, self.limits.reserves.clearance
        if own is None or not own.links or (self.machine.ground is None and not self.machine.obstacles):
            return
        first = len(self.machine.ancestry(own.parent)) - 1
        ends = self.chain.over(self.chain.far_ends, geometry, q)[0].transpose(0, 2, 1)[:, first:]
        centres = self.limits.model.over(self._centres, q[:, self.places])[0].transpose(0, 2, 1)
        for k, link in enumerate(own.links):
            start, end = ends[:, k], ends[:, k + 1]
            if not np.any(np.abs(end - start) > ROUNDING):
                continue
            if self.machine.ground is not None and link is not own.links[-1]:  # whose end the fixture holds
                yield f"{link.name} above ground", end[:, 2] < self.machine.ground + reserve - ROUNDING
            for obstacle, centre in zip(self.machine.obstacles, centres.transpose(1, 0, 2), strict=True):
                away = _distance(start, end, centre) - obstacle.radius
                yield f"distance of {link.name} to {obstacle.name}", away < reserve - ROUNDING


def held_link(machine: Machine, fixture: str, touch: str) -> str:
    """The link that a fixture holds by a rigid tool, or whose target touches a datum, ``floor.tooth``; else ''."""
    own, target = machine.calibrator, touch.partition(".")[2]
    if target and not (target == TIP and own):
        return next(each.link or "" for each in machine.targets if each.name == target)
    return own.parent if own is not None and not own.links and (fixture or target) else ""


def _distance(start: Array, end: Array, point: Array) -> Array:
    """Distances (N,) of lines from points (N, 3)."""
    along = end - start
    share = np.sum((point - start) * along, axis=1) / np.maximum(np.sum(along**2, axis=1), 1e-12)
    return np.asarray(np.linalg.norm(start + np.clip(share, 0, 1)[:, None] * along - point, axis=1))


def _without_seals(machine: Machine) -> Machine:
    """The machine without friction of seals, which is zero at rest and would ask for pressures."""
    if not machine.sealed:
        return machine
    return machine.model_copy(update={"cylinders": tuple(
        each.model_copy(update={"friction": each.friction.model_copy(update={"seal": None})})
        for each in machine.cylinders)})
