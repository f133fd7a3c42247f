"""Held-out poses against the error that is stated for their prediction: noise, geometry, and what is fitted to them."""

from __future__ import annotations

import numpy as np

from hydroopt.estimation.kinematic.observability import linearise
from hydroopt.estimation.kinematic.residuals import predicted
from hydroopt.estimation.kinematic.solution import KinematicSolution
from hydroopt.logs.poses import Poses
from hydroopt.spatial.inertia import Array

NORMAL_95 = 1.959964
"""Standard deviations on each side of a 95 % interval."""


def standardised(solution: KinematicSolution, poses: Poses) -> Array:
    """Whitened residuals (k,) of held-out poses, in standard deviations of their prediction.

    The noise is that of the training poses, smaller or larger than stated; the geometry is as uncertain as this noise
    and the priors leave it. What held-out poses tell alone, such as where a fixture stood, is fitted to them: its share
    of noise and of wrong geometry is taken out.

    Args:
        solution: the calibration.
        poses: that took no part in it.

    Raises:
        ProblemError: the poses do not fit the machine.
    """
    fresh, theta, q = predicted(solution.problem, solution.theta, poses)
    rows, known = linearise(fresh, theta, q), solution.observability
    shared = [k for k, name in enumerate(fresh.parameters.names) if name in known.names and not fresh.free[k]]
    free, count = np.flatnonzero(fresh.free), rows.residual.size
    own = np.vstack([rows.jacobian[:, :, free].reshape(count, len(free)), rows.shared[:, free]])
    left, s, _ = np.linalg.svd(own * fresh.parameters.scale[free], full_matrices=False)
    left = left[:count, s > 1e-9 * s[0]] if s.size else np.zeros((count, 0))
    slope = rows.jacobian[:, :, shared].reshape(count, -1)
    slope = slope - left @ (left.T @ slope)
    noise = solution.noise_scale**2 if np.isfinite(solution.noise_scale) else 1.0
    information = known.information / noise + known.prior
    size = np.sqrt(np.maximum(np.diag(information), 1e-300))
    inverse = np.linalg.pinv(information / np.outer(size, size), rcond=1e-12, hermitian=True) / np.outer(size, size)
    order = [known.names.index(fresh.parameters.names[k]) for k in shared]
    variance = noise * (1 - np.sum(left**2, axis=1)) + np.einsum(
        "rk,kl,rl->r", slope, inverse[np.ix_(order, order)], slope, optimize=True)
    residual = rows.residual.ravel()
    there = variance > 1e-6 * noise  # rows that are projected out are zero
    return np.asarray(residual[there] / np.sqrt(variance[there]))


def coverage(solution: KinematicSolution, poses: Poses) -> float:
    """Part of the residuals of held-out poses that lie within their 95 % intervals."""
    return float(np.mean(np.abs(standardised(solution, poses)) < NORMAL_95))
