"""One smoothing kernel for positions, their derivatives and forces, so that smoothed forces are those of the motion.

A filter distorts a motion, and the forces that belong to it, alike (Gautier 1997), but only as far as forces are
linear in the motion: the force of the smoothed motion is off by half a per cent where joints turn fast. Within the
kernel the motion is therefore taken for a cubic, and forces are averaged over it at three `nodes`, as the kernel
averages measured ones. The kernel w(τ) = (1 − τ²/h²)³ ends after the reach h, so that a controller has the result
soon, and the errors of smoothed samples are correlated over 2·h only, by known sums of its weights.
"""

from __future__ import annotations

import math
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
    >>> q, qd, qdd, jerk = kernel.smoothed(t**2, kernel.middles(100))
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
        """(4, 2·half + 1): what positions, and their first three derivatives, are of the samples."""
        k = np.arange(-self.half, self.half + 1)
        x, tau = k / (self.half + 1), k * self.step
        w = (1 - x**2) ** 3
        first, second = 6 * x * (1 - x**2) ** 2, (1 - x**2) * (30 * x**2 - 6)
        second -= w * second.sum() / w.sum()  # no acceleration of what stands still
        w /= w.sum()
        # the cubic that fits best with the weights w
        third = w * (tau**3 - tau * (w @ tau**4) / (w @ tau**2))
        return np.stack([w, first / (first @ tau), 2 * second / (second @ tau**2), 6 * third / (third @ tau**3)])

    @cached_property
    def spread(self) -> float:
        """Variance of the time under the weights [s²]."""
        return float(self.weights[0] @ self._times**2)

    @cached_property
    def nodes(self) -> tuple[tuple[float, float], ...]:
        """Times from the middle [s] and weights that average polynomials up to the fifth degree as the kernel does."""
        fourth = float(self.weights[0] @ self._times**4)
        apart, share = math.sqrt(fourth / self.spread), self.spread**2 / (2 * fourth)
        return (-apart, share), (0.0, 1 - 2 * share), (apart, share)

    def at_node(self, tau: float) -> Array:
        """(3, 4): position, speed and acceleration at a time from the middle [s], by a smoothed sample's value and
        derivatives: of the cubic whose mean under the kernel they are."""
        rest = (tau**2 - self.spread) / 2
        return np.array([[1.0, tau, rest, tau**3 / 6 - self.spread * tau / 2], [0.0, 1.0, tau, rest],
                         [0.0, 0.0, 1.0, tau]])

    @property
    def _times(self) -> Array:
        return np.asarray(np.arange(-self.half, self.half + 1) * self.step)

    def middles(self, size: int) -> NDArray[np.intp]:
        """Places of the smoothed samples in a stretch of `size` samples."""
        return np.arange(self.margin, size - self.margin, self.stride)

    def smoothed(self, values: Array, middles: NDArray[np.intp]) -> Array:
        """(4, M, …): smoothed values (N, …) and their derivatives at the places `middles` (M,)."""
        near = values[middles[:, None] + np.arange(-self.half, self.half + 1)]
        return np.asarray(np.einsum("dk,mk...->dm...", self.weights, near))

    def of_a_jump(self, count: int) -> Array:
        """(count,): which part of a jump the smoothed samples show, from the first one that shows more than a tenth."""
        reached = np.minimum(self.stride * np.arange(2, count + 2), self.weights.shape[1])
        return np.asarray(np.cumsum(self.weights[0])[reached - 1])

    @cached_property
    def covariance(self) -> Array:
        """(L, 4, 4): covariance of a smoothed sample's value and first three derivatives with those of the l-th one
        after it, per variance of a sample; zero from the L-th on."""
        weights, size, made = self.weights, self.weights.shape[1], []
        for shift in range(0, size, self.stride):
            made.append(weights[:, shift:] @ weights[:, : size - shift].T)
        return np.stack(made)
