"""Correlation time of residuals: the number of samples that carry as much information as one independent sample."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hydroopt.spatial.inertia import Array


def correlation_time(residual: Array, taken: NDArray[np.bool_], segment: NDArray[np.int64]) -> float:
    """Integrated autocorrelation time in samples, 1 for white noise and never less.

    The autocorrelation is taken over pairs of used samples of one stretch. Its sum ends where
    two neighbouring lags are no longer positive together; until then they may not grow (Geyer 1992, initial monotone
    sequence).

    Args:
        residual: (N,) residuals.
        taken: (N,) which of them are used.
        segment: (N,) the uninterrupted stretch that each belongs to.
    """
    lagged = Lagged(len(residual))
    lagged.add(residual - np.mean(residual[taken]) if np.any(taken) else residual, taken, segment)
    return lagged.time


class Lagged:
    """Sums over pairs of samples by their distance: how many there are, and the products of their residuals.

    A long log adds its pieces one after the other.
    """

    def __init__(self, lags: int) -> None:
        self.pairs, self.products = np.zeros(lags), np.zeros(lags)

    def add(self, centred: Array, taken: NDArray[np.bool_], segment: NDArray[np.int64],
            first: slice = np.s_[:]) -> None:
        """Pairs of samples (N,) that both take part and lie in one stretch, the earlier one of them in `first`."""
        starts = np.zeros(len(taken), bool)
        starts[first] = True
        edges = np.flatnonzero(np.diff(segment, prepend=segment[:1] - 1, append=segment[-1:] + 1))
        for a, b in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
            here, lags = taken[a:b], min(b - a, len(self.pairs))
            for total, values in ((self.pairs, here.astype(float)), (self.products, np.where(here, centred[a:b], 0.0))):
                total[:lags] += _lagged_products(np.where(starts[a:b], values, 0.0), values, lags)

    @property
    def time(self) -> float:
        """The correlation time in samples."""
        pairs, products = self.pairs, self.products
        if pairs[0] < 3.5:
            return 1.0
        enough = pairs > 0.05 * pairs[0]  # beyond, there are too few pairs
        lags = len(pairs) if np.all(enough) else int(np.argmin(enough))
        if products[0] <= 0 or lags < 2:
            return 1.0
        correlation = products[:lags] / pairs[:lags] / (products[0] / pairs[0])
        neighbours = correlation[: lags // 2 * 2].reshape(-1, 2).sum(axis=1)
        negative = np.flatnonzero(neighbours <= 0)
        kept = np.minimum.accumulate(neighbours[: negative[0] if negative.size else len(neighbours)])
        return max(1.0, float(2 * np.sum(kept) - 1))


def _lagged_products(first: Array, second: Array, lags: int) -> Array:
    """Σ x_i·y_{i+k} of samples (N,) for lags k below `lags`."""
    size = 1 << (len(first) + lags - 1).bit_length()
    return np.asarray(np.fft.irfft(np.conj(np.fft.rfft(first, size)) * np.fft.rfft(second, size), size)[:lags])
