"""Quintic smoothing spline: least squares with a penalty on the third derivative, in O(N).

Minimises Σ (y_i − f(t_i))² + λ ∫ f'''(t)² dt over quintic splines on evenly spaced knots. It is the
continuous form of the dynamic-programming filter of Dohrmann and Busby (penalised derivatives), and
beats a cubic smoothing spline where accelerations matter: its second derivative stays smooth. λ is
chosen by unbiased risk (Mallows' C_L) when the noise is known, by generalised cross-validation when it
is not; both sum over the pieces of a motion, so that the pieces of a long log have one λ and one grid of knots.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import comb, factorial
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cho_solve_banded, cholesky_banded
from scipy.optimize import minimize_scalar

Array = NDArray[np.float64]
MIN_SAMPLES = 12
DECAY = 30.0
"""What lies beyond a piece's end is felt inside as e⁻³⁰ after this many e-foldings: not at all."""
_DEGREE, _PENALISED, _PROBES = 5, 3, 8
_LOWEST, _HIGHEST = -4.0, 8.0  # log10 λ in knot units; beyond the highest the knots are made wider
_ORDER = _DEGREE + 1

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
class SmoothSpline:
    """A fitted curve: its coefficients, λ [s⁵], bandwidth [Hz], residual std, and the splines it is made of."""

    coefficients: Array
    weight: float
    bandwidth: float
    residual: float
    basis: "Basis"

    def __call__(self, t: Array, derivative: int = 0) -> Array:
        """Value or derivative (unit of y / s^derivative) at the times `t` (N,) [s]."""
        rows = self.basis.derivative(self.basis.places(t), derivative)
        return np.asarray(rows @ self.coefficients) / self.basis.spacing**derivative

    def again(self, y: Array) -> "SmoothSpline":
        """The same smoothing of other samples (N,) at the same times."""
        return self.basis.spline(y, float(np.log10(self.weight / self.basis.spacing**5)))

    def pull_back(self, rows: Sequence[Array]) -> Array:
        """Derivatives (m, N) of Σ_d rows[d] @ f^(d)(t) by the samples y, for rows (m, N) at the samples' own times."""
        basis = self.basis
        pulled = sum((row @ basis.derivative(basis.x, order)) / basis.spacing**order for order, row in enumerate(rows))
        return np.asarray(basis.design @ basis.solve(self.weight / basis.spacing**5, np.asarray(pulled).T)).T


def fit(t: Array, y: Array, noise: float | None, bandwidth: float | None = None) -> SmoothSpline:
    """Smoothing spline through `y` (N,) at increasing times `t` (N,) [s], N >= MIN_SAMPLES.

    `noise` is the standard deviation of y's noise in y's unit; None asks for generalised cross-validation. Of a motion
    known to end at a `bandwidth` [Hz], no more is passed than half of that frequency.
    """
    bases, log_weight = choose([(t, y)], Grid.of(t), noise, bandwidth)
    return bases[0].spline(y, log_weight)


def choose(pieces: Sequence[tuple[Array, Array]], grid: Grid, noise: float | None,
           bandwidth: float | None = None) -> tuple[list["Basis"], float]:
    """The splines of every piece (t, y) of a motion, and the one log10 λ, in knot units, that suits all pieces best."""
    while True:
        bases = [Basis(t, grid) for t, _ in pieces]
        log_weight = _best(bases, [y for _, y in pieces], noise)
        if bandwidth is not None:
            log_weight = max(log_weight, min(basis.log_weight_of(bandwidth) for basis in bases))
        if log_weight < _HIGHEST - 0.5 or min(basis.intervals for basis in bases) <= 3:
            return bases, log_weight
        grid = Grid(grid.origin, grid.duration, grid.steps, 6.0 * grid.every)


def _best(bases: Sequence["Basis"], values: Sequence[Array], noise: float | None) -> float:
    """log10 λ of least estimated risk; traces by Hutchinson's estimator with fixed probes, others for each piece."""
    n, rng = sum(y.size for y in values), np.random.default_rng(0)
    rights = [basis.design.T @ np.column_stack([y, rng.choice([-1.0, 1.0], (y.size, _PROBES))])
              for basis, y in zip(bases, values, strict=True)]

    def risk(log_weight: float) -> float:
        rss = freedom = 0.0
        for basis, y, right in zip(bases, values, rights, strict=True):
            try:
                c = basis.solve(10.0**log_weight, right)
            except LinAlgError:
                return np.inf
            rss += float(np.sum((y - basis.design @ c[:, 0]) ** 2))
            freedom += float(np.sum(right[:, 1:] * c[:, 1:])) / _PROBES
        if noise is not None:
            return rss / n + 2 * noise**2 * freedom / n
        return float(np.log(max(rss / n, 1e-300)) - 2 * np.log(max(1 - freedom / n, 1e-9)))

    exponents = np.linspace(_LOWEST, _HIGHEST, 9)
    lowest = int(np.argmin([risk(g) for g in exponents]))
    around = (exponents[max(lowest - 1, 0)], exponents[min(lowest + 1, exponents.size - 1)])
    return float(minimize_scalar(risk, bounds=around, method="bounded", options={"xatol": 0.03}).x)


class Basis:
    """Quintic B-splines on those knots of a grid that lie around t; the knot spacing is the unit of time."""

    def __init__(self, t: Array, grid: Grid) -> None:
        self.grid, self.spacing = grid, grid.spacing
        first, last = ((float(t[k]) - grid.origin) / self.spacing for k in (0, -1))
        first = np.floor(first + 1e-6)  # a knot that a sample stands on up to rounding is the first, or the last
        self.start, self.intervals = grid.origin + first * self.spacing, max(1, int(np.ceil(last - first - 1e-6)))
        self.x = self.places(t)
        self.design: Any = self.derivative(self.x, 0)
        self.gram = _band(self.design.T @ self.design)

    def places(self, t: Array) -> Array:
        """Times [s] in knot units from the first knot, none beyond the ends."""
        return np.asarray(np.clip((t - self.start) / self.spacing, 0.0, float(self.intervals)))

    def derivative(self, x: Array, order: int) -> Any:
        """Values (N, m) of the splines' derivatives at x (N,), in knot units."""
        cell = np.minimum(x.astype(np.int32), np.int32(self.intervals - 1))
        powers = np.vander(x - cell, _ORDER - order, increasing=True)
        values = powers @ _derived(order)
        columns = cell[:, None] + np.arange(_ORDER, dtype=np.int32)
        ends = np.arange(0, values.size + 1, _ORDER, dtype=np.int32)
        return sp.csr_array((values.ravel(), columns.ravel(), ends), shape=(x.size, self.intervals + _DEGREE))

    @cached_property
    def penalty(self) -> Array:
        """∫ B'''_i B'''_j dx, exact, in band storage."""
        third = _derived(_PENALISED)
        exponent = np.arange(len(third))
        cell = third.T @ (1 / (exponent[:, None] + exponent + 1)) @ third
        band = np.zeros((_DEGREE + 1, self.intervals + _DEGREE))
        for offset in range(_DEGREE + 1):
            for j in range(_ORDER - offset):
                band[offset, j : j + self.intervals] += cell[j, j + offset]
        return band

    def log_weight_of(self, bandwidth: float) -> float:
        """log10 λ that passes the frequency `bandwidth` [Hz] by half."""
        return float(np.log10(self.x.size / self.intervals) - 6 * np.log10(2 * np.pi * self.spacing * bandwidth))

    def bandwidth(self, log_weight: float) -> float:
        """The frequency [Hz] passed by half."""
        return float((self.x.size / self.intervals / 10.0**log_weight) ** (1 / 6) / (2 * np.pi * self.spacing))

    def spline(self, y: Array, log_weight: float) -> SmoothSpline:
        """The smoothing of samples y (N,) at the basis's times with a given log10 λ in knot units."""
        coefficients = self.solve(10.0**log_weight, self.design.T @ y)
        return SmoothSpline(coefficients, 10.0**log_weight * self.spacing**5, self.bandwidth(log_weight),
                            float(np.sqrt(np.mean((y - self.design @ coefficients) ** 2))), self)

    def solve(self, weight: float, right: Array) -> Array:
        """Coefficients of the penalised normal equations, λ in knot units."""
        factor = cholesky_banded(self.gram + weight * self.penalty, lower=True)
        return np.asarray(cho_solve_banded((factor, True), right))


def _derived(order: int) -> Array:
    """As `_POWERS`, of a derivative."""
    matrix = _POWERS
    for _ in range(order):
        matrix = matrix[1:] * np.arange(1, len(matrix))[:, None]
    return matrix


def _band(matrix: Any) -> Array:
    """Lower band storage (`scipy.linalg.cholesky_banded`) of a symmetric matrix of half bandwidth _DEGREE."""
    n = matrix.shape[0]
    band = np.zeros((_DEGREE + 1, n))
    for offset in range(_DEGREE + 1):
        band[offset, : n - offset] = matrix.diagonal(-offset)
    return band
