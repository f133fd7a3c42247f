"""How often to measure which of many poses: the optimal approximate design, with a bound on what any other could do.

Shares (G, C) of the C candidates of each of G groups sum up to one in each group. The criterion is the largest variance
of some combinations, smoothed by a power mean; it is convex in the shares (Pukelsheim 2006), so that its tangent is a
lower bound over all shares: the equivalence theorem of Kiefer and Wolfowitz (1960) as an inequality.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hydroopt.spatial.inertia import Array

POWER = 6.0
"""Exponent of the mean that stands for the largest variance."""


class Shares(NamedTuple):
    """Shares (G, C), variances (k,) of the combinations, the least that any shares could make of their largest, and the
    weights (k,) with which the sum of the variances has the same optimum."""

    share: Array
    variance: Array
    bound: float
    weight: Array


def optimal_shares(rows: Array, known: Array, pick: Array, count: float, steps: int) -> Shares:
    """Multiplicative steps (Silvey, Titterington and Torsney 1978) from even shares.

    Args:
        rows: (G, C, u, f) white rows.
        known: (f, f) information that counts beside them.
        pick: (f, k) combinations.
        count: poses of each group.
        steps: of the iteration.
    """
    groups, candidates = rows.shape[:2]
    share = np.full((groups, candidates), 1 / candidates)
    for step in range(steps + 1):
        weighted = np.sqrt(count * share)[:, :, None, None] * rows
        flat = weighted.reshape(-1, rows.shape[-1])
        towards = np.linalg.solve(known + flat.T @ flat, pick)
        variance = np.einsum("fk,fk->k", pick, towards)
        size = variance / np.max(variance)
        weight = size ** (POWER - 1) / np.sum(size**POWER) ** (1 - 1 / POWER)  # of the power mean's gradient
        gain = count * np.einsum("gcuk,k->gc", (rows @ towards) ** 2, weight)
        if step < steps:
            share = share * np.maximum(gain, 1e-300) ** (1 / (1 + POWER))
            share /= share.sum(axis=1, keepdims=True)
    mean = np.max(variance) * np.sum(size**POWER) ** (1 / POWER)
    least = mean - float(np.sum(gain.max(axis=1) - np.sum(gain * share, axis=1)))
    return Shares(share, variance, max(least, 0.0) / len(variance) ** (1 / POWER), weight)
