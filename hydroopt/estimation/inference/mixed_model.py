"""Linear mixed models in rows of variance 1: fixed effects, random effects in groups, and tests of the fixed ones.

``y = X·δ + Σ_g D_g·u_g + e``, with u_g of variance κ_g² and e of variance 1. Parameters that nothing is asked about are
projected out first (restricted likelihood), so that only the rest is random.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc

from hydroopt.estimation.inference.band_variances import FTest, combined, f_test
from hydroopt.estimation.inference.identifiability import RANK_TOLERANCE, ROUNDING_TOLERANCE
from hydroopt.estimation.inference.least_squares import orthonormal, without
from hydroopt.spatial.inertia import Array

SEPARABLE = 1e-6
"""Part of an effect that no other may explain, at least, for it to be identifiable by itself."""
NONE = 0.5
"""Probability that nothing varies at all, before anything is measured: sound machines are seen as such."""
USUAL = 0.1
"""Median κ of those that do vary, by Cauchy's density (Gelman 2006), relative to the friction force."""
LARGEST = 2.0
"""Largest κ that is distinguished: twice the friction force."""
FINE = 8
"""Values of κ in each decade, whose likelihood varies slowly by decades."""
UNEQUAL = 2.0
"""Degrees of freedom of a single effect's variance: κ² is the mean of a group, from which those of single effects
differ (with those of κ² itself, sessions whose parameters scatter unequally raise 12 % of alarms at 5 %)."""
ROUNDS = 3
"""Times that the variances of all groups are estimated in turn."""


class Projected(NamedTuple):
    """What unknown effects do to the rows, less what common parameters explain, in k coordinates of variance 1.

    Attributes:
        left: (m, k) orthonormal, the coordinates by rows.
        sums: (k,) the measured coordinates, zero on average without these effects.
        effects: (k, q) of a unit of each.
        sizes: (q,) lengths of these effects before common parameters explained a part of them.
        solution: (q, k) least squares of each effect from the coordinates; NaN where it is not identifiable.
    """

    left: Array
    sums: Array
    effects: Array
    sizes: Array
    solution: Array


def projected(common: Array, columns: Array, right: Array, scale: Array) -> Projected:
    """The coordinates that effects alone can move; k is zero where none is identifiable.

    Args:
        common: (m, P) columns of the common parameters, of about the same size.
        columns: (m, q) of the effects.
        right: (m,) measurements of variance 1.
        scale: (q,) sizes of the effects.
    """
    basis, sizes = orthonormal(common), np.linalg.norm(columns, axis=0)
    seen = sizes * scale
    touched = np.flatnonzero(seen > 1e-12 * np.max(seen, initial=0.0))
    own = without(basis, columns[:, touched] / sizes[touched])
    left, singular, axes = np.linalg.svd(own, full_matrices=False)
    known = singular > RANK_TOLERANCE
    left = left[:, known]
    effects, solution = np.zeros((left.shape[1], len(sizes))), np.full((len(sizes), left.shape[1]), np.nan)
    effects[:, touched] = singular[known, None] * axes[known] * sizes[touched]
    effects[:, np.linalg.norm(effects, axis=0) <= SEPARABLE * sizes] = 0.0
    alone = np.abs(axes[~known].T @ axes[~known]).max(axis=1, initial=0.0) < SEPARABLE
    solution[touched[alone]] = (axes[known].T / singular[known] / sizes[touched][:, None])[alone]
    return Projected(left, left.T @ without(basis, right), effects, sizes, solution)


class VarianceComponents(NamedTuple):
    """Variances κ² of random effects by group.

    Attributes:
        variance: (G,) mean κ².
        freedom: (G,) degrees of freedom of these.
        interval: (G, 2) 95 % of the probability of κ.
        none: probability that there are no random effects at all.
        p_value: of none, by residuals whose variance is known.
    """

    variance: Array
    freedom: Array
    interval: Array
    none: float
    p_value: float


def variance_components(blocks: Sequence[tuple[Array, Sequence[Array]]]) -> VarianceComponents:
    """Means of variances over their restricted likelihood and prior, group by group.

    The most probable κ of few sessions is often zero where it is not. The mean over all κ, which are zero in all groups
    with the probability `NONE` and have Cauchy's density otherwise, contains what few sessions leave open. Degrees of
    freedom are those of the restricted likelihood (Giesbrecht and Burns 1985).

    Args:
        blocks: independent ones, each measurements (k,) of variance 1 in which no fixed effect is left, and by group
            the columns (k, ·) of its random effects.

    >>> rng = np.random.default_rng(1)
    >>> effects, noise = 0.3 * rng.standard_normal(40), rng.standard_normal(40)
    >>> found = variance_components([(100 * effects + noise, [100 * np.eye(40)])])
    >>> bool(0.2 < found.variance[0] ** 0.5 < 0.4), found.p_value < 1e-9
    (True, True)
    """
    parts = [[np.asarray(D @ D.T) for D in columns] for _, columns in blocks]
    groups = len(parts[0])
    # from a κ whose effects are a hundredth of the residuals' variance
    least = 0.1 / np.sqrt(max(1.0, *(float(np.trace(part)) for block in parts for part in block)))
    grid = np.append(0.0, np.geomspace(least, LARGEST, int(FINE * np.log10(LARGEST / least)) + 2))
    cauchy = 2 / np.pi / USUAL / (1 + (grid / USUAL) ** 2)
    variance, freedom, interval = np.zeros(groups), np.full(groups, np.inf), np.zeros((groups, 2))
    likelihood, _ = _likelihood(grid, blocks, [np.sum(part, axis=0) for part in parts], [np.zeros(1)] * len(parts))
    some = (1 - NONE) * float(np.trapezoid(likelihood * cauchy, grid))
    none = NONE * likelihood[0] / (NONE * likelihood[0] + some)
    for g in [*range(groups)] * (ROUNDS if groups > 1 else 1):
        if not any(np.any(part[g]) for part in parts):
            continue
        beside = [np.sum([variance[i] * part[i] for i in range(groups) if i != g], axis=0) for part in parts]
        likelihood, effects = _likelihood(grid, blocks, [part[g] for part in parts], beside)
        density = likelihood * cauchy / np.trapezoid(likelihood * cauchy, grid)
        variance[g] = (1 - none) * np.trapezoid(density * grid**2, grid)
        share = variance[g] * effects / (1 + variance[g] * effects)
        freedom[g] = np.sum(share**2)
        below = none + (1 - none) * np.append(0.0, np.cumsum(np.diff(grid) * (density[1:] + density[:-1]) / 2))
        interval[g] = grid[np.minimum(np.searchsorted(below, [0.025, 0.975]), len(grid) - 1)]
    squares = sum(float(right @ right) for right, _ in blocks)
    return VarianceComponents(variance, freedom, interval, float(none),
                              float(chdtrc(sum(len(right) for right, _ in blocks), squares)))


def _likelihood(grid: Array, blocks: Sequence[tuple[Array, Sequence[Array]]], parts: Sequence[Array],
                beside: Sequence[Array]) -> tuple[Array, Array]:
    """Likelihood of each κ of a grid, over the largest, where a covariance κ²·part is added to 1 and others beside; and
    the eigenvalues of the parts in units of the latter."""
    deviance, found = np.zeros(len(grid)), []
    for (right, _), part, other in zip(blocks, parts, beside, strict=True):
        # logs without noise can be computed
        unit = np.eye(len(right)) * (1 + ROUNDING_TOLERANCE * np.sum(np.diagonal(np.atleast_2d(other))))
        root = np.linalg.cholesky(unit + other)
        half = np.linalg.solve(root, np.linalg.solve(root, part).T)
        effects, axes = np.linalg.eigh((half + half.T) / 2)
        found.append(np.maximum(effects, 0.0))
        total = 1 + grid[:, None] ** 2 * found[-1]
        deviance += np.sum((axes.T @ np.linalg.solve(root, right)) ** 2 / total + np.log(total), axis=1)
    return np.exp(-(deviance - deviance.min()) / 2), np.concatenate(found)


@dataclass(frozen=True, eq=False)
class FixedEffects:
    """Generalised least squares of fixed effects δ (c,), in coordinates that are white with the random effects.

    Attributes:
        effects: (k, c) of a unit of each.
        sizes: (c,) lengths of these before other parameters explained a part of them.
        sums: (k,) the measurements.
        rows: (m, k) the coordinates by independent rows of variance 1.
        freedom: (m,) degrees of freedom with which the variances of these were estimated.
        components: of the random effects.
    """

    effects: Array
    sizes: Array
    sums: Array
    rows: Array
    freedom: Array
    components: VarianceComponents

    @cached_property
    def basis(self) -> Array:
        """Orthonormal basis (k, r) of all effects; the coordinates themselves where these are all that there are."""
        basis = orthonormal(self.effects) if np.any(self.effects) else self.effects[:, :0]
        return np.eye(len(basis)) if basis.shape[0] == basis.shape[1] else basis

    @cached_property
    def joint(self) -> FTest:
        """Of no effect at all."""
        return self.tested(self.basis)

    def tested(self, basis: Array) -> FTest:
        """The test that a subspace (k, d) holds nothing."""
        if basis.size == 0:
            return FTest(0.0, 0, np.inf, 1.0)
        return f_test(basis.T @ self.sums, (self.rows @ basis) ** 2, self.freedom)

    @cached_property
    def units(self) -> Array:
        """Direction (k, c) in which each effect is measured whatever the others are; NaN where there is none."""
        units = np.full(self.effects.shape, np.nan)
        for j in range(len(self.sizes)):
            others = np.delete(self.effects, j, axis=1)
            own = without(orthonormal(others), self.effects[:, j]) if np.any(others) else self.effects[:, j]
            length = float(np.linalg.norm(own))
            if length > SEPARABLE * self.sizes[j]:
                units[:, j] = own / length
        return units

    def along(self, units: Array) -> tuple[Array, Array, Array]:
        """Effects (c,) measured in directions (k, c) of their own, their standard deviations and degrees of freedom."""
        length = np.sum(units * self.effects, axis=0)
        known = np.isfinite(length) & (length != 0)
        length[~known] = np.nan
        freedom = np.where(known, combined((self.rows @ np.where(known, units, 0.0)) ** 2, self.freedom), np.nan)
        return np.sum(units * self.sums[:, None], axis=0) / length, 1 / np.abs(length), freedom

    def alone(self, given: Sequence[int] = ()) -> tuple[float, tuple[Array, Array, Array], Array]:
        """What effects do beside those at some places that are given.

        Returns:
            The p-value that there are no others; each effect as if it were the only other one, with its standard
            deviation and degrees of freedom; the p-value (c,) that the rest then is none; NaN where it has no effect.
        """
        basis = orthonormal(self.effects[:, given]) if np.any(self.effects[:, given]) else self.effects[:, :0]
        own = without(basis, self.effects)
        length = np.linalg.norm(own, axis=0)
        own /= np.where(length > SEPARABLE * self.sizes, length, np.nan)
        others = own[:, np.isfinite(own[0])]
        whole = orthonormal(others) if others.size else others
        rest = [self.tested(_rest(unit, whole)).p_value if np.all(np.isfinite(unit)) else np.nan for unit in own.T]
        return self.tested(whole).p_value, self.along(own), np.array(rest)


def _rest(unit: Array, basis: Array) -> Array:
    """Orthonormal basis of what a direction in a subspace leaves of it."""
    left, size, _ = np.linalg.svd(without(unit[:, None], basis), full_matrices=False)
    return np.asarray(left[:, size > 0.5])  # each is 0 or 1


@dataclass(frozen=True, eq=False)
class MixedModel:
    """Measurements with random effects, in coordinates of variance 1 without these.

    Attributes:
        sums: (k,) the measurements.
        rows: (m, k) the coordinates by independent rows of variance 1.
        freedom: (m,) degrees of freedom with which the variances of these were estimated.
        random: by group, columns (k, ·) of its random effects.
    """

    sums: Array
    rows: Array
    freedom: Array
    random: tuple[Array, ...]

    def outside(self, effects: Array) -> Array:
        """Orthonormal basis (k, ·) of what fixed effects with columns (k, c) cannot explain."""
        span = orthonormal(effects) if np.any(effects) else effects[:, :0]
        return np.asarray(np.linalg.qr(span, mode="complete")[0][:, span.shape[1]:])

    def components(self, effects: Array) -> VarianceComponents:
        """Variances of the random effects, by what fixed effects with columns (k, c) leave."""
        rest = self.outside(effects)
        if not rest.shape[1]:
            count = len(self.random)
            return VarianceComponents(np.zeros(count), np.full(count, np.inf), np.zeros((count, 2)), 1.0, np.nan)
        return variance_components([(rest.T @ self.sums, [rest.T @ D for D in self.random])])

    def fixed(self, effects: Array, sizes: Array, components: VarianceComponents) -> FixedEffects:
        """Estimate fixed effects with columns (k, c), whose lengths were (c,), beside random ones of these variances.
        """
        apart = [np.sqrt(variance) * D for variance, D in zip(components.variance, self.random, strict=True)]
        values, axes = np.linalg.eigh(np.eye(len(self.sums)) + sum((D @ D.T for D in apart), np.zeros((1, 1))))
        white = axes / np.sqrt(values) @ axes.T
        freedom = [self.freedom, *(np.full(D.shape[1], UNEQUAL) for D in apart)]
        return FixedEffects(white @ effects, sizes, white @ self.sums,
                            np.vstack([self.rows @ white, *(D.T @ white for D in apart)]), np.concatenate(freedom),
                            components)
