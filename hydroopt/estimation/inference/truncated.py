"""Samples of a Gaussian that inequalities cut off, and what they say of linear sums beyond their own values.

Along the direction in which a sum varies while all that is independent of it stays, its conditional distribution is
normal between the ends of a chord. These, averaged over the samples, have the same mean as the samples' own
distribution and far less scatter (Rao and Blackwell): intervals of as many samples differ by a third as much from run
to run.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hydroopt.estimation.inference.whitening import GaussianPosterior
from hydroopt.kernels.marginals import marginals
from hydroopt.spatial.inertia import Array

TAIL = 0.025
"""Probability beyond each end of an interval."""
FURTHEST = 30.0
"""Standard deviations of the Gaussian that is cut off, beyond which its tails cannot be told from zero."""


class Marginal(NamedTuple):
    """Mean and standard deviation (n,) and interval (n, 2) of sums."""

    mean: Array
    std: Array
    interval: Array


@dataclass(frozen=True, eq=False)
class TruncatedGaussian:
    """A Gaussian that holds where matrices are positive definite and single functions are not negative.

    Attributes:
        gaussian: in standard normal coordinates z (k,).
        slope: (m, k) of the functions: first entries of the matrices' upper triangles, second ones, ..., single ones.
        matrices: number of these.
    """

    gaussian: GaussianPosterior
    slope: Array
    matrices: int

    def marginal(self, samples: Array, slack: Array, rows: Array) -> Marginal:
        """Linear sums ``rows·ψ`` (n,) at samples ψ (s, p), where the functions are slack (m, s); by the samples'
        own values where a chord's cannot be computed.
        """
        values = rows @ samples.T
        mean, std = values.mean(axis=1), values.std(axis=1)
        axes, offset = rows @ self.gaussian.slope, rows @ self.gaussian.offset
        length = np.linalg.norm(axes, axis=1)
        far = np.abs(mean - offset) > FURTHEST * length
        sound = np.flatnonzero((length > 0) & ~far)
        unit = axes[sound] / length[sound, None]
        found = marginals(slack, unit @ self.slope.T, (values[sound] - offset[sound, None]) / length[sound, None],
                          self.matrices, TAIL)
        if found is None or len(sound) < len(rows):
            interval = np.quantile(values, [TAIL, 1 - TAIL], axis=1).T
        else:
            interval = np.empty((len(rows), 2))
        if found is not None:
            mean[sound] = offset[sound] + length[sound] * found[:, 0]
            std[sound] = length[sound] * np.sqrt(np.maximum(found[:, 1] - found[:, 0] ** 2, 0.0))
            interval[sound] = offset[sound, None] + length[sound, None] * found[:, 2:]
        return Marginal(mean, std, interval)
