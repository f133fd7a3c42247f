"""How long residuals repeat themselves: the factor by which samples outnumber independent pieces of information."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hydroopt.inertia import Array


def correlation_time(residual: Array, taken: NDArray[np.bool_], segment: NDArray[np.int64]) -> float:
    """Integrated autocorrelation time in samples, 1 for white noise and never less.

    The autocorrelation is taken over pairs of samples that both take part and lie in one stretch. Its sum ends where
    two neighbouring lags are no longer positive together; until then they may not grow (Geyer 1992, initial monotone
    sequence).

    Args:
        residual: (N,) residuals.
        taken: (N,) which of them take part.
        segment: (N,) the uninterrupted stretch that each belongs to.
    """
    if np.sum(taken) < 4:
        return 1.0
    centred = np.where(taken, residual - np.mean(residual[taken]), 0.0)
    pairs, products = np.zeros(len(residual)), np.zeros(len(residual))
    for stretch in np.unique(segment):
        here = segment == stretch
        for total, values in ((pairs, taken[here].astype(float)), (products, centred[here])):
            total[: np.sum(here)] += _lagged_products(values)
    enough = pairs > 0.05 * pairs[0]  # beyond, too few pairs are left to say anything
    lags = len(pairs) if np.all(enough) else int(np.argmin(enough))
    if products[0] <= 0 or lags < 2:
        return 1.0
    correlation = products[:lags] / pairs[:lags] / (products[0] / pairs[0])
    neighbours = correlation[: lags // 2 * 2].reshape(-1, 2).sum(axis=1)
    negative = np.flatnonzero(neighbours <= 0)
    kept = np.minimum.accumulate(neighbours[: negative[0] if negative.size else len(neighbours)])
    return max(1.0, float(2 * np.sum(kept) - 1))


def _lagged_products(values: Array) -> Array:
    """Σ x_i·x_{i+k} for all lags k, (N,)."""
    size = 2 ** int(np.ceil(np.log2(2 * len(values))))
    spectrum = np.abs(np.fft.rfft(values, size)) ** 2
    return np.asarray(np.fft.irfft(spectrum)[: len(values)])
