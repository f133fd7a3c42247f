"""Quintic smoothing spline: least squares with a penalty on the third derivative, in O(N).

Minimises Σ (y_i − f(t_i))² + λ ∫ f'''(t)² dt over quintic splines on evenly spaced knots. The thesis's filter
(`two_weights`) penalises the first and second derivatives instead, so that it distorts speeds and accelerations below
its bandwidth. The spline leaves uniformly accelerated motion as it is, and its second derivative stays smooth. λ is
chosen by unbiased risk (Mallows' C_L) when the noise is known, by generalised cross-validation when it
is not; both sum over the pieces of a motion, so that the pieces of a long log have one λ and one grid of knots.

One smoothing passes H(f) = 1/(1 + (f/f₀)⁶), which damps frequencies well below f₀: 4.5 % at 0.6·f₀. Where a bandwidth
is stated, and not noise, what is left is smoothed again ("twicing", Tukey 1977): k smoothings pass 1 − (1 − H)ᵏ, half
at the same frequency, but all below it: `SHARP` = 4 of them damp 0.15 % at 0.6 times it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import comb, factorial
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.linalg import LinAlgError
from numpy.typing import NDArray
from scipy.interpolate import PPoly
from scipy.linalg import cho_solve_banded, cholesky_banded, lapack
from scipy.optimize import minimize_scalar
from scipy.sparse import csr_array

Array = NDArray[np.float64]
MIN_SAMPLES = 12
DECAY = 30.0
"""What lies beyond a piece's end is felt inside as e⁻³⁰ after this many e-foldings: not at all."""
PRECISION = 0.03
"""Of log10 λ where the estimated risk is least."""
SHARP = 4
"""Smoothings of a motion whose bandwidth is stated."""
_DEGREE, _PENALISED, _PROBES = 5, 3, 8
_FREQUENCIES = 4096
_LOWEST, _HIGHEST = -4.0, 8.0  # log10 λ in knot units; beyond the highest the knots are made wider
_ORDER = _DEGREE + 1
_POINTS, _WEIGHTS = np.polynomial.legendre.leggauss(3)

_POWERS: Array = np.array([
    [comb(_DEGREE, k) * sum((-1.0) ** (s - j) * comb(_ORDER, s - j) * (_DEGREE - s) ** (_DEGREE - k)
                            for s in range(j, _ORDER)) for j in range(_ORDER)]
    for k in range(_ORDER)]) / factorial(_DEGREE)
"""Coefficient of u^k in the j-th B-spline that lives in a knot interval, 0 ≤ u ≤ 1 (Qin 2000, Eq. 17)."""


@dataclass(frozen=True)
class Grid:
    """Knots at `origin` + k·`spacing` [s]: those of a motion of `steps` samples' steps over `duration` [s]."""

    origin: float
    duration: float
    steps: int
    every: float = 2.0

    @property
    def intervals(self) -> int:
        """Knot intervals over the duration: `every` so many steps, but three at least."""
        return max(3, int(np.ceil(self.steps / self.every)))

    @property
    def spacing(self) -> float:
        """From knot to knot [s]."""
        return self.duration / self.intervals

    @classmethod
    def of(cls, t: Array) -> "Grid":
        """The knots of an uninterrupted motion sampled at t (N,)."""
        return cls(float(t[0]), float(t[-1] - t[0]), t.size - 1)


@dataclass(frozen=True)
class Filter:
    """What smoothing passes: log10 λ in knot units, and how many times what is left is smoothed."""

    log_weight: float
    passes: int = 1


class Pieces:
    """The times (N,) of a motion's pieces on a grid of knots, and what the smoothing of all its joints shares."""

    def __init__(self, times: Sequence[Array], grid: Grid) -> None:
        self.times, self.grid = times, grid
        self._freedom: dict[float, float] = {}

    @cached_property
    def bases(self) -> "list[Basis]":
        """The splines of every piece."""
        return [Basis(t, self.grid) for t in self.times]

    @cached_property
    def coarser(self) -> "Pieces":
        """The same with wider knots."""
        return Pieces(self.times, replace(self.grid, every=6.0 * self.grid.every))

    def choose(self, values: Sequence[Array], noise: float | None,
               bandwidth: float | None = None) -> "tuple[list[Basis], Filter]":
        """The splines of every piece, and the one filter that suits samples (N,) of all pieces best; arguments as of
        `fit`.
        """
        chosen = Filter(self._best(values, noise))
        if bandwidth is not None and min(basis.bandwidth(chosen) for basis in self.bases) > bandwidth:
            chosen = min((basis.filter_of(bandwidth, SHARP) for basis in self.bases), key=lambda one: one.log_weight)
        if chosen.log_weight < _HIGHEST - 0.5 or min(basis.intervals for basis in self.bases) <= 3:
            return self.bases, chosen
        return self.coarser.choose(values, noise, bandwidth)

    @cached_property
    def _probes(self) -> list[Array]:
        """Right-hand sides of Hutchinson's estimator of traces, with fixed signs, others for each piece."""
        rng = np.random.default_rng(0)
        return [basis.design.T @ rng.choice([-1.0, 1.0], (t.size, _PROBES))
                for basis, t in zip(self.bases, self.times, strict=True)]

    def _best(self, values: Sequence[Array], noise: float | None) -> float:
        """log10 λ of least estimated risk."""
        n = sum(y.size for y in values)
        own = [basis.design.T @ y for basis, y in zip(self.bases, values, strict=True)]

        def risk(log_weight: float) -> float:
            known, rss, freedom = log_weight in self._freedom, 0.0, 0.0
            for basis, y, right, probes in zip(self.bases, values, own, self._probes, strict=True):
                try:
                    factor = basis.factor(Filter(log_weight))
                except LinAlgError:
                    return np.inf
                rss += float(np.sum((y - basis.design @ cho_solve_banded((factor, True), right)) ** 2))
                freedom += 0.0 if known else float(np.sum(lapack.dtbtrs(factor, probes, uplo="L")[0] ** 2)) / _PROBES
            freedom = self._freedom.setdefault(log_weight, freedom)
            if noise is not None:
                return rss / n + 2 * noise**2 * freedom / n
            return float(np.log(max(rss / n, 1e-300)) - 2 * np.log(max(1 - freedom / n, 1e-9)))

        exponents = np.linspace(_LOWEST, _HIGHEST, 9).tolist()
        lowest = int(np.argmin([risk(g) for g in exponents]))
        around = (exponents[max(lowest - 1, 0)], exponents[min(lowest + 1, len(exponents) - 1)])
        with np.errstate(invalid="ignore"):  # between two infinite risks
            return float(minimize_scalar(risk, bounds=around, method="bounded", options={"xatol": PRECISION}).x)


def fit(t: Array, y: Array, noise: float | None, bandwidth: float | None = None) -> "tuple[Basis, Filter]":
    """Splines and filter of the smoothing of `y` (N,) at increasing times `t` (N,) [s], N >= MIN_SAMPLES.

    `noise` is the standard deviation of y's noise in y's unit; None asks for generalised cross-validation. Of a motion
    known to end at a `bandwidth` [Hz], no more is passed than half of that frequency.
    """
    bases, chosen = Pieces([t], Grid.of(t)).choose([y], noise, bandwidth)
    return bases[0], chosen


class Basis:
    """Quintic B-splines on those knots of a grid that lie around t; the knot spacing is the unit of time."""

    def __init__(self, t: Array, grid: Grid) -> None:
        self.grid, self.spacing = grid, grid.spacing
        first, last = ((float(t[k]) - grid.origin) / self.spacing for k in (0, -1))
        first = np.floor(first + 1e-6)  # a knot that a sample stands on up to rounding is the first, or the last
        self.start, self.intervals = grid.origin + first * self.spacing, max(1, int(np.ceil(last - first - 1e-6)))
        self.x = self.places(t)
        self.first = self.cells(self.x)
        self.design = self.derivative(0)

    def places(self, t: Array) -> Array:
        """Times [s] in knot units from the first knot, none beyond the ends."""
        return np.asarray(np.clip((t - self.start) / self.spacing, 0.0, float(self.intervals)))

    def cells(self, x: Array) -> NDArray[np.int32]:
        """The knot intervals (N,) that places are in, and so the first of the six splines that are not zero there."""
        return np.minimum(x.astype(np.int32), np.int32(self.intervals - 1))

    def values(self, x: Array, order: int) -> Array:
        """Derivatives (N, 6) of the splines that are not zero at places x (N,), in knot units."""
        return np.vander(x - self.cells(x), _ORDER - order, increasing=True) @ _derived(order)

    def derivative(self, order: int) -> csr_array:
        """Derivatives (N, m) of all splines at the samples, in knot units."""
        return windowed(self.values(self.x, order), self.first, self.intervals + _DEGREE)

    def curve(self, coefficients: Array) -> PPoly:
        """The curves (...) over places, in knot units, of coefficients (m, ...)."""
        around = sliding_window_view(coefficients, _ORDER, axis=0)
        return PPoly(np.tensordot(_POWERS[::-1], around, (1, -1)), np.arange(self.intervals + 1.0))

    @cached_property
    def gram(self) -> Array:
        """Sums of B_i·B_j over the samples, in band storage."""
        product = self.design.T @ self.design
        return np.array([np.pad(product.diagonal(-below), (0, below)) for below in range(_ORDER)])

    @cached_property
    def penalty(self) -> Array:
        """∫ B'''_i B'''_j dx in band storage: of each knot interval the same."""
        cell = self.jerk[0][: len(_POINTS)]
        band = np.zeros((_ORDER, self.intervals + _DEGREE))
        for j in range(_ORDER):
            for below in range(_ORDER - j):
                band[below, j : j + self.intervals] += cell[:, j] @ cell[:, j + below]
        return band

    @cached_property
    def jerk(self) -> tuple[Array, NDArray[np.intp]]:
        """Rows (3·intervals, 6) with ``Σ (rows·c)² = ∫ f'''² dx``, exactly, and the splines that they begin at."""
        x = (np.arange(self.intervals)[:, None] + (1 + _POINTS) / 2).ravel()
        first = np.repeat(np.arange(self.intervals), len(_POINTS))
        return self.values(x, _PENALISED) * np.sqrt(np.tile(_WEIGHTS / 2, self.intervals))[:, None], first

    def filter_of(self, bandwidth: float, passes: int = 1) -> Filter:
        """The filter of so many smoothings that passes the frequency `bandwidth` [Hz] by half."""
        once = 2 * np.pi * self.spacing * bandwidth / wider(passes)
        return Filter(float(np.log10(self.x.size / self.intervals) - 6 * np.log10(once)), passes)

    def bandwidth(self, chosen: Filter) -> float:
        """The frequency [Hz] passed by half."""
        once = (self.x.size / self.intervals / 10.0**chosen.log_weight) ** (1 / 6) / (2 * np.pi * self.spacing)
        return float(wider(chosen.passes) * once)

    def smoothed(self, y: Array, chosen: Filter) -> Array:
        """What a filter makes of samples y (N, ...), with its first two derivatives (3, N, ...)."""
        return self.courses(self.solve(chosen, self.design.T @ y))

    def pull_back(self, rows: Sequence[Array], chosen: Filter) -> Array:
        """Derivatives (m, N) of Σ_d rows[d] @ f^(d) by the samples that f smooths, for rows (m, N)."""
        pulled = sum(self.derivative(order).T @ row.T / self.spacing**order for order, row in enumerate(rows))
        return np.asarray(self.design @ self.solve(chosen, np.asarray(pulled))).T

    def courses(self, coefficients: Array) -> Array:
        """Values and first two derivatives (3, N, k) [unit of y / s^derivative] at the samples, of coefficients (m, k).
        """
        curve = self.curve(coefficients)
        made = np.empty((3, len(self.x), *coefficients.shape[1:]))
        for order, each in enumerate(made):
            np.divide(curve(self.x, order), self.spacing**order, out=each)
        return made

    def factor(self, chosen: Filter) -> Array:
        """Cholesky factor of the penalised normal equations, in band storage.

        Raises:
            LinAlgError: rounding errors make their matrix singular.
        """
        return cholesky_banded(self.gram + 10.0**chosen.log_weight * self.penalty, lower=True)

    def solve(self, chosen: Filter, right: Array) -> Array:
        """Coefficients of the penalised normal equations, then of those of what each smoothing leaves."""
        factor = self.factor(chosen)
        coefficients = cho_solve_banded((factor, True), right)
        for _ in range(chosen.passes - 1):
            left = right - self.design.T @ (self.design @ coefficients)
            coefficients = coefficients + cho_solve_banded((factor, True), left)
        return coefficients


def windowed(values: Array, first: NDArray[Any], columns: int) -> csr_array:
    """The matrix (N, m) whose row i holds `values` (N, w) from the column `first` (N,) on.

    >>> windowed(np.array([[1.0, 2.0], [3.0, 4.0]]), np.array([0, 1]), 3).toarray().tolist()
    [[1.0, 2.0, 0.0], [0.0, 3.0, 4.0]]
    """
    rows, width = values.shape
    at = np.add.outer(first, np.arange(width, dtype=first.dtype))
    return csr_array((values.ravel(), at.ravel(), np.arange(0, rows * width + 1, width)), shape=(rows, columns))


def wider(passes: int) -> float:
    """The frequency that `passes` smoothings pass by half, over that of one: 1 − (1 − H)ᵏ = ½."""
    left = 0.5 ** (1 / passes)
    return float((left / (1 - left)) ** (1 / 6))


def passed_noise(bandwidth: float, passes: int, step: float) -> Array:
    """Covariance (3, 3) of a smoothed course and its first two derivatives, of white noise of variance 1.

    Far from the ends; by the frequencies that the filter passes.

    Args:
        bandwidth: the frequency [Hz] passed by half.
        passes: number of smoothings.
        step: [s] between samples.
    """
    f = (np.arange(_FREQUENCIES) + 0.5) / (2 * step * _FREQUENCIES)
    gain = 1 - (1 - 1 / (1 + (f * wider(passes) / bandwidth) ** 6)) ** passes
    still, speed, acceleration = (float(np.mean((gain * (2 * np.pi * f) ** order) ** 2)) for order in range(3))
    return np.array([[still, 0, -speed], [0, speed, 0], [-speed, 0, acceleration]])


def _derived(order: int) -> Array:
    """As `_POWERS`, of a derivative."""
    matrix = _POWERS
    for _ in range(order):
        matrix = matrix[1:] * np.arange(1, len(matrix))[:, None]
    return matrix
