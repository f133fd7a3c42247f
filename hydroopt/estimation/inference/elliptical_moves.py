"""Moves of many chains along random ellipses: elliptical slice sampling (Murray, Adams, MacKay 2010).

What is drawn at random does not depend on how the moves are computed: compiled (`hydroopt.kernels.ellipses`), or by
NumPy where there is no compiler or a constraint is a function of the user's. Both make the same chains, up to rounding.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import pairwise
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from hydroopt.kernels.ellipses import Sweeper
from hydroopt.spatial.inertia import Array

BLOCK, TRIES = 12, 6
"""Coordinates moved together; proposals of each move."""
HEAVY_BLOCK, FREEDOMS = 8, 4.0
"""Where log-det distances make exponential tails: coordinates moved together, and degrees of freedom of the Student-t
about which they move then. About a Gaussian, chains hardly ever enter or leave such tails: spreads came out 4 % too
small."""
BATCHES = 0, 1, 3, TRIES
"""Proposals are evaluated in these parts by NumPy, the later ones for the chains that still wait."""


class Density(Protocol):
    """What chains move in: a density relative to that of standard normal states (k, c)."""

    slope: Array

    @property
    def heavy_tailed(self) -> bool:
        """Whether blocks move about a Student-t."""

    @property
    def sweeper(self) -> Sweeper | None:
        """Its compiled sweep, if there is one."""

    def ratio(self, state: Array, block: NDArray[np.intp] | slice = slice(None)) -> Array:
        """The part of the log-density that the Gaussian which stands in makes of all states or a block."""

    def truncated(self, slack: Array, state: Callable[[], Array]) -> Array:
        """The part that inequalities and log-det distances make."""


class Draws(NamedTuple):
    """What is drawn at random for one sweep of c chains, block by block of coordinates in a random `order` (k,).

    Attributes:
        size: of a block; the last one may be smaller.
        other: (k, c) second axes of the ellipses, standard normal.
        square: (blocks, c) chi-squared, which makes these axes Student-t where tails are heavy.
        chance: (blocks, tries, c) of the angles, uniform.
        level: (blocks, c) by which the log-density may fall at most, exponential.
    """

    size: int
    order: NDArray[np.intp]
    other: Array
    square: Array
    chance: Array
    level: Array

    @classmethod
    def of(cls, rng: np.random.Generator, coordinates: int, chains: int, *, heavy: bool) -> Draws:
        """Draw."""
        size = HEAVY_BLOCK if heavy else BLOCK
        blocks = -(-coordinates // size)
        made = cls(size, rng.permutation(coordinates), np.empty((coordinates, chains)), np.ones((blocks, chains)),
                   np.empty((blocks, TRIES, chains)), np.empty((blocks, chains)))
        for b, chance, level in zip(range(blocks), made.chance, made.level, strict=True):
            other = made.other[b * size : (b + 1) * size]
            rng.standard_normal(out=other)
            if heavy:
                made.square[b] = rng.chisquare(FREEDOMS + len(other), chains)
            rng.random(out=chance)
            rng.standard_exponential(out=level)
        return made


def sweep(density: Density, state: Array, slack: Array, log_density: Array, rng: np.random.Generator) -> None:
    """Move every coordinate of every chain once: state (k, c), slack (m, c) and log-density (c,) change in place.

    Each block of coordinates moves along a random ellipse, whose angles shrink until the density is high enough. A
    chain that found no place after `TRIES` stays: every number of rejected places is as likely on the way back, so that
    stopping early keeps the distribution, and the slowest chain does not hold up the others.
    """
    draws = Draws.of(rng, *state.shape, heavy=density.heavy_tailed)
    if density.sweeper is not None:
        density.sweeper(*draws, state, slack, log_density)
        return
    for b, first in enumerate(range(0, len(state), draws.size)):
        _move(density, state, slack, log_density, draws, b, slice(first, first + draws.size))


def _move(density: Density, state: Array, slack: Array, log_density: Array, draws: Draws, b: int,
          places: slice) -> None:
    """Move one block of coordinates of all chains."""
    block, other, heavy = draws.order[places], draws.other[places], density.heavy_tailed
    chains = state.shape[1]
    if heavy:  # the variance of the ellipses, given where the chains are
        other = other * np.sqrt((FREEDOMS + np.sum(state[block] ** 2, axis=0)) / draws.square[b])
    # how the bracket shrinks does not depend on the inequalities: all places to try are known beforehand
    angles = np.empty((TRIES, chains))
    angles[0] = 2 * np.pi * draws.chance[b, 0]
    low, high = angles[0] - 2 * np.pi, angles[0]
    for k in range(1, TRIES):
        angles[k] = low + (high - low) * draws.chance[b, k]
        low, high = np.where(angles[k] < 0, angles[k], low), np.where(angles[k] < 0, high, angles[k])
    threshold = log_density - draws.level[b]
    if heavy:
        threshold += _over_t(state[block])
    waiting, slope = np.arange(chains), density.slope[:, block]
    others = density.ratio(state) - density.ratio(state[block], block)  # of the coordinates that stay
    for first, end in pairwise(BATCHES):  # most chains are done after one
        if not len(waiting):
            break
        angle, current = angles[first:end, waiting], state[np.ix_(block, waiting)]
        step = current[:, None] * (np.cos(angle) - 1) + other[:, waiting][:, None] * np.sin(angle)
        flat = step.reshape(len(block), -1)
        linear = slope @ flat
        linear.reshape(len(slack), end - first, -1)[:] += slack[:, None, waiting]
        ratio = others[waiting] + density.ratio(current[:, None] + step, block)
        new = density.truncated(linear, partial(_stepped, state, np.tile(waiting, end - first), block, flat))
        new += ratio.ravel()
        level = new.reshape(angle.shape) + (_over_t(current[:, None] + step) if heavy else 0.0)
        good = level > threshold[waiting]
        found = np.flatnonzero(good.any(axis=0))
        pick = np.argmax(good[:, found], axis=0) * len(waiting) + found  # the first accepted one
        state[np.ix_(block, waiting[found])] += flat[:, pick]
        slack[:, waiting[found]] = linear[:, pick]
        log_density[waiting[found]] = new[pick]
        waiting = np.delete(waiting, found)


def _over_t(block: Array) -> Array:
    """Logarithm (...) of a standard normal density of a block (b, ...) over that of Student's t, but for a constant."""
    square = np.sum(block**2, axis=0)
    return np.asarray((FREEDOMS + len(block)) / 2 * np.log1p(square / FREEDOMS) - square / 2)


def _stepped(state: Array, chains: NDArray[np.intp], block: NDArray[np.intp], step: Array) -> Array:
    moved = state[:, chains]
    moved[block] += step
    return moved
