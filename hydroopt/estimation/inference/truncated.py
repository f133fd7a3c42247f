"""Samples of a Gaussian that inequalities cut off, and what they say of linear sums beyond their own values.

Along the direction in which a sum varies while all that is independent of it stays, its conditional distribution is
normal between the ends of a chord. These, averaged over the samples, have the same mean as the samples' own
distribution and far less scatter (Rao and Blackwell): intervals of as many samples differ by a third as much from run
to run.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr

from hydroopt.estimation.inference.conditions import UPPER
from hydroopt.estimation.inference.whitening import GaussianPosterior
from hydroopt.spatial.inertia import Array

TAIL = 0.025
"""Probability beyond each end of an interval."""
FURTHEST = 30.0
"""Standard deviations of the Gaussian that is cut off, beyond which its tails cannot be told from zero."""
FAR, NARROW = 100.0, 1e-4
"""Longest chord to either side, and width from which on its normal distribution counts as uniform [standard
deviations]."""
STEPS, HALVINGS = 30, 18
"""Steps to a chord's end at most, of which two or three are usual; halvings of an interval about a quantile, in which
the distribution then is straight."""
PAIRS = np.array([*combinations(range(4), 2)])
"""Pairs of a matrix's rows or columns; the complement of the first one is the last one, and so on."""
SIGNS = (-1.0) ** PAIRS.sum(axis=1)


class Marginal(NamedTuple):
    """Mean and standard deviation (n,) and interval (n, 2) of sums; `error` (n,) is the standard error of the standard
    deviation, as a part of it, that a finite number of samples leaves."""

    mean: Array
    std: Array
    interval: Array
    error: Array


@dataclass(frozen=True, eq=False)
class TruncatedGaussian:
    """A Gaussian that holds where matrices are positive definite and single functions are not negative.

    Attributes:
        gaussian: in standard normal coordinates z (k,).
        slope: (m, k) of the functions: first entries of the matrices' upper triangles, second ones, ..., single ones.
        matrices: number of these.
    """

    gaussian: GaussianPosterior
    slope: Array
    matrices: int

    def marginal(self, samples: Array, slack: Array, rows: Array, chains: int) -> Marginal:
        """Linear sums ``rows·ψ`` (n,) at samples ψ (s, p) of so many chains in turn, where the functions are slack
        (m, s); by the samples' own values of sums that do not vary, or are too far from the Gaussian.
        """
        values = rows @ samples.T
        mean, std, interval, error = of_samples(values, chains)
        axes, offset = rows @ self.gaussian.slope, rows @ self.gaussian.offset
        length = np.linalg.norm(axes, axis=1)
        sound = (length > 0) & (np.abs(mean - offset) <= FURTHEST * length)
        unit, size, offset = axes[sound] / length[sound, None], length[sound], offset[sound]
        at = (values[sound] - offset[:, None]) / size[:, None]
        found = marginals(at, *chords(slack, unit @ self.slope.T, self.matrices), chains)
        mean[sound], std[sound], error[sound] = offset + size * found.mean, size * found.std, found.error
        interval[sound] = offset[:, None] + size[:, None] * found.interval
        return Marginal(mean, std, interval, error)


def of_samples(values: Array, chains: int) -> Marginal:
    """Of values (n, s) of n sums at samples of so many chains in turn.

    >>> of_samples(np.random.default_rng(0).standard_normal((1, 20000)), 100).error.round(3).tolist()  # 1/√(2·20000)
    [0.005]
    """
    mean = values.mean(axis=1)
    square = (values - mean[:, None]) ** 2
    return Marginal(mean, np.sqrt(square.mean(axis=1)), np.quantile(values, [TAIL, 1 - TAIL], axis=1).T,
                    _error(square, chains))


def _error(squares: Array, chains: int) -> Array:
    """The relative standard error (n,) of the root of the means of squares (n, s) of chains in turn, which are
    independent of each other."""
    means = squares.reshape(len(squares), squares.shape[1] // chains, chains).mean(axis=1)
    variance = means.mean(axis=1)
    return np.asarray(means.std(axis=1, ddof=1) / np.sqrt(chains) / 2 / np.where(variance > 0, variance, np.inf))


def marginals(at: Array, down: Array, up: Array, chains: int) -> Marginal:
    """Means over samples of standard normal distributions that are cut off.

    Args:
        at: (n, s) values of n sums at the samples, of unit variance where nothing cuts them off.
        down: (n, s) how far they may be below; `up`: above.
        chains: that drew the samples in turn.
    """
    # the tail at hand is that of small numbers, which are exact
    sign = np.where(at.mean(axis=1) > 0, -1.0, 1.0)[:, None]
    low, high = sign * at - np.where(sign > 0, down, up), sign * at + np.where(sign > 0, up, down)
    below = ndtr(low)
    share = ndtr(high) - below
    first, last = (np.exp(-(x**2) / 2) / np.sqrt(2 * np.pi) for x in (low, high))
    wide = (high - low > NARROW) & (share > 0)
    weight = 1 / np.where(wide, share, 1.0)
    middle = (low + high) / 2
    means = np.where(wide, (first - last) * weight, middle)
    mean = means.mean(axis=1)
    squares = np.where(wide, 1 + (low * first - high * last) * weight, middle**2) - 2 * mean[:, None] * means
    variance = np.maximum(squares.mean(axis=1) + mean**2, 0.0)

    def distribution(x: Array) -> Array:
        """Its values (n,) at x (n,); of narrow chords steps."""
        part = np.where(wide, (ndtr(x)[:, None] - below) * weight, x[:, None] > middle)
        return np.asarray(np.clip(part, 0.0, 1.0, out=part).mean(axis=1))

    interval = np.empty((2, len(at)))
    for quantile, wanted in zip(interval, (TAIL, 1 - TAIL), strict=True):
        less, more = low.min(axis=1), high.max(axis=1)
        for _ in range(HALVINGS):
            half = (less + more) / 2
            over = distribution(half) > wanted
            less, more = np.where(over, less, half), np.where(over, half, more)
        ends = distribution(less), distribution(more)
        quantile[:] = less + (more - less) * np.clip((wanted - ends[0]) / np.maximum(ends[1] - ends[0], TAIL**9), 0, 1)
    return Marginal(sign[:, 0] * mean, np.sqrt(variance), np.sort(sign * interval.T, axis=1),
                    _error(squares + mean[:, None] ** 2, chains))


def chords(slack: Array, along: Array, matrices: int) -> tuple[Array, Array]:
    """How far (n, s) single steps may go down and up from samples until a condition does not hold.

    Args:
        slack: (m, s) first entries of so many matrices' upper triangles, second ones, ..., then single conditions.
        along: (n, m) what a step of length 1 changes them by.
        matrices: their number.
    """
    # rates at which conditions fall, over what is left of them
    fastest, single = np.full((2, len(along), slack.shape[1]), 1 / FAR), 10 * matrices
    for left, change in zip(slack[single:], along[:, single:].T, strict=True):
        rate = change[:, None] / np.maximum(left, np.finfo(float).tiny)
        np.maximum(fastest, (rate, -rate), out=fastest)
    for first in range(matrices):
        entries, changes = slack[first:single:matrices], along[:, first:single:matrices].T
        root = np.linalg.inv(np.linalg.cholesky(_symmetric(entries.mean(axis=1)[:, None])[0]))
        own, change = (root @ _symmetric(each) @ root.T for each in (entries, changes))
        (pairs, cofactors, size), (change_pairs, change_cofactors, change_size) = _minors(own), _minors(change)
        # elementary symmetric functions of the eigenvalues of the change relative to the matrix
        a = _products(change, cofactors / size[:, None, None])
        b = _products(change_pairs, np.outer(SIGNS, SIGNS) * pairs[:, ::-1, ::-1] / size[:, None, None])
        c = _products(change_cofactors, own / size[:, None, None])
        d = np.divide.outer(change_size, size)
        _raise(fastest[0], a, b, c, d)
        _raise(fastest[1], -a, b, -c, d)
    return 1 / fastest[0], 1 / fastest[1]


def _symmetric(upper: Array) -> Array:
    """Matrices (k, 4, 4) of upper triangles (10, k)."""
    made = np.empty((upper.shape[1], 4, 4))
    made[:, *UPPER] = made[:, *UPPER[::-1]] = upper.T
    return made


def _minors(of: Array) -> tuple[Array, Array, Array]:
    """Minors (k, 6, 6) of pairs of rows and columns, cofactors (k, 4, 4) and determinants (k,) of (k, 4, 4)."""
    (i, j), (m, n) = PAIRS.T[:, :, None], PAIRS.T[:, None]
    pairs = of[:, i, m] * of[:, j, n] - of[:, i, n] * of[:, j, m]
    number = {tuple(pair): k for k, pair in enumerate(PAIRS.tolist())}
    cofactors = np.empty_like(of)
    for row, column in np.ndindex(4, 4):
        (r, *rows), columns = np.delete(np.arange(4), row).tolist(), np.delete(np.arange(4), column).tolist()
        others = [number[columns[1], columns[2]], number[columns[0], columns[2]], number[columns[0], columns[1]]]
        p, q, s = (of[:, r, c] * pairs[:, number[tuple(rows)], other] for c, other in zip(columns, others, strict=True))
        cofactors[:, row, column] = (-1) ** (row + column) * (p - q + s)
    return pairs, cofactors, np.sum(of[:, 0] * cofactors[:, 0], axis=1)


def _products(one: Array, other: Array) -> Array:
    """Sums of products of all entries (n, s) of matrices (n, ...) and (s, ...)."""
    return np.asarray(np.tensordot(one, other, (list(range(1, one.ndim)), list(range(1, other.ndim)))))


def _raise(least: Array, a: Array, b: Array, c: Array, d: Array) -> None:
    """Raise numbers to the largest roots of ``x⁴ − a·x³ + b·x² − c·x + d`` where these are larger.

    All roots are real. Laguerre's steps from above do not pass a root; the first one begins at infinity.
    """
    least = least.ravel()
    middle, spread = a / 4, 0.75 * np.sqrt(np.maximum(a**2 - 8 / 3 * b, 0.0))
    at = np.flatnonzero(middle + spread > least.reshape(a.shape))
    x, a, b, c, d = (each.ravel()[at] for each in (middle + spread, a, b, c, d))
    bound = least[at]
    for _ in range(STEPS):
        value = (((x - a) * x + b) * x - c) * x + d
        slope, bend = ((4 * x - 3 * a) * x + 2 * b) * x - c, (12 * x - 6 * a) * x + 2 * b
        below = slope + np.sqrt(np.maximum(9 * slope**2 - 12 * value * bend, 0.0))
        step = np.where((value > 0) & (below > 0), 4 * value / np.where(below > 0, below, 1.0), 0.0)
        least[at] = np.maximum(x - step, bound)
        left = np.flatnonzero(x - least[at] > 1e-7 * x)
        if not len(left):
            break
        at = at[left]
        x, a, b, c, d, bound = least[at], a[left], b[left], c[left], d[left], bound[left]
