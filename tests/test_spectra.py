"""Cosine transforms and running medians, against SciPy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.fft import dct
from scipy.ndimage import median_filter

from hydroopt import spectra
from hydroopt.spectra import cosine_transform, windowed_median


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5, 64, 65])
def test_cosine_transforms(n: int, monkeypatch: pytest.MonkeyPatch) -> None:
    rows = np.random.default_rng(n).standard_normal((3, n))
    expected = dct(rows, norm="ortho")
    np.testing.assert_allclose(cosine_transform(rows), expected, atol=1e-12)
    monkeypatch.setattr(spectra, "LARGE", 0)
    np.testing.assert_allclose(cosine_transform(rows), expected, atol=1e-12)


@pytest.mark.parametrize(("shape", "width"), [((50,), 7), ((50, 3), 5), ((3, 2), 7), ((20, 4, 2), 3)])
def test_windowed_medians(shape: tuple[int, ...], width: int, monkeypatch: pytest.MonkeyPatch) -> None:
    values = np.random.default_rng(0).standard_normal(shape)
    expected = median_filter(values, size=(width, *[1] * (len(shape) - 1)), mode="nearest")
    np.testing.assert_array_equal(windowed_median(values, width), expected)
    monkeypatch.setattr(spectra, "LARGE", 0)
    np.testing.assert_array_equal(windowed_median(values, width), expected)
