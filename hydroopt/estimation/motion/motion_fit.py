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
from itertools import chain
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import SolverError
from hydroopt.estimation.motion.banded import Bordered, Rows
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


class Linearised(NamedTuple):
    """Normal equations of all stretches, matrix (p, p) and right side (p,) of what they leave for the common numbers
    with their priors, and the objective."""

    equations: list[Bordered]
    matrix: Array
    right: Array
    objective: float


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
            own = support.along([by[:, chosen] for by in by_motion]).reshape(n, len(chosen), path.width, -1)
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
        return Rows(left, by_path.reshape(n, m, -1) * root[:, :, None], by_common * root[:, :, None],
                    first * len(self.intensity))

    def _read(self, stretch: Stretch, data: Observations) -> Iterator[Rows]:
        """All samples of observations, some at a time."""
        for start in range(0, len(data.t), CHUNK):
            yield self.rows(stretch, data, slice(start, min(start + CHUNK, len(data.t))))

    def left(self, stretch: Stretch, data: Observations) -> Array:
        """Whitened residuals (N, m); zero where there is no reading."""
        return np.concatenate([rows.left for rows in self._read(stretch, data)])

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

    def read(self, stretch: Stretch) -> Bordered:
        """Normal equations of what was read along a stretch, and of what bounds it where nothing was."""
        path, n, p = stretch.path, len(self.intensity), len(self.common)
        count = len(path.coefficients)
        loose = 1 / (WEAK * self.span)
        bounds = Rows.of_path((self.middle - path.coefficients) * loose, np.tile(np.diag(loose), (count, 1, 1)), p,
                              np.arange(count) * n)
        rows = (some for data in stretch.data for some in self._read(stretch, data))
        width = path.width + max(stretch.back(data) for data in stretch.data)
        return Bordered.of(chain([bounds], rows), count * n, width * n, p)

    def linearised(self, read: Sequence[Bordered] | None = None) -> Linearised:
        """What was `read` along each stretch, with the third derivative as white noise and the common numbers' priors.
        """
        p = len(self.common)
        read = [self.read(stretch) for stretch in self.stretches] if read is None else read
        found = [equations.plus([stretch.path.jerk(self.intensity**-0.5, p)]) if isinstance(stretch.path, Spline)
                 else equations for stretch, equations in zip(self.stretches, read, strict=True)]
        information, prior = 1 / self.sigma**2, np.array([each.prior for each in self.common])
        matrix, right = np.diag(information), information * (prior - self.value)
        for each in found:
            own, side = each.reduced
            matrix, right = matrix + own, right + side
        total = sum(each.squares for each in found) + float(np.sum(information * (self.value - prior) ** 2))
        return Linearised(found, matrix, right, total)

    def stepped(self, equations: Sequence[Bordered], step: Array, part: float) -> MotionFit:
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
            if not isinstance(path := stretch.path, Spline):
                continue
            spread, count = each.inverse_band(covariance), len(path.coefficients)
            total += np.sum(path.jerk(np.ones(n), 0).left ** 2, axis=0)
            for offset, diagonal in enumerate(path.roughness):
                own = spread[offset * n, : (count - offset) * n].reshape(-1, n)
                total += (1 + (offset > 0)) * np.sum(diagonal[: count - offset, None] * own, axis=0)
            free += count - 3
        return total / free if free else self.intensity


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
    fit, read = start, [start.read(stretch) for stretch in start.stretches]
    now = fit.linearised(read)
    for count in range(1, STEPS + 1):
        covariance = np.asarray(np.linalg.inv(now.matrix), dtype=np.float64)
        step = covariance @ now.right
        part = 1.0
        while True:
            moved = fit.stepped(now.equations, step, part)
            read = [moved.read(stretch) for stretch in moved.stretches]
            decrease = now.objective - moved.linearised(read).objective
            if decrease >= -1e-9 * now.objective or part < SMALLEST:
                break
            part /= 2
        size = float(np.max(np.abs(part * step) / np.sqrt(np.diag(covariance)), initial=0.0))
        intensity = moved.roughness(now.equations, covariance)
        changed = float(np.max(np.abs(np.log(intensity / fit.intensity)), initial=0.0))
        fit = replace(moved, intensity=intensity)
        now = fit.linearised(read)
        if (size < CONVERGED and decrease < 1.0 and changed < STEADY) or count == enough:
            final = np.asarray(np.linalg.inv(now.matrix), dtype=np.float64)
            return FittedPaths(fit, final, tuple(now.equations), count)
    raise SolverError(f"the fit of the motion did not converge in {STEPS} steps", where=where,
                      remedy="check units, axes and signs of the sensors, or leave a channel out")
