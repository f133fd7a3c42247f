"""The order in which postures are driven to: straight moves between them that keep the reserves, where there are some.

An order is improved by turning a stretch of it round, or by moving one posture elsewhere in it, as long as fewer moves
use a reserve (the 2-opt and or-opt moves of the travelling salesman).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from hydroopt.excitation.poses.problem import PoseGroup
from hydroopt.limits.postures import PostureLimits
from hydroopt.spatial.inertia import Array


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
