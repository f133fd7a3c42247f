"""Equations of joints at rest whose dry friction f_s is only known to lie between −f and f: ``K·ψ + f_s = force``.

However long a joint is at rest, its friction is one unknown number: a hold is one equation, the mean over its samples.
What is common to the friction of all holds of an actuator (joints that always stop from the same side) is free, so that
it cannot bias gravity; what differs from hold to hold is random.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hydroopt.estimation.inference.band_variances import Channel
from hydroopt.estimation.inference.identifiability import RANK_TOLERANCE
from hydroopt.estimation.inference.least_squares import orthonormal, without
from hydroopt.spatial.inertia import Array

SHORTEST = 0.5
"""Duration [s] of a hold, at least: a slow reversal is none."""

FEWEST = 4.0
"""Degrees of freedom that the variance between holds has at least. Those that few holds lack are those of friction
that is uniform between −f and f, with the variance f²/3."""


ROUNDING = 1e-11
"""Rounding errors of forces, as a part of their size."""


@dataclass(frozen=True, eq=False)
class Hold:
    """One joint at rest, over the rows `first` to `last` of a log.

    Attributes:
        begin, end: [s] times of both.
        samples: number of samples.
        total: (c+1,) sum of their rows [K, force], in the columns that K has.
        lever: (p,) sizes of the columns of dry friction just before the joint moves, zero for all others.
    """

    first: int
    last: int
    begin: float
    end: float
    samples: int
    total: Array
    lever: Array

    def joined(self, later: Hold) -> Hold:
        """This hold together with its continuation."""
        return replace(self, last=later.last, end=later.end, samples=self.samples + later.samples,
                       total=self.total + later.total)


class Holds:
    """The holds of each actuator; `own` are the columns that its K has."""

    def __init__(self, own: Sequence[NDArray[np.intp]]) -> None:
        self.own = own
        self.holds: list[list[Hold]] = [[] for _ in own]

    def append(self, actuator: int, hold: Hold, step: float) -> None:
        """Add a hold that is later than all others of its log; `step` [s] is that between samples."""
        known = self.holds[actuator]
        if known and known[-1].last + 1 == hold.first and 0 <= hold.begin - known[-1].end < 1.5 * step:
            known[-1] = known[-1].joined(hold)
        else:
            known.append(hold)

    def add(self, other: Holds, step: float = 0.0) -> None:
        """Add those of another log, or of a later piece of the same log with so many seconds between samples."""
        for i, holds in enumerate(other.holds):
            for hold in holds:
                self.append(i, hold, step)

    @property
    def lasting(self) -> list[list[Hold]]:
        """Those of each actuator that last long enough."""
        return [[hold for hold in holds if hold.end - hold.begin >= SHORTEST] for holds in self.holds]

    @property
    def counts(self) -> NDArray[np.intp]:
        """Number of holds of each actuator (n,) that last long enough."""
        return np.array([len(holds) for holds in self.lasting])

    @property
    def samples(self) -> NDArray[np.intp]:
        """Number of samples (n,) in all holds, the short ones too."""
        return np.array([sum(hold.samples for hold in holds) for holds in self.holds])

    def levers(self, count: int) -> list[Array]:
        """Sizes (h, count) of the columns of dry friction of each actuator, in its holds that last long enough."""
        return [np.array([hold.lever for hold in holds]).reshape(-1, count) for holds in self.lasting]

    def equations(self, second_moments: Sequence[Array], noise: Array) -> Iterator[HoldEquations]:
        """Those of each actuator.

        Args:
            second_moments: (p, p) expectation of ψ·ψᵀ for each actuator, from which the size of its friction follows.
            noise: (n,) standard deviation of each actuator's force reading.
        """
        for own, holds, levers, moment, sigma in zip(self.own, self.lasting, self.levers(len(second_moments[0])),
                                                     second_moments, noise, strict=True):
            means = np.array([hold.total / hold.samples for hold in holds]).reshape(-1, len(own) + 1)
            bound = float(np.einsum("hj,jk,hk->", levers, moment, levers)) / max(len(holds), 1)
            yield HoldEquations(own, means, max(bound, 0.0), float(sigma))


@dataclass(frozen=True, eq=False)
class HoldEquations:
    """The holds of one actuator: `means` (h, c+1) of [K, force] in the columns `own`, the expectation `bound` of f²,
    and the standard deviation `noise` of its force reading.
    """

    own: NDArray[np.intp]
    means: Array
    bound: float
    noise: float

    @cached_property
    def differences(self) -> Array:
        """Rows (h − 1, c+1) without what all holds have in common; their errors are independent and of one size: each
        hold but the first one, less the mean of these two and of all later ones (Helmert's contrasts)."""
        off = self.means - self.means[:1]
        later = np.cumsum(off[:0:-1], axis=0)[::-1]  # with itself; the first one is zero
        count = np.arange(len(later) + 1, 1, -1)[:, None]
        return np.asarray((off[1:] - later / count) / np.sqrt(1 - 1 / count))

    @property
    def presumed(self) -> float:
        """Variance between holds before they tell it."""
        return self.bound / 3 + self.noise**2

    @property
    def least(self) -> float:
        """Standard deviation of rounding errors."""
        return float(ROUNDING * np.sqrt(np.mean(self.means[:, -1] ** 2))) if len(self.means) else 0.0

    def channel(self, bands: int) -> Channel:
        """The differences as a channel whose residuals are all in the first of so many bands."""
        rows = self.differences
        lacking = float(np.clip(FEWEST - self._fit[1], 0.0, FEWEST)) if len(rows) else 0.0
        supposed = np.zeros((1, rows.shape[1]))
        supposed[0, -1] = np.sqrt(lacking * self.presumed)
        counts = np.zeros(bands)
        counts[0] = len(rows) + lacking
        none = np.zeros((0, rows.shape[1]))
        return Channel(self.own, (np.vstack([rows, supposed]), *[none] * (bands - 1)), counts)

    @property
    def initial_std(self) -> float:
        """The standard deviation between holds to begin with: of least squares, or as presumed where holds are few."""
        squares, freedom = self._fit
        lacking = max(FEWEST - freedom, 0.0)
        found = np.sqrt((squares + lacking * self.presumed) / max(freedom + lacking, 1.0))
        return float(max(found, self.least)) or 1.0

    @cached_property
    def _fit(self) -> tuple[float, int]:
        """Squares that least squares leave of the differences, and their degrees of freedom."""
        rows = self.differences
        size = np.linalg.norm(rows[:, :-1], axis=0)
        if not len(rows) or not np.any(size > 0):
            return float(np.sum(rows[:, -1] ** 2)), len(rows)
        basis = orthonormal(rows[:, :-1][:, size > RANK_TOLERANCE * np.max(size)])
        return float(np.sum(without(basis, rows[:, -1:]) ** 2)), len(rows) - basis.shape[1]

    def mean(self, variance: float) -> Array:
        """The mean over all holds (1, c+1) in units of its error, for a variance between holds; none without holds."""
        count = len(self.means)
        if not count:
            return np.zeros((0, len(self.own) + 1))
        size = np.sqrt(self.bound + max(variance, self.noise**2 if count == 1 else 0.0) / count)
        return np.asarray(self.means.mean(axis=0)[None] / max(size, np.finfo(float).tiny))
