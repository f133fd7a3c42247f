"""The most probable motion of a machine, and the numbers that its sensors have in common.

The joints' motion is a quintic spline q(t) = B(t)·c, whose third derivative counts as white noise. With geometric
numbers g, constant biases b, and delay and drift of clocks, all with their stated spread, it is the minimum over all of

    Σ ((z − h(q, q̇, q̈; g) − b)/σ)² + ∫ (q'''/s)² dt + Σ ((g − g₀)/σ_g)² + Σ (b/σ_b)² + …

at the stamps of each channel, whatever its rate (continuous-time batch estimation, Furgale et al. 2012). The intensity
s of each joint's motion follows from the data by expectation and maximisation. Coefficients meet only their neighbours,
so that normal equations are banded but for the common numbers, and the covariance of everything comes from the same
factors.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import SolverError
from hydroopt.estimation.motion.banded import Bordered, add_blocks
from hydroopt.estimation.motion.observations import PAST, WEIGHTS, Common, Observations, longest
from hydroopt.estimation.motion.paths import Path, Spline, Support, motion
from hydroopt.machine.parameter_kind import ParameterKind
from hydroopt.machine.sensors import Lag
from hydroopt.model.sensor_readings import SensorReadings
from hydroopt.spatial.inertia import Array

CHUNK = 2048
"""Samples whose rows are in memory at a time."""
STEPS = 40
CONVERGED = 1e-3
"""The fit has converged when a step moves no common number by more than this part of its standard deviation."""
STEADY = 0.1
"""Relative change of the intensities below which they count as found."""
SMALLEST = 1e-3
"""Smallest part of a step that is tried."""
SHORTEST_LAG = 1e-3
"""The shortest that a lag is taken to be, as a part of the stated one."""
WEAK = 10.0
"""Spread of a coefficient about the middle of its joint's range, in ranges, so that what nobody measures is bounded."""


@dataclass(frozen=True, eq=False)
class Stretch:
    """A path with the readings that belong to it, and the place of their biases and clocks among the common numbers."""

    path: Path
    data: tuple[Observations, ...]

    @property
    def begin(self) -> float:
        """Time of the first reading [s]."""
        return min(float(each.stamped[0]) for each in self.data)

    @property
    def end(self) -> float:
        """Time of the last reading [s]."""
        return max(float(each.stamped[-1]) for each in self.data)

    def back(self, data: Observations) -> int:
        """How many coefficients lagging readings reach back."""
        return int(np.ceil(data.memory / self.path.basis.spacing)) if isinstance(self.path, Spline) else 0

    def moved(self, step: Array) -> Stretch:
        """With other coefficients."""
        return replace(self, path=self.path.moved(step))


@dataclass(frozen=True, eq=False)
class Rows:
    """Readings linearised: whitened residuals (N, m), derivatives by the coefficients (N, m, width·n) from the `first`
    (N,) on and by the common numbers (N, m, p)."""

    left: Array
    by_path: Array
    by_common: Array
    first: NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class MotionFit:
    """The state of a fit; `solve` ends it.

    Attributes:
        readings: by the channels of observations.
        stretches: paths and what was read along them.
        common: numbers that all have in common: geometry first, then biases, then clocks.
        value: (p,) their values.
        intensity: (n,) of the white noise that each joint's third derivative counts as [rad²/s⁵ or m²/s⁵].
        middle, span: (n,) of the joints' ranges.
    """

    readings: dict[tuple[str, ...], SensorReadings]
    stretches: tuple[Stretch, ...]
    common: tuple[Common, ...]
    value: Array
    intensity: Array
    middle: Array
    span: Array

    @cached_property
    def places(self) -> dict[str, int]:
        """Places of the common numbers by name."""
        return {each.name: k for k, each in enumerate(self.common)}

    @cached_property
    def _possible(self) -> tuple[Array, Array]:
        """Smallest and largest values (p,) of the common numbers: lags are positive, and as long as paths allow for."""
        ranges = [(SHORTEST_LAG * each.prior, longest(each.prior, each.sigma)) if each.kind is ParameterKind.LAG
                  else (-np.inf, np.inf) for each in self.common]
        lower, upper = np.array(ranges).reshape(-1, 2).T
        return lower, upper

    @property
    def sigma(self) -> Array:
        """Standard deviations (p,) before."""
        return np.array([each.sigma for each in self.common])

    def rows(self, stretch: Stretch, data: Observations, part: slice) -> Rows:
        """Some samples of observations, linearised."""
        t, shift = self._stamps(data, part)
        path, back, (n, m) = stretch.path, stretch.back(data), (len(t), len(data.channels))
        made, at = self.readings[data.channels], np.arange(n)
        places = np.array([self.places[number.name] for number in made.numbers], dtype=np.intp)
        values, by_common = np.zeros((n, m)), np.zeros((n, m, len(self.common)))
        by_path = np.zeros((n, m, path.width + back, len(self.intensity)))
        first = np.maximum(path.support(t).first - back, 0)
        for lag, chosen, past, weight in self._moments(data):
            support = path.support(t - past)
            q, qd, qdd, jerk = motion(path, support)
            read, *by_motion, by_g = made(q, qd, qdd, self.value[places])
            values[:, chosen] += weight * read[:, chosen]
            by_common[np.ix_(at, chosen, places)] += weight * by_g[:, chosen]
            if shift or lag.sigma:
                flow = weight * sum(np.einsum("kmn,kn->km", by, x)
                                    for by, x in zip(by_motion, (qd, qdd, jerk), strict=True))
                late = {lag.name: np.full(n, -past / self._time_constant(lag))} if lag.sigma else {}
                for name, factor in (shift | late).items():
                    by_common[:, chosen, self.places[name]] += flow[:, chosen] * factor[:, None]
            own = sum(np.einsum("kw,kmn->kmwn", support.values[order], by[:, chosen])
                      for order, by in enumerate(by_motion))
            knots = (support.first - first)[:, None] + np.arange(path.width)
            by_path[at[:, None, None], chosen[:, None], knots[:, None, :]] += weight * own
        for k in np.flatnonzero(data.biased):
            place = self.places[data.bias(data.channels[k])]
            values[:, k] += self.value[place]
            by_common[:, k, place] = 1.0
        root = np.where(data.used[part] & np.isfinite(values), 1 / data.sigma, 0.0)
        left = np.where(root > 0, data.values[part] - values, 0.0) * root
        if not np.all(np.isfinite(values)):  # a linkage that cannot close
            by_path, by_common = np.nan_to_num(by_path), np.nan_to_num(by_common)
        return Rows(left, by_path.reshape(n, m, -1) * root[:, :, None], by_common * root[:, :, None], first)

    def left(self, stretch: Stretch, data: Observations, part: slice = slice(None)) -> Array:
        """Whitened residuals (N, m); zero where there is no reading."""
        made = self.readings[data.channels]
        t, _ = self._stamps(data, part)
        g = self.value[[self.places[number.name] for number in made.numbers]]
        values = np.zeros((len(t), len(data.channels)))
        for _, chosen, past, weight in self._moments(data):
            q, qd, qdd, _ = motion(stretch.path, stretch.path.support(t - past))
            values[:, chosen] += weight * made.values(q, qd, qdd, g)[:, chosen]
        for k in np.flatnonzero(data.biased):
            values[:, k] += self.value[self.places[data.bias(data.channels[k])]]
        used = data.used[part] & np.isfinite(values)
        return np.where(used, data.values[part] - values, 0.0) / data.sigma

    def _moments(self, data: Observations) -> Iterator[tuple[Lag, NDArray[np.intp], float, float]]:
        """By lags the channels that have them, and how long ago [s] they read the motion with which weight."""
        for lag, chosen in data.by_lag.items():
            moments = zip(PAST * self._time_constant(lag), WEIGHTS, strict=True) if lag.value else ((0.0, 1.0),)
            for past, weight in moments:
                yield lag, chosen, float(past), float(weight)

    def _time_constant(self, lag: Lag) -> float:
        return float(self.value[self.places[lag.name]]) if lag.sigma else lag.value

    def clock(self, data: Observations) -> tuple[float, float]:
        """Delay [s] and drift of the clock of observations."""
        known = (data.clock.delay, data.clock.drift)
        delay, drift = (self.value[self.places[name]] if name in self.places else value
                        for name, value in zip((data.bias("delay"), data.bias("drift")), known, strict=True))
        return float(delay), float(drift)

    def _stamps(self, data: Observations, part: slice) -> tuple[Array, dict[str, Array]]:
        """When readings were taken, and how that changes with delay and drift of their clock."""
        delay, drift = self.clock(data)
        t = data.taken(delay, drift, part)
        by = {data.bias("delay"): -np.ones_like(t) / (1 + drift), data.bias("drift"): -t / (1 + drift)}
        return t, {name: factor for name, factor in by.items() if name in self.places}

    def equations(self, stretch: Stretch) -> tuple[Bordered, float]:
        """Normal equations of a stretch without the priors of the common numbers, and its part of the objective."""
        path, n = stretch.path, len(self.intensity)
        count, p = len(path.coefficients), len(self.common)
        widest = (path.width + max(stretch.back(data) for data in stretch.data)) * n
        band, border = np.zeros((widest, count * n)), np.zeros((count * n, p))
        corner, right, right_corner = np.zeros((p, p)), np.zeros(count * n), np.zeros(p)
        total = 0.0
        for data in stretch.data:
            for start in range(0, len(data.t), CHUNK):
                part = slice(start, min(start + CHUNK, len(data.t)))
                rows = self.rows(stretch, data, part)
                total += float(np.sum(rows.left**2))
                order = np.argsort(rows.first, kind="stable")
                first, at = np.unique(rows.first[order], return_index=True)
                across = rows.by_path[order].transpose(0, 2, 1)
                by_common, left = rows.by_common[order], rows.left[order]
                add_blocks(band, np.add.reduceat(across @ across.transpose(0, 2, 1), at), first, n)
                places = first[:, None] * n + np.arange(across.shape[1])
                np.add.at(border, places, np.add.reduceat(across @ by_common, at))
                np.add.at(right, places, np.add.reduceat((across @ left[:, :, None])[:, :, 0], at))
                flat = by_common.reshape(left.size, p)
                corner += flat.T @ flat
                right_corner += flat.T @ left.ravel()
        away = path.coefficients - self.middle
        loose = 1 / (WEAK * self.span) ** 2
        band[0] += np.tile(loose, count)
        right -= (loose * away).ravel()
        total += float(np.sum(loose * away**2))
        if isinstance(path, Spline):
            rough = path.roughness
            for offset, diagonal in enumerate(rough):
                size = count - offset
                values = (diagonal[:size, None] / self.intensity).ravel()
                band[offset * n, : size * n] += values
            pulled = _band_times(rough, path.coefficients)
            right -= (pulled / self.intensity).ravel()
            total += float(np.sum(path.coefficients * pulled / self.intensity))
        return Bordered(band, border, corner, right, right_corner), total

    def linearised(self) -> tuple[list[Bordered], Array, Array, float]:
        """Normal equations of all stretches, matrix and right side of what they leave for the common numbers with
        their priors, and the objective."""
        found = [self.equations(stretch) for stretch in self.stretches]
        information = 1 / self.sigma**2
        prior = np.array([each.prior for each in self.common])
        matrix, right = np.diag(information), information * (prior - self.value)
        for each, _ in found:
            own, side = each.reduced
            matrix, right = matrix + own, right + side
        total = sum(cost for _, cost in found) + float(np.sum(information * (self.value - prior) ** 2))
        return [each for each, _ in found], matrix, right, total

    def objective(self) -> float:
        """The objective alone."""
        prior = np.array([each.prior for each in self.common])
        total = float(np.sum(((self.value - prior) / self.sigma) ** 2))
        for stretch in self.stretches:
            path = stretch.path
            total += sum(float(np.sum(self.left(stretch, data) ** 2)) for data in stretch.data)
            total += float(np.sum(((path.coefficients - self.middle) / (WEAK * self.span)) ** 2))
            if isinstance(path, Spline):
                total += float(np.sum(path.coefficients * _band_times(path.roughness, path.coefficients)
                                      / self.intensity))
        return total

    def stepped(self, equations: Sequence[Bordered], step: Array, part: float = 1.0) -> MotionFit:
        """After `part` of a step of the common numbers (p,) and of what follows from it."""
        n = len(self.intensity)
        value = np.clip(self.value + part * step, *self._possible)
        return replace(self, value=value, stretches=tuple(
            stretch.moved(part * each.inner(step).reshape(-1, n))
            for stretch, each in zip(self.stretches, equations, strict=True)))

    def roughness(self, equations: Sequence[Bordered], covariance: Array) -> Array:
        """Intensities (n,) of the joints' third derivative that are most probable, by one step of expectation and
        maximisation."""
        n = len(self.intensity)
        total, free = np.zeros(n), 0
        for stretch, each in zip(self.stretches, equations, strict=True):
            path = stretch.path
            if not isinstance(path, Spline):
                continue
            rough, spread = path.roughness, each.inverse_band(covariance)
            count = len(path.coefficients)
            total += np.sum(path.coefficients * _band_times(rough, path.coefficients), axis=0)
            for offset, diagonal in enumerate(rough):
                own = spread[offset * n, : (count - offset) * n].reshape(-1, n)
                total += (1 + (offset > 0)) * np.sum(diagonal[: count - offset, None] * own, axis=0)
            free += count - 3
        return total / free if free else self.intensity


def _band_times(band: Array, x: Array) -> Array:
    """A symmetric matrix in lower band storage (w, k) times x (k, n)."""
    found = band[0][:, None] * x
    for offset, diagonal in enumerate(band[1:], start=1):
        size = len(x) - offset
        found[offset:] += diagonal[:size, None] * x[:size]
        found[:size] += diagonal[:size, None] * x[offset:]
    return np.asarray(found)


@dataclass(frozen=True, eq=False)
class FittedPaths:
    """A fit at its optimum: values and covariance (p, p) of the common numbers, the paths with their last normal
    equations, and how many steps the solver took."""

    fit: MotionFit
    covariance: Array
    equations: tuple[Bordered, ...]
    steps: int

    @cached_property
    def _spreads(self) -> tuple[Array, ...]:
        """Bands of the covariance of each stretch's coefficients."""
        return tuple(each.inverse_band(self.covariance) for each in self.equations)

    def std(self, stretch: int, support: Support) -> Array:
        """Standard deviations (N, n) of the joints' positions."""
        n, spread = len(self.fit.intensity), self._spreads[stretch]
        width = self.fit.stretches[stretch].path.width
        variance = np.zeros((len(support.first), n))
        for a in range(width):
            for b in range(width):
                low, offset = support.first + min(a, b), abs(a - b)
                block = spread[offset * n][(low[:, None] * n + np.arange(n))]
                variance += (support.values[0][:, a] * support.values[0][:, b])[:, None] * block
        return np.sqrt(np.maximum(variance, 0.0))


def solve(start: MotionFit, where: str, enough: int | None = None) -> FittedPaths:
    """The most probable motion and common numbers, by Gauss-Newton steps; after `enough` steps whatever it is then.

    Raises:
        SolverError: the steps do not converge.
    """
    fit = start
    equations, matrix, right, cost = fit.linearised()
    for count in range(1, STEPS + 1):
        covariance = np.asarray(np.linalg.inv(matrix), dtype=np.float64)
        step = covariance @ right
        part = 1.0
        while True:
            moved = fit.stepped(equations, step, part)
            decrease = cost - moved.objective()
            if decrease >= -1e-9 * cost or part < SMALLEST:
                break
            part /= 2
        size = float(np.max(np.abs(part * step) / np.sqrt(np.diag(covariance)), initial=0.0))
        before, fit = fit, moved
        intensity = fit.roughness(equations, covariance)
        changed = float(np.max(np.abs(np.log(intensity / before.intensity)), initial=0.0))
        fit = replace(fit, intensity=intensity)
        equations, matrix, right, cost = fit.linearised()
        if (size < CONVERGED and decrease < 1.0 and changed < STEADY) or count == enough:
            final = np.asarray(np.linalg.inv(matrix), dtype=np.float64)
            return FittedPaths(fit, final, tuple(equations), count)
    raise SolverError(f"the fit of the motion did not converge in {STEPS} steps", where=where,
                      remedy="check units, axes and signs of the sensors, or leave a channel out")
