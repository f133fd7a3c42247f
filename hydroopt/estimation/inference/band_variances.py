"""The variance of residuals by frequency, and the covariance of least squares that follows from it.

Residuals of a real machine are not white: what the model lacks repeats with the motion, so that the residual's spectrum
is largest where the parameters act. Weighted least squares stays unbiased then, but its covariance is that of its
score (Godambe's sandwich): with rows ``K_ib`` of channel i in frequency band b, weights ``w_i`` and variances ``S_ib``,

    H = Σ w_i·K_ibᵀ·K_ib,   J = Σ w_i²·S_ib·K_ibᵀ·K_ib,   covariance H⁻¹·J·H⁻¹.

The variances come from the residuals by restricted maximum likelihood: each band counts the freedom that the fit has
taken from it, and neighbouring bands share what they know, since a spectrum is smooth (`STEP`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, solveh_banded
from scipy.special import fdtrc, stdtrit

from hydroopt.estimation.inference.identifiability import ROUNDING_TOLERANCE
from hydroopt.estimation.inference.least_squares import ROUNDING
from hydroopt.spatial.inertia import Array

ROUNDS = 6
"""Times that variances and fit are computed from one another; more change intervals by less than a percent."""
STEP = 1.0
"""Standard deviation of the change of log S from one band to the next: a spectrum like f² or f⁻² is within one."""
LEAST = 1e-3
"""Part of a band's freedom that a fit leaves at least."""
MANY = 1e9
"""Degrees of freedom that are as good as infinitely many."""
FEWEST = 0.02
"""Degrees of freedom that are as good as none: the quantile of Student's t is 1e64, and still a number."""
NORMAL = 1.959964
"""Quantile of the normal distribution at 97.5 %, by which 95 % intervals are computed."""


@dataclass(frozen=True, eq=False)
class Channel:
    """Rows of one channel by frequency: `rows[b]` (m_b, c+1) of [K, f] in band b, up to a rotation.

    Attributes:
        columns: (c,) which parameters K depends on.
        rows: one block a band.
        counts: (B,) how many residuals each stands for.
    """

    columns: NDArray[np.intp]
    rows: tuple[Array, ...]
    counts: Array

    @cached_property
    def stacked(self) -> Array:
        """All rows (m, c+1), band after band."""
        return np.vstack(self.rows)

    @cached_property
    def triangle(self) -> Array:
        """R (·, c+1) of a QR of them."""
        return np.asarray(np.linalg.qr(self.stacked, mode="r"))


class Spectrum(NamedTuple):
    """Variances S (B,) of a channel's residuals by band, their degrees of freedom (B,), and the channel's weight w.

    `noisy` is the share of the stated noise of K that the residuals admit, at most 1.
    """

    variance: Array
    freedom: Array
    weight: float
    noisy: float = 1.0


class Shared(NamedTuple):
    """Errors that all rows of a stretch of data share: ``K·direction·x`` with x of a variance that was estimated.

    Attributes:
        directions: (c, k) products KᵀC of a channel's rows K with the columns C of such errors, by stretch.
        variance, freedom: of x.
    """

    directions: tuple[Array, ...]
    variance: float
    freedom: float


def band_variances(channels: Sequence[Channel], sigma: Array, prior: tuple[Array, Array], scale: Array,
                   least: Array, noise: Mapping[int, Array] | None = None) -> tuple[Spectrum, ...]:
    """Variances of residuals by band, from a least-squares fit under the priors.

    Priors that the data contradict weigh less by a variance of their own, at least 1: otherwise their errors would
    pass for residuals.

    Rows 0 = K·ψ with noise in K are fitted best by ψ = 0, with residuals and a variance that vanish together. What
    noise adds to KᵀK is therefore taken out of the fit, at the ψ of the round before, which is that of the priors at
    first. Residuals smaller than it makes them show that K is less noisy than stated, and it counts as much less.

    Args:
        channels: rows of each.
        sigma: (n,) initial standard deviations of residuals.
        prior: rows and right-hand side of ``‖rows·ψ − right‖²``.
        scale: (p,) sizes of the parameters.
        least: (n,) variances that none of a channel is below.
        noise: by channel, the (c, c) expected part of KᵀK that is noise of K.
    """
    noise = noise or {}
    counts = np.array([channel.counts for channel in channels])
    silent = ~np.any(counts, axis=1)
    if np.any(silent):  # one without rows has the variance that it is given
        place = {k: i for i, k in enumerate(np.flatnonzero(~silent).tolist())}
        heard = iter(band_variances([channels[k] for k in place], sigma[~silent], prior, scale, least[~silent],
                                    {place[k]: added for k, added in noise.items() if k in place}) if place else ())
        return tuple(Spectrum(np.full(len(none), std**2), none, float(1 / std**2)) if left_out else next(heard)
                     for none, std, left_out in zip(_smooth(counts, counts)[1], sigma, silent, strict=True))
    weight, variance = 1 / sigma**2, np.repeat(sigma[:, None] ** 2, counts.shape[1], axis=1)
    freedom, belief = counts.copy(), 1.0
    # coordinates z in which weighted rows and priors are orthonormal at first, so that products of rows are harmless
    whole = [channel.stacked for channel in channels]
    stacked = np.vstack([*(_all_columns(np.sqrt(w) * channel.triangle[:, :-1], channel.columns, len(scale))
                           for w, channel in zip(weight, channels, strict=True)), prior[0]])
    _, singular, axes = np.linalg.svd(np.linalg.qr(stacked * scale, mode="r"), full_matrices=False)
    known = singular > ROUNDING_TOLERANCE * singular[0]
    base = scale[:, None] * axes[known].T / singular[known]
    moved = [rows[:, :-1] @ base[channel.columns] for rows, channel in zip(whole, channels, strict=True)]
    sides = np.array([rows.T @ block[:, -1] for rows, block in zip(moved, whole, strict=True)])
    band = [np.repeat(np.arange(counts.shape[1]), [len(rows) for rows in channel.rows]) for channel in channels]
    products = np.array([[_gram(rows[first:end]).ravel() for first, end in pairwise(
        np.searchsorted(of, np.arange(counts.shape[1] + 1)).tolist())]
        for rows, of in zip(moved, band, strict=True)])  # (n, B, k·k): sums of them are products of matrices
    P, PP = prior[0] @ base, _gram(prior[0] @ base)
    added = {k: base[channels[k].columns].T @ one @ base[channels[k].columns] for k, one in noise.items()}
    share, z = np.ones(len(channels)), np.zeros(len(PP))
    if added:  # how noisy K is shows whatever the size of ψ, whose direction is that of a fit
        z = np.linalg.inv((weight @ products.sum(axis=1)).reshape(PP.shape) + PP) @ (weight @ sides + P.T @ prior[1])
        for k, one in added.items():
            share[k] = _share(float(z @ products[k].sum(axis=0).reshape(PP.shape) @ z), float(z @ one @ z))
        z = np.linalg.lstsq(P, prior[1], rcond=None)[0]
    for _ in range(ROUNDS):
        information = (weight @ products.sum(axis=1)).reshape(PP.shape) + belief * PP
        inverse = cho_solve(cho_factor(information), np.eye(len(PP)))
        unshrunk = sum((share[k] * weight[k] * one @ z for k, one in added.items()), np.zeros(len(PP)))
        z = inverse @ (weight @ sides + unshrunk + belief * P.T @ prior[1])
        squares = np.array([np.bincount(of, (rows @ z - block[:, -1]) ** 2, counts.shape[1])
                            for rows, block, of in zip(moved, whole, band, strict=True)])
        leverage = weight[:, None] * (products @ inverse.ravel())
        score = (weight[:, None] ** 2 * variance).ravel() @ products.reshape(counts.size, PP.size)
        taken = products @ (inverse @ (score.reshape(PP.shape) + belief * PP) @ inverse).ravel()
        expected = np.maximum((counts - 2 * leverage) * variance + taken, LEAST * counts * variance)
        ratio = np.where(counts > 0, squares / np.maximum(expected, 1e-300), 1.0)
        left = np.maximum(counts - leverage, LEAST * counts)
        variance, freedom = _smooth(variance * ratio, left)
        variance = np.maximum(variance, least[:, None])
        for k, one in added.items():
            share[k] = _share(float(counts[k] @ variance[k]), float(z @ one @ z))
        spared = len(P) - belief * float(np.sum(PP * inverse))
        belief = min(1.0, spared / max(float(np.sum((P @ z - prior[1]) ** 2)), 1e-300)) if spared > 1e-6 else 1.0
        seen = leverage.sum(axis=1)
        weight = np.where(seen > 0, seen / np.where(seen > 0, (leverage * variance).sum(axis=1), 1.0), 1 / sigma**2)
    return tuple(Spectrum(*one) for one in zip(variance, freedom, weight.tolist(), share.tolist(), strict=True))


def _share(shown: float, expected: float) -> float:
    """The part of a sum of squares that is expected which another one shows, at most 1."""
    return min(1.0, shown / expected) if expected > 0 else 1.0


@dataclass(frozen=True, eq=False)
class ScoreRows:
    """Rows of unit variance ``rows·ψ = right`` (k,) with the information of weighted least squares about ψ.

    Each row is a principal direction of the score's covariance; `freedom` (k,) are the degrees of freedom that its
    variance was estimated with.
    """

    rows: Array
    right: Array
    rest: float
    freedom: Array

    def triangle(self, *, widened: bool) -> Array:
        """[rows, right] and a last row of what no ψ explains, (p+1, p+1); where `widened`, normal 95 % intervals are as
        wide as those of Student's t.
        """
        p = self.rows.shape[1]
        made = np.zeros((p + 1, p + 1))
        made[: len(self.rows)] = np.column_stack([self.rows, self.right])
        if widened:
            made[: len(self.rows)] *= students(self.freedom)[:, None]
        made[p, p] = np.sqrt(self.rest)
        return made


def score_rows(channel: Channel, spectrum: Spectrum, scale: Array, shared: Sequence[Shared] = (),
               noise: Array | None = None) -> ScoreRows:
    """The information of one channel about the parameters, by the covariance of its score.

    No direction has a smaller variance than the channel's weight says: priors and other channels would lean on
    directions that look good by chance.

    Args:
        channel, spectrum: rows, and variances of their residuals.
        scale: (p,) sizes of the parameters.
        shared: errors beside the residuals.
        noise: (c, c) expected part of KᵀK that is noise of K, which carries no information.
    """
    if not np.any(channel.counts):
        return ScoreRows(np.zeros((0, len(scale))), np.zeros(0), 0.0, np.zeros(0))
    own, w = scale[channel.columns], spectrum.weight
    R = np.sqrt(w) * channel.triangle
    left, singular, axes = np.linalg.svd(R[: len(own), :-1] * own, full_matrices=False)
    value = left.T @ R[: len(own), -1]
    sound = singular > ROUNDING * np.max(singular, initial=0.0)  # of a channel without columns: none
    onto = own[:, None] * axes[sound].T / singular[sound]
    parts = [w**2 * variance * _gram(rows[:, :-1] @ onto)
             for variance, rows in zip(spectrum.variance, channel.rows, strict=True)]
    freedoms = spectrum.freedom
    for errors in shared:
        parts.append(w**2 * errors.variance * np.sum([_gram(C.T @ onto) for C in errors.directions], axis=0))
        freedoms = np.append(freedoms, errors.freedom)
    size, directions = np.linalg.eigh(np.sum(parts, axis=0))
    spread = np.array([np.sum(directions * (part @ directions), axis=0) for part in parts])
    freedom = np.sum(spread, axis=0) ** 2 / np.sum(spread**2 / freedoms[:, None], axis=0)
    root = np.sqrt(np.maximum(size, 1.0))
    rows = np.zeros((len(singular), len(scale)))
    rows[:, channel.columns] = np.vstack([directions.T @ (singular[sound, None] * axes[sound]) / root[:, None],
                                          singular[~sound, None] * axes[~sound]]) / own
    if noise is not None:
        rows[: len(root), channel.columns] -= w * directions.T @ onto.T @ noise / root[:, None]
    right = np.concatenate([directions.T @ value[sound] / root, value[~sound]])
    rest = float(R[:, -1] @ R[:, -1] - value @ value)
    return ScoreRows(rows, right, max(rest, 0.0), np.append(freedom, np.full(np.sum(~sound), np.inf)))


def students(freedom: Array) -> Array:
    """Factors on rows of unit variance with which normal 95 % intervals are as wide as those of Student's t."""
    return np.asarray(NORMAL / stdtrit(np.clip(freedom, FEWEST, MANY), 0.975))


def _smooth(estimate: Array, freedom: Array) -> tuple[Array, Array]:
    """Most probable variances (n, B) of neighbouring bands and their freedom, from estimates with their own freedom."""
    coupling = _coupling(estimate.shape[1])
    own, beside = np.diag(coupling) + 1e-9, np.tile(np.append(np.diag(coupling, 1), 0.0), len(estimate))
    total = np.sum(freedom, axis=1, keepdims=True)
    mean = np.where(total > 0, np.sum(freedom * estimate, axis=1, keepdims=True) / np.where(total > 0, total, 1.0), 1.0)
    x, half = np.zeros_like(estimate), freedom / 2
    sound, shown = mean > 0, half * estimate / np.where(mean > 0, mean, 1.0)
    for _ in range(30):
        expected = shown * np.exp(-x)
        slope = half - expected + x @ coupling
        bent = own + np.maximum(expected, 0.1 * half)
        bands = np.stack([bent.ravel(), beside])[: x.size]  # one unknown has no neighbours
        step = solveh_banded(bands, slope.ravel(), lower=True).reshape(x.shape)
        x -= np.minimum(np.maximum(step, -1), 1)
        if np.abs(step[sound[:, 0]]).max(initial=0.0) < 1e-6:
            break
    spread = np.diagonal(np.linalg.inv(coupling + (half + 1e-9)[:, :, None] * np.eye(len(coupling))), 0, 1, 2)
    return np.where(sound, mean * np.exp(x), estimate), np.where(sound, 2 / spread, freedom)


@cache
def _coupling(bands: int) -> Array:
    """The matrix (B, B) of the squares of differences between neighbours, over `STEP`²."""
    weights = np.full(bands - 1, 1 / STEP**2)
    return np.diag(np.append(weights, 0.0) + np.append(0.0, weights)) - np.diag(weights, 1) - np.diag(weights, -1)


def _gram(rows: Array) -> Array:
    return np.asarray(rows.T @ rows)


def _all_columns(rows: Array, columns: NDArray[np.intp], count: int) -> Array:
    wide = np.zeros((len(rows), count))
    wide[:, columns] = rows
    return wide


class FTest(NamedTuple):
    """An F test of k independent sums being zero: statistic, k, degrees of freedom and p-value."""

    statistic: float
    rank: int
    freedom: float
    p_value: float


def combined(shares: Array, freedom: Array) -> Array:
    """Degrees of freedom (k,) of the variances of sums with these squared coefficients (rows, k) of independent rows.

    Rows of one actuator share the errors of its bands: this is the smallest that it can be.
    """
    return np.asarray(np.maximum(np.sum(shares / np.sqrt(freedom)[:, None], axis=0), MANY**-0.5) ** -2)


def f_test(sums: Array, shares: Array, freedom: Array) -> FTest:
    """Whether sums of unit variance, which was estimated by band, are all zero.

    Variances of a few bands are less to estimate than a covariance of all sums: the test is Hotelling's with the
    degrees of freedom ``η = ν·(k + 1)/2`` that give such a covariance the same scatter (Pustejovsky and Tipton 2018).

    Args:
        sums: (k,) each a sum of rows of unit variance.
        shares: (rows, k) squared coefficients of the rows in each sum.
        freedom: (rows,) degrees of freedom of the rows' variances; inf for priors.
    """
    k = len(sums)
    eta = min(max(k / np.sum(1 / combined(shares, freedom)), 2.0) * (k + 1) / 2, MANY)
    left = eta - k + 1
    statistic = float(sums @ sums) * left / (eta * k)
    return FTest(statistic, k, left, float(fdtrc(k, left, statistic)))
