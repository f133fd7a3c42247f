"""What NumPy lacks of Fourier transforms and running medians, without loading SciPy's packages."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
LARGE = 2**20
"""Values, or values times the width of a median, from which on SciPy's faster code is worth its loading."""


def cosine_transform(rows: Array) -> Array:
    """Orthonormal cosine transform, type II, of rows (..., n), which may be written over: by a Fourier transform of
    every other sample forth, and of the others back (Makhoul 1980).

    >>> np.abs(cosine_transform(np.array([1.0, 1.0, 1.0, 1.0]))).round(12).tolist()
    [2.0, 0.0, 0.0, 0.0]
    """
    if rows.size > LARGE:
        from scipy.fft import dct  # noqa: PLC0415 — loaded where it pays

        return np.asarray(dct(rows, norm="ortho", overwrite_x=True))
    n = rows.shape[-1]
    turned = np.fft.rfft(np.concatenate([rows[..., ::2], rows[..., 1::2][..., ::-1]], axis=-1))
    turned *= np.sqrt(2 / n) * np.exp(-0.5j * np.pi / n * np.arange(turned.shape[-1]))
    turned[..., 0] *= np.sqrt(0.5)
    made = np.empty(rows.shape)
    made[..., : turned.shape[-1]] = turned.real
    made[..., turned.shape[-1]:] = -turned.imag[..., (n - 1) // 2 : 0 : -1]
    return made


def windowed_median(values: Array, width: int) -> Array:
    """Median of `width` (odd) neighbours along the first axis of (N, ...); the ends are repeated.

    >>> windowed_median(np.array([0.0, 9.0, 1.0, 2.0, 3.0]), 3).tolist()
    [0.0, 1.0, 2.0, 2.0, 3.0]
    """
    if values.size * width > LARGE:
        from scipy.ndimage import median_filter  # noqa: PLC0415 — loaded where it pays

        return np.asarray(median_filter(values, size=(width, *[1] * (values.ndim - 1)), mode="nearest"))
    half = width // 2
    longer = np.concatenate([np.repeat(values[:1], half, axis=0), values, np.repeat(values[-1:], half, axis=0)])
    windows = np.lib.stride_tricks.sliding_window_view(longer, width, axis=0)
    return np.asarray(np.partition(windows, half, axis=-1)[..., half])
