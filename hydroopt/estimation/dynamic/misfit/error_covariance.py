"""Covariance of residuals: sensor noise, and the errors of smoothed motion that the model turns into forces.

V = D + G·C·Gᵀ with D the noise of the readings, C the covariance of the smoothing splines' coefficients, and G the
derivative of the predicted readings by these. Smoothing passes slow errors of angles, whose second derivative is a
force: residuals of a sound log are correlated over as many samples as the smoothing averages.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky_banded, lapack
from scipy.sparse import csr_array

from hydroopt.logs.spline import Basis, Grid, windowed
from hydroopt.spatial.inertia import Array

KNOTS = 8.0
"""Knots per period of the highest frequency that smoothing passes."""
SUPPORT = 6
"""Splines that are not zero at a time."""


@dataclass(frozen=True, eq=False)
class Whitened:
    """Columns (rows, c) over their noise, and what they say of the motion's errors, in coordinates of unit variance.

    `rows` are those of one reading where all others are zero and left out.
    """

    columns: Array
    seen: Array
    rows: NDArray[np.intp] | None = None

    def inner(self, other: Whitened) -> Array:
        """Xᵀ·V⁻¹·Y (c, d), of which one may be of one reading, or both of the same."""
        mine, others = self.columns, other.columns
        if self.rows is None and other.rows is not None:
            mine = mine[other.rows]
        elif self.rows is not None and other.rows is None:
            others = others[self.rows]
        return np.asarray(mine.T @ others - self.seen.T @ other.seen)


class ErrorCovariance:
    """V of the rows of one stretch; `whiten` gives what inner products need, in time linear in the samples (Woodbury).

    Args:
        t: (N,) times of a stretch [s].
        by_motion: (3, N, c, n) derivatives of c predicted readings by q, qd and qdd.
        taken: (N, c) readings that take part; the rows are these, sample by sample.
        noise: (c,) standard deviation of each reading.
        angle_noise: (n,) standard deviation of the measured positions.
        bandwidth: (n,) frequency [Hz] that smoothing passes by half.
    """

    def __init__(self, t: Array, by_motion: Array, taken: NDArray[np.bool_], noise: Array, angle_noise: Array,
                 bandwidth: Array) -> None:
        self.taken = taken
        self.size = np.broadcast_to(noise, taken.shape)[taken]
        n = by_motion.shape[3]
        duration = float(t[-1] - t[0])
        knots = max(3, int(np.ceil(duration * KNOTS * float(np.max(bandwidth)))))
        basis = Basis(t, Grid(float(t[0]), duration, min(knots, t.size), 1.0))
        self._sensitivity = self._rows(basis, by_motion)
        self._factor = self._factored(basis, np.broadcast_to(angle_noise, n), bandwidth)

    def whiten(self, columns: Array, reading: int | None = None) -> Whitened:
        """Columns (rows, c), readings (N, c', k) of which the rows are taken, or (N, k) of one reading alone."""
        if reading is not None:
            rows = np.flatnonzero(np.nonzero(self.taken)[1] == reading)
            scaled = columns[self.taken[:, reading]] / self.size[rows, None]
            return Whitened(scaled, self._seen(self._sensitivity[rows], scaled), rows)
        chosen = columns[self.taken] if columns.ndim == 3 else columns
        scaled = chosen / self.size[:, None]
        return Whitened(scaled, self._seen(self._sensitivity, scaled))

    def _seen(self, sensitivity: csr_array, scaled: Array) -> Array:
        """What columns (rows, c) over their noise say of the motion's errors, in coordinates of unit variance."""
        return np.asarray(lapack.dtbtrs(self._factor, sensitivity.T @ scaled, uplo="L")[0])

    def _rows(self, basis: Basis, by_motion: Array) -> csr_array:
        """G over the noise (rows, coefficients), the coefficients of all joints at one knot next to each other."""
        N, c, n = by_motion.shape[1:]
        values = np.zeros((N, c, SUPPORT, n))
        for order in range(3):
            splines = basis.values(basis.x, order) / basis.spacing**order
            values += by_motion[order][:, :, None, :] * splines[:, None, :, None]
        data = values[self.taken].reshape(self.size.size, n * SUPPORT) / self.size[:, None]
        first = np.broadcast_to(n * basis.first[:, None], (N, c))[self.taken]
        return windowed(data, first, n * (basis.intervals + SUPPORT - 1))

    def _factored(self, basis: Basis, noise: Array, bandwidth: Array) -> Array:
        """Cholesky factor, in band storage, of C⁻¹ + Gᵀ·D⁻¹·G."""
        n, half = len(noise), SUPPORT - 1
        size = basis.intervals + SUPPORT - 1
        inverse = np.stack([(basis.gram + 10.0 ** basis.filter_of(float(bandwidth[j])).log_weight * basis.penalty)
                            / noise[j] ** 2 for j in range(n)], axis=2)  # (half + 1, size, n)
        band = np.zeros((n * SUPPORT, n * size))
        band[: n * half + 1 : n] = inverse.reshape(half + 1, n * size)
        product = self._sensitivity.T @ self._sensitivity
        for below, row in enumerate(band):
            row[: n * size - below] += product.diagonal(-below)
        return cholesky_banded(band, lower=True)
