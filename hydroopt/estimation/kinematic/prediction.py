"""Held-out poses against the error that is stated for their prediction: noise, geometry, and what is fitted to them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import special

from hydroopt.estimation.inference.identifiability import INFORMATION_TOLERANCE, significant
from hydroopt.estimation.kinematic.observability import linearise
from hydroopt.estimation.kinematic.residuals import predicted
from hydroopt.estimation.kinematic.solution import KinematicSolution
from hydroopt.logs.poses import Poses
from hydroopt.spatial.inertia import Array

NORMAL_95 = 1.959964
"""Standard deviations on each side of a 95 % interval."""
LEAST = 1e-6
"""Part of a row's variance below which a fit to the poses themselves has taken it all."""


class PredictionTest(NamedTuple):
    """How held-out poses agree with the error that is stated for their prediction.

    Attributes:
        standardised: (k,) whitened residuals, each in standard deviations of its prediction.
        ratio: size of all of them together, correlations included, relative to what is expected.
        chance: probability of this ratio or a larger one if the stated errors hold, with the noise as uncertain as the
            training poses leave it.
    """

    standardised: Array
    ratio: float
    chance: float

    @property
    def inside(self) -> NDArray[np.bool_]:
        """Which of the residuals (k,) lie within their 95 % intervals."""
        return np.abs(self.standardised) < NORMAL_95

    @property
    def coverage(self) -> float:
        """Part of the residuals that lie within their 95 % intervals."""
        return float(np.mean(self.inside)) if self.standardised.size else float("nan")


def prediction_test(solution: KinematicSolution, poses: Poses) -> PredictionTest:
    """Test the stated error of a calibrated geometry with held-out poses.

    The noise is that of the training poses, smaller or larger than stated; the geometry is as uncertain as this noise
    and the priors leave it. What held-out poses tell alone, such as where a fixture stood, is fitted to them, as is
    what neither training poses nor priors determine: their share of noise and of wrong geometry is taken out.

    Args:
        solution: the calibration.
        poses: that took no part in it.

    Raises:
        ProblemError: the poses do not fit the machine.
    """
    fresh, theta, q = predicted(solution.problem, solution.theta, poses)
    rows, known = linearise(fresh, theta, q), solution.observability
    measured = np.isfinite(solution.noise_scale)
    noise = solution.noise_scale**2 if measured else 1.0
    information = known.information / noise + known.prior
    size = np.sqrt(np.maximum(np.diag(information), 1e-300))
    values, vectors = np.linalg.eigh(information / np.outer(size, size))
    vectors, determined = vectors / size[:, None], significant(values, INFORMATION_TOLERANCE)
    shared = [k for k, name in enumerate(fresh.parameters.names) if name in known.names and not fresh.free[k]]
    order = [known.names.index(fresh.parameters.names[k]) for k in shared]
    free, count = np.flatnonzero(fresh.free), rows.residual.size
    slope = rows.jacobian[:, :, shared].reshape(count, -1) @ vectors[order]
    fitted = np.column_stack([
        np.vstack([rows.jacobian[:, :, free].reshape(count, len(free)), rows.shared[:, free]])
        * fresh.parameters.scale[free],
        np.vstack([slope[:, ~determined], np.zeros((len(rows.shared), int(np.sum(~determined))))])])
    left, s, _ = np.linalg.svd(fitted, full_matrices=False)
    left = left[:count, s > 1e-9 * s[0]] if s.size else np.zeros((count, 0))
    by_geometry = slope[:, determined] / np.sqrt(values[determined])
    by_geometry -= left @ (left.T @ by_geometry)
    residual = rows.residual.ravel() - left @ (left.T @ rows.residual.ravel())
    variance = noise * (rows.kept.ravel() - np.sum(left**2, axis=1)) + np.sum(by_geometry**2, axis=1)
    there = variance > LEAST * noise
    turned = by_geometry.T @ residual
    explained = turned @ np.linalg.solve(by_geometry.T @ by_geometry + noise * np.eye(len(turned)), turned)
    square = max(float(residual @ residual - explained), 0.0) / noise
    standardised, freedom = residual[there] / np.sqrt(variance[there]), int(rows.rank.sum()) - left.shape[1]
    if freedom <= 0:
        return PredictionTest(standardised, float("nan"), 1.0)
    trained = int(solution.linearised.rank.sum()) - known.rank
    chance = (special.fdtrc(freedom, trained, square / freedom) if measured and trained > 0
              else special.chdtrc(freedom, square))
    return PredictionTest(standardised, float(np.sqrt(square / freedom)), float(chance))
