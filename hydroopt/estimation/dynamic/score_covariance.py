"""How uncertain the information of logs is: residuals by frequency, friction from log to log and within a log."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from hydroopt.estimation.dynamic.frequency_bands import BANDS, ActuatorBands
from hydroopt.estimation.dynamic.holds import HoldEquations
from hydroopt.estimation.inference.band_variances import (
    MANY,
    Channel,
    ScoreRows,
    Shared,
    Spectrum,
    band_variances,
    f_test,
    score_rows,
)
from hydroopt.estimation.inference.identifiability import RANK_TOLERANCE, ROUNDING_TOLERANCE
from hydroopt.estimation.inference.least_squares import orthonormal, without
from hydroopt.estimation.inference.mixed_model import UNEQUAL, projected, variance_components
from hydroopt.estimation.inference.problem import StatedProblem
from hydroopt.parameters.parameter_set import ParameterKind, ParameterSet
from hydroopt.results.tables import number
from hydroopt.spatial.inertia import Array

ALIKE = 0.95
"""Probability of no differences between logs above which there are none: intervals of sound logs stay narrow, and logs
without noise exact."""
STEADY = 0.01
"""p-value of no difference between the halves of a log below which its friction is not the same in both."""


@dataclass(frozen=True)
class SplitHalf:
    """How much friction and offsets differ between the two halves of a log.

    Attributes:
        phi: F statistic: the squared difference over what the residuals explain, 1 on average where nothing changes.
        rank: number of differences that the log determines.
        degrees_of_freedom, p_value: of the test of no difference.
    """

    phi: float
    rank: int
    degrees_of_freedom: float
    p_value: float

    def as_dict(self) -> dict[str, Any]:
        """The entry of a JSON file."""
        return {"phi": number(self.phi), "rank": self.rank, "degrees_of_freedom": number(self.degrees_of_freedom),
                "p_value": number(self.p_value)}


class BetweenLogs(NamedTuple):
    """Differences of friction and offsets from log to log: standard deviation relative to the friction force, and the
    p-value of none; NaN for a single log."""

    std: float
    p_value: float


@dataclass(frozen=True, eq=False)
class ScoreCovariance:
    """The information of each actuator, and what it rests on; see `WeightedResiduals`.

    `holds` are rows (·, p+1) of [K, f] of each actuator at rest, whose errors have unit variance; the scores hold them
    too.
    """

    scores: tuple[ScoreRows, ...]
    correlation_time: Array
    between_logs: BetweenLogs
    split_half: tuple[SplitHalf, ...]
    holds: tuple[Array, ...]


def correlation_time(spectra: Sequence[Spectrum], sigma: Array) -> Array:
    """Variance (n,) of the residuals where the parameters act over σ², at least 1; in samples."""
    return np.maximum(1.0, 1 / (np.array([spectrum.weight for spectrum in spectra]) * sigma**2))


class InMotion:
    """The equations of logs in motion, and the spectra of their residuals by these alone.

    Args:
        problem: the priors under which residuals are computed.
        logs: equations of each log by frequency.
        sigma: (n,) standard deviation of each actuator's residual.
        least: (n,) standard deviation below which no frequency's is.
    """

    def __init__(self, problem: StatedProblem, logs: Sequence[ActuatorBands], sigma: Array, least: Array) -> None:
        self.parameters, self.prior = problem.parameters, problem.prior_rows
        self.logs, self.sigma, self.least = logs, sigma, least
        self.together = ActuatorBands.together(logs)

    @cached_property
    def channels(self) -> tuple[Channel, ...]:
        """The rows of each actuator, of all logs together."""
        return self.together.channels()

    @cached_property
    def spectra(self) -> tuple[Spectrum, ...]:
        """Spectra of each actuator's residuals."""
        return band_variances(self.channels, self.sigma, self.prior, self.parameters.scale, self.least**2, self.noise)

    @cached_property
    def noise(self) -> dict[int, Array]:
        """The expected part (c, c) of KᵀK that is noise of K, by actuator."""
        return _noise(self.together, self.channels)

    @property
    def correlation_time(self) -> Array:
        """See `correlation_time`."""
        return correlation_time(self.spectra, self.sigma)

    def beside(self, channels: Sequence[Channel], sigma: Array, least: Array) -> tuple[Spectrum, ...]:
        """Spectra of all residuals, those of other channels with arguments alike after those of the actuators."""
        return band_variances([*self.channels, *channels], np.append(self.sigma, sigma), self.prior,
                              self.parameters.scale, np.append(self.least, least) ** 2, self.noise)

    def split_halves(self) -> tuple[SplitHalf, ...]:
        """The tests of no difference between the halves of each log.

        Residuals are those of a fit that permits the difference, which would otherwise pass for noise.
        """
        scale, (rows, right) = self.parameters.scale, self.prior
        wide = np.concatenate([scale, *(scale[columns] for columns in self.together.contrast)])
        rows = np.hstack([rows, np.zeros((len(rows), len(wide) - len(scale)))])
        channels = self.together.channels(contrasts=True)
        spectra = band_variances(channels, self.sigma, (rows, right), wide, self.least**2,
                                 _noise(self.together, channels))
        each = [channels] if len(self.logs) == 1 else [log.channels(contrasts=True) for log in self.logs]
        return tuple(_split_half(one, spectra, self.prior, scale, wide) for one in each)


def score_covariance(motion: InMotion, holds: Sequence[HoldEquations]) -> ScoreCovariance:
    """The information of each actuator about ψ by the covariance of its score.

    Args:
        motion: equations in motion.
        holds: equations of each actuator at rest.
    """
    scale, channels = motion.parameters.scale, motion.channels
    at_rest = [one.channel(BANDS) for one in holds]
    found = motion.beside(at_rest, np.array([one.initial_std for one in holds]),
                          np.array([one.least for one in holds]))
    spectra, between_holds = found[: len(channels)], found[len(channels):]
    between_logs = BetweenLogs(np.nan, np.nan)
    shared: list[list[Shared]] = [[] for _ in channels]
    if len(motion.logs) > 1:
        between_logs, shared = _between(motion.logs, channels, spectra, motion.parameters, motion.prior)
    means = [one.mean(float(spectrum.variance[0])) for one, spectrum in zip(holds, between_holds, strict=True)]
    noise = {i: spectra[i].noisy * added for i, added in motion.noise.items()}
    rows = [_rows_at_rest(channel, spectrum, mean, len(scale))
            for channel, spectrum, mean in zip(at_rest, between_holds, means, strict=True)]
    return ScoreCovariance(
        tuple(score_rows(*_with_holds(channel, spectrum, hold, between, mean), scale, extra,
                         noise.get(i))
              for i, (channel, spectrum, hold, between, mean, extra)
              in enumerate(zip(channels, spectra, at_rest, between_holds, means, shared, strict=True))),
        correlation_time(spectra, motion.sigma), between_logs, motion.split_halves(), tuple(rows))


def _noise(logs: ActuatorBands, channels: Sequence[Channel]) -> dict[int, Array]:
    """The expected part (c, c) of KᵀK that is noise of K, by actuator; that of contrasts is left out."""
    p, found = logs.noise.shape[-1], dict[int, Array]()
    for i, added in zip(logs.noisy.tolist(), logs.noise, strict=True):
        own = channels[i].columns
        inner = own < p
        found[i] = np.zeros((len(own), len(own)))
        found[i][np.ix_(inner, inner)] = added[np.ix_(own[inner], own[inner])]
    return found


def _with_holds(channel: Channel, spectrum: Spectrum, at_rest: Channel, between: Spectrum,
                mean: Array) -> tuple[Channel, Spectrum]:
    """One channel of an actuator's rows in motion, their mean at rest and their differences at rest, a band each."""
    rows, counts = list(channel.rows), channel.counts
    variance, freedom, weight = spectrum.variance, spectrum.freedom, spectrum.weight
    for block, count, own, known in ((mean, float(len(mean)), 1.0, MANY),
                                     (at_rest.rows[0] * np.sqrt(between.weight), at_rest.counts[0],
                                      between.weight * between.variance[0], between.freedom[0])):
        if count:
            rows, counts = [*rows, block / np.sqrt(weight)], np.append(counts, count)
            variance, freedom = np.append(variance, own / weight), np.append(freedom, known)
    return Channel(channel.columns, tuple(rows), counts), Spectrum(variance, freedom, weight)


def _rows_at_rest(channel: Channel, spectrum: Spectrum, mean: Array, count: int) -> Array:
    """The rows at rest with errors of unit variance, in all `count` columns and that of the force."""
    own = np.vstack([np.sqrt(spectrum.weight) * channel.rows[0], mean])
    rows = np.zeros((len(own), count + 1))
    rows[:, np.append(channel.columns, count)] = own
    return rows


@dataclass(frozen=True, eq=False)
class _OwnFriction:
    """Friction and offset columns of one actuator that each log has of its own, in rows of unit variance.

    Attributes:
        kinds: of the columns (f,).
        columns: (m, logs·f) and `right` (m,), without what the parameters explain.
        products: (c, f) products of all columns of K with these, for each log.
    """

    kinds: tuple[ParameterKind, ...]
    columns: Array
    right: Array
    products: tuple[Array, ...]

    def of_kind(self, kind: ParameterKind) -> Array:
        """The columns (m, ·) of one kind."""
        return self.columns[:, np.tile([one is kind for one in self.kinds], len(self.products))]


def _between(logs: Sequence[ActuatorBands], channels: Sequence[Channel], spectra: Sequence[Spectrum],
             parameters: ParameterSet, prior: tuple[Array, Array]) -> tuple[BetweenLogs, list[list[Shared]]]:
    """Friction and offsets that differ from log to log: their standard deviation and what they add to each score.

    In each log, every friction and offset column of an actuator is off by a random amount whose RMS force is κ times
    that of the actuator's friction; all logs and actuators together give κ of each kind of parameter
    (`hydroopt.estimation.inference.mixed_model`). The least squares are those of one machine, whose mean friction they
    estimate.
    """
    scale = parameters.scale
    scores = [score_rows(channel, spectrum, scale) for channel, spectrum in zip(channels, spectra, strict=True)]
    A, b = (np.concatenate([*(getattr(one, key) for one in scores), rows])
            for key, rows in zip(("rows", "right"), prior, strict=True))
    psi = scale * np.linalg.lstsq(A * scale, b, rcond=ROUNDING_TOLERANCE)[0]
    friction = psi * np.array([kind.is_friction for kind in parameters.kinds])
    shared: list[list[Shared]] = [[] for _ in channels]
    own = {i: found for i, (channel, spectrum) in enumerate(zip(channels, spectra, strict=True))
           if (found := _own_friction(i, logs, channel, spectrum, parameters, friction)) is not None}
    kinds = list(dict.fromkeys(kind for one in own.values() for kind in one.kinds))
    if not kinds:
        return BetweenLogs(0.0, 1.0), shared
    apart = variance_components([(one.right, [one.of_kind(kind) for kind in kinds]) for one in own.values()])
    if apart.none > ALIKE:
        return BetweenLogs(0.0, apart.p_value), shared
    for i, one in own.items():
        for kind, variance, freedom in zip(kinds, apart.variance, apart.freedom, strict=True):
            directions = tuple(product[:, [each is kind for each in one.kinds]] for product in one.products)
            shared[i].append(Shared(directions, float(variance), max(float(freedom), UNEQUAL)))
    return BetweenLogs(float(np.sqrt(np.sum(apart.variance))), apart.p_value), shared


def _own_friction(i: int, logs: Sequence[ActuatorBands], channel: Channel, spectrum: Spectrum,
                  parameters: ParameterSet, friction: Array) -> _OwnFriction | None:
    """Those of actuator i with the parameters `friction` (p,); None where it has none."""
    scale = parameters.scale
    at = np.flatnonzero(np.isin(channel.columns, logs[0].contrast[i]))
    rows = channel.stacked[:, :-1]
    size = np.linalg.norm(rows[:, at], axis=0)
    force = float(np.linalg.norm(rows @ friction[channel.columns]))
    at, size = at[size > 0], size[size > 0]
    if force == 0 or not at.size:
        return None
    own = [log.channels()[i] for log in logs]
    each = [score_rows(one, spectrum, scale) for one in own]
    X = np.vstack([one.rows for one in each])[:, channel.columns]
    Z = np.zeros((len(X), len(each) * len(at)))
    first = np.cumsum([0, *(len(one.rows) for one in each)]).tolist()
    for k, one in enumerate(each):
        Z[first[k] : first[k + 1], k * len(at) : (k + 1) * len(at)] = one.rows[:, channel.columns[at]] * (force / size)
    found = projected(X * scale[channel.columns], Z, np.concatenate([one.right for one in each]), np.ones(Z.shape[1]))
    grams = [one.stacked[:, :-1] for one in own]
    return _OwnFriction(tuple(parameters.kinds[k] for k in channel.columns[at]), found.effects, found.sums,
                        tuple(gram.T @ (gram[:, at] * (force / size)) for gram in grams))


def _split_half(log: Sequence[Channel], spectra: Sequence[Spectrum], prior: tuple[Array, Array], scale: Array,
                wide: Array) -> SplitHalf:
    """The test of one log; all other parameters are the same in both halves."""
    p = len(scale)
    scores = [score_rows(channel, spectrum, wide)
              for channel, spectrum in zip(log, spectra, strict=True)]
    rows = np.vstack([one.rows for one in scores]) * wide
    right = np.concatenate([*(one.right for one in scores), prior[1]])
    freedom = np.concatenate([*(one.freedom for one in scores), np.full(len(prior[1]), np.inf)])
    basis = orthonormal(np.vstack([rows[:, :p], prior[0] * scale]))
    C = np.vstack([rows[:, p:], np.zeros((len(prior[1]), rows.shape[1] - p))])
    size = np.linalg.norm(C, axis=0)
    left, singular, _ = np.linalg.svd(without(basis, C[:, size > 0] / size[size > 0]), full_matrices=False)
    left = left[:, singular > RANK_TOLERANCE]
    if not left.shape[1]:
        return SplitHalf(np.nan, 0, np.nan, np.nan)
    return SplitHalf(*f_test(left.T @ without(basis, right), left**2, freedom))
