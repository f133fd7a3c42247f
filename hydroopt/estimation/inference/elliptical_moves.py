"""Moves of many chains along random ellipses: elliptical slice sampling (Murray, Adams, MacKay 2010)."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hydroopt.spatial.inertia import Array

BLOCK, TRIES = 12, 6
"""Coordinates moved together; proposals of each move."""
HEAVY_BLOCK, FREEDOMS = 8, 4.0
"""Where log-det distances make exponential tails: coordinates moved together, and degrees of freedom of the Student-t
about which they move then. About a Gaussian, chains hardly ever enter or leave such tails: spreads came out 4 % too
small."""


class Density(Protocol):
    """What chains move in: a density relative to that of standard normal states (k, c)."""

    slope: Array

    @property
    def heavy_tailed(self) -> bool:
        """Whether blocks move about a Student-t."""

    def ratio(self, state: Array, block: NDArray[np.intp] | slice = slice(None)) -> Array:
        """The part of the log-density that the Gaussian which stands in makes of all states or a block."""

    def truncated(self, slack: Array, state: Callable[[], Array]) -> Array:
        """The part that inequalities and log-det distances make."""


def sweep(density: Density, state: Array, slack: Array, log_density: Array, rng: np.random.Generator) -> None:
    """Move every coordinate of every chain once: state (k, c), slack (m, c) and log-density (c,) change in place.

    Each block of coordinates moves along a random ellipse, whose angles shrink until the density is high enough. A
    chain that found no place after `TRIES` stays: every number of rejected places is as likely on the way back, so that
    stopping early keeps the distribution, and the slowest chain does not hold up the others.
    """
    (k, chains), size = state.shape, HEAVY_BLOCK if density.heavy_tailed else BLOCK
    order, starts = rng.permutation(k), range(0, k, size)
    # how the bracket shrinks does not depend on the inequalities: all places to try are known beforehand
    chance = rng.random((TRIES, len(starts), chains))
    angles = np.empty_like(chance)
    angles[0] = 2 * np.pi * chance[0]
    low, high = angles[0] - 2 * np.pi, angles[0]
    for n in range(1, TRIES):
        angles[n] = low + (high - low) * chance[n]
        low, high = np.where(angles[n] < 0, angles[n], low), np.where(angles[n] < 0, high, angles[n])
    along, across = np.cos(angles) - 1, np.sin(angles)
    fall = rng.standard_exponential((len(starts), chains))
    other = rng.standard_normal((k, chains))
    for b, first in enumerate(starts):
        block, axes = order[first : first + size], other[first : first + size]
        if density.heavy_tailed:  # the variance of the ellipses, given where the chains are
            axes = axes * np.sqrt((FREEDOMS + np.sum(state[block] ** 2, axis=0))
                                  / rng.chisquare(FREEDOMS + len(block), chains))
        _move(density, state, slack, log_density, block, axes, along[:, b], across[:, b], log_density - fall[b])


def _move(density: Density, state: Array, slack: Array, log_density: Array, block: NDArray[np.intp], axes: Array,
          along: Array, across: Array, level: Array) -> None:
    """Move one block (b,) of coordinates of all chains to the first of some places (tries, c) on their ellipses, whose
    second axes are (b, c), at which the log-density is at least a level (c,)."""
    (tries, chains), current = along.shape, state[block]
    moved = current[:, None] + (current[:, None] * along + axes[:, None] * across)
    moved = moved.reshape(len(block), tries * chains)
    new_slack = density.slope[:, block] @ moved
    new_slack.reshape(-1, tries, chains)[:] += (slack - density.slope[:, block] @ current)[:, None]
    ratio = density.ratio(moved, block).reshape(tries, chains) + density.ratio(state) - density.ratio(current, block)
    new = density.truncated(new_slack, partial(_moved, state, tries, block, moved)).reshape(tries, chains) + ratio
    if density.heavy_tailed:
        level = level + _over_t(current)
        good = new + _over_t(moved).reshape(tries, chains) > level
    else:
        good = new > level
    found = np.flatnonzero(good.any(axis=0))
    pick = np.argmax(good[:, found], axis=0) * chains + found  # the first accepted one
    state[np.ix_(block, found)] = moved.take(pick, axis=1)
    slack[:, found] = new_slack.take(pick, axis=1)
    log_density[found] = new.ravel()[pick]


def _over_t(block: Array) -> Array:
    """Logarithm (...) of a standard normal density of a block (b, ...) over that of Student's t, but for a constant."""
    square = np.sum(block**2, axis=0)
    return np.asarray((FREEDOMS + len(block)) / 2 * np.log1p(square / FREEDOMS) - square / 2)


def _moved(state: Array, tries: int, block: NDArray[np.intp], moved: Array) -> Array:
    """The states (k, tries·c) of which a block is moved."""
    made = np.tile(state, tries)
    made[block] = moved
    return made
