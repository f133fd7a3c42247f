"""One smoothing kernel for positions, their derivatives and forces, so that smoothed forces are those of the motion.

A filter distorts a motion, and the forces that belong to it, alike: what K(q, q̇, q̈)·ψ loses of a force where only the
motion is smoothed, it loses nowhere where both are (Gautier 1997). The kernel w(τ) = (1 − τ²/h²)³ ends after the reach
h, so that a controller has the result soon, and the errors of smoothed samples are correlated over 2·h only, by known
sums of its weights.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hydroopt.spatial.inertia import Array

REACH = 0.5
"""How far the kernel reaches to either side [s]."""
STRIDE = 0.2
"""Time between smoothed samples [s]."""


@dataclass(frozen=True)
class SmoothingKernel:
    """Weights of samples that are taken every `step` [s].

    Attributes:
        step: between samples [s].
        half: number of samples to either side of the middle.
        stride: number of samples from one smoothed sample to the next.

    >>> kernel = SmoothingKernel.of_step(0.02)
    >>> t = np.arange(100) * 0.02
    >>> q, qd, qdd = kernel.smoothed(t**2, kernel.middles(100))
    >>> bool(np.allclose(qdd, 2.0) and np.allclose(qd, 2 * t[kernel.middles(100)]))
    True
    """

    step: float
    half: int
    stride: int

    @classmethod
    def of_step(cls, step: float) -> SmoothingKernel:
        """The kernel for a sampling step [s]."""
        return cls(step, max(2, round(REACH / step)), max(1, round(STRIDE / step)))

    @property
    def outlook(self) -> int:
        """Number of samples to either side within which nearly all of the weight lies."""
        return round(0.8 * self.half)

    @property
    def margin(self) -> int:
        """Number of samples that a smoothed one needs on either side, together with the speeds at its outlook."""
        return self.half + self.outlook

    @cached_property
    def weights(self) -> Array:
        """(3, 2·half + 1): what positions, and their first and second derivatives, are of the samples."""
        k = np.arange(-self.half, self.half + 1)
        x, tau = k / (self.half + 1), k * self.step
        w = (1 - x**2) ** 3
        first, second = 6 * x * (1 - x**2) ** 2, (1 - x**2) * (30 * x**2 - 6)
        second -= w * second.sum() / w.sum()  # no acceleration of what stands still
        return np.stack([w / w.sum(), first / (first @ tau), 2 * second / (second @ tau**2)])

    def middles(self, size: int) -> NDArray[np.intp]:
        """Places of the smoothed samples in a stretch of `size` samples."""
        return np.arange(self.margin, size - self.margin, self.stride)

    def smoothed(self, values: Array, middles: NDArray[np.intp]) -> Array:
        """(3, M, …): smoothed values (N, …) and their derivatives at the places `middles` (M,)."""
        near = values[middles[:, None] + np.arange(-self.half, self.half + 1)]
        return np.asarray(np.einsum("dk,mk...->dm...", self.weights, near))

    @cached_property
    def covariance(self) -> Array:
        """(L, 3, 3): covariance of a smoothed sample's value and derivatives with those of the l-th one after it, per
        variance of a sample; zero from the L-th on."""
        size, made = self.weights.shape[1], []
        for shift in range(0, size, self.stride):
            made.append(self.weights[:, shift:] @ self.weights[:, : size - shift].T)
        return np.stack(made)
