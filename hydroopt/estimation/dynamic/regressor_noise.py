"""What noise of angles adds to the normal equations of joints that nothing drives.

There 0 = K·ψ, and all errors stand in K (errors in variables). Of a noisy K = K₁ + δ the expectation of KᵀK is
K₁ᵀK₁ + E[δᵀδ]: least squares would fit the last term by a smaller ψ, so that everything that swings becomes lighter by
one factor. The score KᵀK·ψ − E[δᵀδ]·ψ has mean zero at the true ψ (corrected score; Fuller, Measurement error models,
1987). Noise is so small that δ is its first order.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from hydroopt.logs.spline import passed_noise
from hydroopt.spatial.inertia import Array

STRIDE = 8
"""Of so many samples one stands for all: smoothed motion changes little between them."""
Equations = Callable[[Array, Array, Array], Array]
"""K (m, n, p) of positions, velocities and accelerations (m, n)."""


def regressor_noise(equations: Equations, motion: tuple[Array, Array, Array], noise: Array, taken: NDArray[np.bool_],
                    free: NDArray[np.intp]) -> Array:
    """E[δᵀδ] (f, p, p) of the balances `free` (f,), summed over the samples that are taken.

    Args:
        equations: K of a motion.
        motion: smoothed q, qd and qdd (m, n), of every `STRIDE`-th sample.
        noise: (n, 3, 3) covariance of the errors of q, qd and qdd of each joint.
        taken: (m, n) samples that each balance takes.
        free: the balances.
    """
    about = equations(*motion)[:, free]
    found = np.zeros((len(free), about.shape[2], about.shape[2]))
    for joint in np.flatnonzero(noise[:, 0, 0] > 0):
        for error in np.linalg.cholesky(noise[joint]).T:
            moved = [column + size * (np.arange(column.shape[1]) == joint)
                     for column, size in zip(motion, error, strict=True)]
            off = np.where(taken[:, free, None], equations(*moved)[:, free] - about, 0.0)
            found += STRIDE * np.einsum("mfi,mfj->fij", off, off)
    return found


def angle_errors(noise: Array, bandwidth: Array, passes: NDArray[np.int64], step: float) -> Array:
    """Covariance (n, 3, 3) of q, qd and qdd that smoothing leaves of white noise (n,) of the angles.

    Args:
        noise: standard deviations; not a number where none is stated, which counts as zero.
        bandwidth, passes: of the smoothing, as of `Motion`; a motion without a bandwidth is not smoothed, and has none.
        step: [s] between samples.
    """
    found = np.zeros((len(noise), 3, 3))
    for joint in np.flatnonzero(np.isfinite(noise) & np.isfinite(bandwidth)):
        found[joint] = noise[joint] ** 2 * passed_noise(float(bandwidth[joint]), int(passes[joint]), step)
    return found
