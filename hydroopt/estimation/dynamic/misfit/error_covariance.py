"""Covariance of residuals: sensor noise, and the errors of smoothed motion that the model turns into forces.

V = D + G·C·Gᵀ with D the noise of the readings, C the covariance of the smoothing splines' coefficients, and G the
derivative of the predicted readings by these. Smoothing passes slow errors of angles, whose second derivative is a
force: residuals of a sound log are correlated over as many samples as the smoothing averages.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hydroopt.estimation.motion.banded import Bordered, Rows
from hydroopt.estimation.motion.paths import Spline
from hydroopt.spatial.inertia import Array

KNOTS = 8.0
"""Knots per period of the highest frequency that smoothing passes."""
EVERY = slice(None)


@dataclass(frozen=True, eq=False)
class Whitened:
    """Columns (rows, k) over their noise, and what they say of the motion's errors, in coordinates of unit variance.

    `rows` are every one, or those of one reading where all others are zero and left out.
    """

    columns: Array
    seen: Array
    rows: slice

    def inner(self, other: Whitened) -> Array:
        """Xᵀ·V⁻¹·Y (k, l), of which one may be of one reading, or both of the same."""
        mine = self.columns[other.rows] if self.rows == EVERY else self.columns
        others = other.columns[self.rows] if other.rows == EVERY else other.columns
        return np.asarray(mine.T @ others - self.seen.T @ other.seen)


class ErrorCovariance:
    """V of the rows of one stretch; `whiten` gives what inner products need, in time linear in the samples (Woodbury).

    Args:
        t: (N,) times of a stretch [s].
        by_motion: (3, N, c, n) derivatives of c predicted readings by q, qd and qdd.
        taken: (N, c) readings that take part; the rows of all others are zero.
        noise: (c,) standard deviation of each reading.
        angle_noise: (n,) standard deviation of the measured positions.
        bandwidth: (n,) frequency [Hz] that smoothing passes by half.
    """

    def __init__(self, t: Array, by_motion: Array, taken: NDArray[np.bool_], noise: Array, angle_noise: Array,
                 bandwidth: Array) -> None:
        self.taken, self.noise = taken, noise
        N, n = len(t), by_motion.shape[3]
        knots = int(np.ceil(float(t[-1] - t[0]) * KNOTS * float(np.max(bandwidth))))
        path = Spline.over(t, min(knots, N), n)
        support = path.support(t)
        weight = np.array([10.0 ** path.basis.filter_of(float(each)).log_weight for each in bandwidth])
        by_angles = np.tile(np.diag(1 / angle_noise), (N, 1, 1))
        read, angles = (Rows.of_path(np.zeros(rows.shape[:2]), rows, 0, n * support.first) for rows in (
            self._over_noise(support.along(list(by_motion))), support.along([by_angles])))
        smooth = path.jerk(np.sqrt(weight * path.basis.spacing**5) / angle_noise, 0)
        self._equations = Bordered.of([smooth, angles, read], path.coefficients.size, path.width * n, 0)
        self._sensitivity = read.matrices(path.coefficients.size)[0]

    def whiten(self, columns: Array, reading: int | None = None) -> Whitened:
        """Columns (N, c, k) of all readings, or (N, k) of one alone."""
        if reading is None:
            rows, scaled = EVERY, self._over_noise(columns).reshape(-1, columns.shape[2])
        else:
            rows = slice(reading, None, len(self.noise))
            scaled = np.where(self.taken[:, reading, None], columns / self.noise[reading], 0.0)
        return Whitened(scaled, self._equations.half(self._sensitivity[rows].T @ scaled), rows)

    def _over_noise(self, values: Array) -> Array:
        return np.where(self.taken[:, :, None], values / self.noise[:, None], 0.0)
