"""Postures to choose from: random, closed, within all limits and their reserves; and the order to drive to them.

An order is improved by turning a part of it round, or by moving one posture elsewhere in it, as long as fewer moves use
a reserve (the 2-opt and or-opt moves of the travelling salesman).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import ProblemError
from hydroopt.excitation.selection.pose_problem import PoseGroup, PoseProblem, Postures, measured_along
from hydroopt.limits.postures import LeftOut, PostureLimits
from hydroopt.simulation import postures
from hydroopt.spatial.inertia import Array
from hydroopt.support.progress import Progress, silent

TRIES, RARE = 30, 200
"""Random postures of which at least one must close within its limits; of those that close one must keep the reserves.
"""
BATCH = 500
"""Random postures tried at once, at least."""


def random_candidates(problem: PoseProblem, count: int, rng: np.random.Generator,
                      progress: Progress = silent) -> tuple[Postures, LeftOut]:
    """So many random closed postures of each group, one group after another, see `candidate_postures`, and how many
    reserves left out."""
    drawn, left_out = [], LeftOut()
    for k, group in enumerate(problem.groups):
        progress(f"drawing postures for {group}", 0.5 * k / len(problem.groups))
        q, out = candidate_postures(problem, group, count, rng)
        drawn.append(q)
        left_out = left_out.with_more(out)
    return Postures(problem, np.concatenate(drawn)), left_out


def candidate_postures(problem: PoseProblem, group: PoseGroup, count: int,
                       rng: np.random.Generator) -> tuple[Array, LeftOut]:
    """Random closed postures (count, n) within all limits and their reserves, in the order of measuring, and how many
    reserves have left out.

    They stay away from the ends of strokes as far as the uncertain geometry may shift these, so that the machine
    reaches them.

    That order is that of `measured_along`, so that there is little driving. Where locked joints drift, every second
    posture waits for the way back: otherwise drift and moving joint could not be separated.

    Raises:
        ProblemError: too few postures close, or keep the reserves.
    """
    model, sieve = problem.model, Sieve(problem.limits, group)
    moving = [model.joints.index(joint) for joint in dict.fromkeys((*group.moves, *model.machine.base_joints))
              if joint not in group.locked]
    held = {model.joints.index(joint) for joint in group.locked}
    turning = [k for k in postures.read_joints(model) if k not in held and k not in moving]
    if group.touch:  # the machine itself drives there
        turning += [model.joints.index(joint) for joint in group.moves]
    known = {each.name: each for each in model.machine.fixtures} | {each.name: each for each in model.measurements}
    batch = max(count, BATCH)
    found, tried = postures.closed_postures(
        model, count, rng, geometry=model.parameters.nominal, turning=turning, within_limits=turning + moving,
        locked=group.locked, held=known.get(group.fixture or group.touch), within_strokes=problem.uncertain,
        batch=batch, sieve=sieve, give_up=lambda found, tried: tried > 3 * batch and (
            sieve.left_out.drawn * TRIES < tried or found * RARE < sieve.left_out.drawn))
    if len(found) < count and len(found) * RARE < sieve.left_out.drawn:
        raise ProblemError(f"only {len(found)} of {sieve.left_out.drawn} random postures that close keep the reserves; "
                           f"left out by {sieve.left_out.limits}", where=f"{group}",
                           remedy="lock joints elsewhere, or move the fixture or the machine, or keep smaller reserves "
                           "with --reserve")
    if len(found) < count:
        raise ProblemError(f"only {len(found)} of {tried} random postures close within their limits",
                           where=f"{group}", remedy="move the fixture, widen limits and strokes, or lock joints "
                           "elsewhere")
    order = in_passes(found[:, measured_along(model, group)], 2 if group.drift else 1)
    return np.asarray(found[order]), sieve.left_out


class Sieve:
    """Lets postures of a group pass that keep the reserves, passive joints hanging, and counts the others."""

    def __init__(self, limits: PostureLimits, group: PoseGroup) -> None:
        self.limits = limits.while_resting((*group.locked, *limits.machine.base_joints))
        self.left_out = LeftOut()
        self.held, self.closed = group.held(limits.machine), group.closed(limits.machine)

    def __call__(self, q: Array, geometry: Array) -> Array:
        """Of postures (N, n) those (K, n) that keep them."""
        if not len(q):
            return q
        q = q if self.closed else self.limits.hung(q)
        broken = self.limits.broken(q, held=self.held, closed=self.closed, geometry=geometry)
        out = np.any([*broken.values(), np.zeros(len(q), dtype=bool)], axis=0)
        counts = {name: int(np.sum(each)) for name, each in broken.items() if np.any(each)}
        self.left_out = self.left_out.with_more(LeftOut(len(q), int(np.sum(out)), counts))
        return np.asarray(q[~out])


def in_passes(joint: Array, count: int) -> NDArray[np.intp]:
    """Places (N,) of the positions (N,) of a joint in so many ways there and back through all of them.

    >>> in_passes(np.array([4.0, 1.0, 3.0, 2.0, 5.0]), 2).tolist()
    [1, 2, 4, 0, 3]
    """
    order = np.argsort(joint, kind="stable")
    return np.concatenate([order[k::count][:: -1 if k % 2 else 1] for k in range(count)])


def in_safe_order(limits: PostureLimits, group: PoseGroup, q: Array) -> NDArray[np.intp]:
    """Places (N,) of the postures (N, n) of a group, in an order with fewer moves that use a reserve; nearest first."""
    held, closed = (group.held(limits.machine),), group.closed(limits.machine)
    limits = limits.while_resting(group.locked)
    away = np.max(np.abs(q[:, None] - q) / np.maximum(np.ptp(q, axis=0), 1e-9), axis=2)

    @cache
    def unsafe(one: int, other: int) -> bool:
        return bool(limits.move(q[one], q[other], held=held, closed=closed))

    def cost(path: Sequence[int]) -> tuple[int, float]:
        """Moves of a stretch that use a reserve, and how far it goes."""
        moves = [(min(pair), max(pair)) for pair in pairwise(path)]
        return sum(unsafe(*move) for move in moves), sum(float(away[move]) for move in moves)

    order = list(range(len(q)))
    while True:  # fewer with every round
        bad = [k for k in range(len(order) - 1) if cost(order[k:k + 2])[0]]
        better = min(((cost(new), new) for k in bad for new in _changed(order, k)), default=None)
        if better is None or better[0][0] >= len(bad):
            return np.array(order, dtype=int)
        order = better[1]


def _changed(order: list[int], k: int) -> Iterator[list[int]]:
    """Orders without the move from place k to the next."""
    for j in range(k + 1, len(order)):
        yield order[: k + 1] + order[k + 1: j + 1][::-1] + order[j + 1:]
    for j in range(k + 1):
        yield order[:j] + order[j: k + 1][::-1] + order[k + 1:]
    for moved in (k, k + 1):
        rest = order[:moved] + order[moved + 1:]
        for j in range(len(rest) + 1):
            yield [*rest[:j], order[moved], *rest[j:]]
