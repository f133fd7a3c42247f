"""Errors of what was predicted without its own data: parts of logs, places of poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from hydroopt.spatial.inertia import Array

BLOCKS = 5
"""Contiguous blocks of data, each of which is predicted without it."""
ENOUGH = 3.0
"""Effective number of parts in which a quantity must be read, for a bound that holds for another one."""
LEVEL = 0.95
"""Probability with which the bound holds for one further part."""


@dataclass(frozen=True, eq=False)
class LeftOut:
    """Errors of quantities that were predicted without the data where they occurred.

    Attributes:
        squares, counts: (b, r) sum of squared errors of each of r quantities in each part that was left out, and the
            number of readings that it sums.

    >>> found = LeftOut(np.array([[40.0], [60.0], [50.0], [45.0]]), np.full((4, 1), 10.0))
    >>> found.tested.tolist(), float(found.pooled[0]), round(float(found.bound[0]), 2)
    ([True], 4.875, 2.75)
    """

    squares: Array
    counts: Array

    @property
    def tested(self) -> Array:
        """Which quantities (r,) are read in `ENOUGH` parts."""
        return np.asarray(self._effective >= ENOUGH)

    @property
    def _share(self) -> Array:
        return np.asarray(self.counts / np.maximum(self.counts.sum(axis=0), 1.0))

    @property
    def _effective(self) -> Array:
        return np.asarray(1 / np.maximum(np.sum(self._share**2, axis=0), 1 / max(BLOCKS, len(self.counts)) ** 2))

    @property
    def pooled(self) -> Array:
        """Mean squared error (r,) over all parts."""
        return np.asarray(self.squares.sum(axis=0) / np.maximum(self.counts.sum(axis=0), 1.0))

    @property
    def bound(self) -> Array:
        """RMS (r,) below which the error of a further part stays with the probability `LEVEL`: Student's t limit of
        one more part, whose mean squares are about log-normal; never below the RMS of all parts together."""
        share, number = self._share, self._effective
        logs = np.log(np.maximum(self.squares, 1e-300) / np.maximum(self.counts, 1.0))
        mean = np.sum(share * logs, axis=0)
        scatter = np.sum(share * (logs - mean) ** 2, axis=0) / np.maximum(1 - 1 / number, 1e-9)
        limit = stdtrit(np.maximum(number - 1, 1.0), LEVEL) * np.sqrt(scatter * (1 + 1 / number))
        return np.asarray(np.sqrt(np.maximum(self.pooled, np.exp(mean + limit))))
