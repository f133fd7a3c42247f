"""Quintic smoothing spline: least squares with a penalty on the third derivative, in O(N).

Minimises Σ (y_i − f(t_i))² + λ ∫ f'''(t)² dt over quintic splines on evenly spaced knots. It is the
continuous form of the dynamic-programming filter of Dohrmann and Busby (penalised derivatives), and
beats a cubic smoothing spline where accelerations matter: its second derivative stays smooth. λ is
chosen by unbiased risk (Mallows' C_L) when the noise is known, by generalised cross-validation when it
is not.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.linalg import LinAlgError, cho_solve_banded, cholesky_banded
from scipy.optimize import minimize_scalar

Array = NDArray[np.float64]
MIN_SAMPLES = 12
_DEGREE, _PENALISED, _PROBES = 5, 3, 8
_LOWEST, _HIGHEST = -4.0, 8.0  # log10 λ in knot units; beyond the highest the knots are made wider


@dataclass(frozen=True)
class SmoothSpline:
    """A fitted curve: `curve` (time in s from `start`), its λ [s⁵], bandwidth [Hz], residual std and the splines."""

    curve: BSpline
    start: float
    weight: float
    bandwidth: float
    residual: float
    basis: "_Basis"

    def __call__(self, t: Array, derivative: int = 0) -> Array:
        """Value or derivative (unit of y / s^derivative) at the times `t` (N,) [s]."""
        return np.asarray(self.curve(t - self.start, derivative))

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
    n, every = t.size, 2.0
    while True:
        basis = _Basis(t, max(3, int(np.ceil((n - 1) / every))))
        log_weight = basis.best(y, noise)
        if bandwidth is not None:
            log_weight = max(log_weight, basis.log_weight_of(bandwidth))
        if log_weight < _HIGHEST - 0.5 or basis.intervals == 3:
            return basis.spline(y, log_weight)
        every *= 6.0


class _Basis:
    """Quintic B-splines on `intervals` even knot intervals over `t`; the knot spacing is the unit of time."""

    def __init__(self, t: Array, intervals: int) -> None:
        self.start, self.intervals = float(t[0]), intervals
        self.spacing = float(t[-1] - t[0]) / intervals
        self.x = np.clip((t - t[0]) / self.spacing, 0.0, float(intervals))
        self.knots = np.concatenate(
            [np.zeros(_DEGREE), np.arange(intervals + 1.0), np.full(_DEGREE, float(intervals))])
        self.design: Any = BSpline.design_matrix(self.x, self.knots, _DEGREE).tocsr()
        self.gram = _band(self.design.T @ self.design)
        self.penalty = _band(self._penalty())
        self.probes = np.random.default_rng(0).choice([-1.0, 1.0], (t.size, _PROBES))
        self.projected = self.design.T @ self.probes

    def best(self, y: Array, noise: float | None) -> float:
        """log10 λ of least estimated risk; traces by Hutchinson's estimator with fixed probes."""
        n, right = y.size, np.column_stack([self.design.T @ y, self.projected])

        def risk(log_weight: float) -> float:
            try:
                c = self.solve(10.0**log_weight, right)
            except LinAlgError:
                return np.inf
            rss = float(np.sum((y - self.design @ c[:, 0]) ** 2))
            freedom = float(np.sum(self.projected * c[:, 1:])) / _PROBES
            if noise is not None:
                return rss / n + 2 * noise**2 * freedom / n
            return float(np.log(max(rss / n, 1e-300)) - 2 * np.log(max(1 - freedom / n, 1e-9)))

        grid = np.linspace(_LOWEST, _HIGHEST, 9)
        lowest = int(np.argmin([risk(g) for g in grid]))
        around = (grid[max(lowest - 1, 0)], grid[min(lowest + 1, grid.size - 1)])
        return float(minimize_scalar(risk, bounds=around, method="bounded", options={"xatol": 0.03}).x)

    def log_weight_of(self, bandwidth: float) -> float:
        """log10 λ that passes the frequency `bandwidth` [Hz] by half."""
        return float(np.log10(self.x.size / self.intervals) - 6 * np.log10(2 * np.pi * self.spacing * bandwidth))

    def spline(self, y: Array, log_weight: float) -> SmoothSpline:
        weight = 10.0**log_weight
        coefficients = self.solve(weight, self.design.T @ y)
        density = self.x.size / self.intervals
        return SmoothSpline(
            curve=BSpline(self.knots * self.spacing, coefficients, _DEGREE), start=self.start,
            weight=weight * self.spacing**5,
            bandwidth=float((density / weight) ** (1 / 6) / (2 * np.pi * self.spacing)),
            residual=float(np.sqrt(np.mean((y - self.design @ coefficients) ** 2))), basis=self)

    def solve(self, weight: float, right: Array) -> Array:
        """Coefficients of the penalised normal equations, λ in knot units."""
        factor = cholesky_banded(self.gram + weight * self.penalty, lower=True)
        return np.asarray(cho_solve_banded((factor, True), right))

    def derivative(self, x: Array, order: int) -> Any:
        """Values (N, m) of the splines' derivatives at x (N,), in knot units."""
        knots, degree, size = self.knots, _DEGREE, self.knots.size - _DEGREE - 1
        to_derivative = sp.eye_array(size, format="csr")
        for _ in range(order):
            rise = degree / (knots[degree + 1:-1] - knots[1:-degree - 1])
            difference = sp.diags_array([-rise, rise], offsets=[0, 1], shape=(rise.size, rise.size + 1))
            to_derivative = difference.tocsr() @ to_derivative
            knots, degree = knots[1:-1], degree - 1
        return BSpline.design_matrix(x, knots, degree) @ to_derivative

    def _penalty(self) -> sp.csr_array:
        """∫ B'''_i B'''_j dx, exact: three Gauss points integrate the product of two parabolas."""
        points, weights = np.polynomial.legendre.leggauss(3)
        x = (np.arange(self.intervals)[:, None] + 0.5 + 0.5 * points).ravel()
        third = self.derivative(x, _PENALISED)
        return sp.csr_array(third.T @ sp.diags_array(np.tile(weights / 2, self.intervals)) @ third)


def _band(matrix: Any) -> Array:
    """Lower band storage (`scipy.linalg.cholesky_banded`) of a symmetric matrix of half bandwidth _DEGREE."""
    n = matrix.shape[0]
    band = np.zeros((_DEGREE + 1, n))
    for offset in range(_DEGREE + 1):
        band[offset, : n - offset] = matrix.diagonal(-offset)
    return band
