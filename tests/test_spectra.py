"""Cosine transforms and running medians, against SciPy."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest
from scipy.fft import dct
from scipy.ndimage import median_filter

from hydroopt import spectra
from hydroopt.spectra import cosine_transform, windowed_median


@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize("n", [1, 2, 3, 4, 5, 64, 65])
def test_cosine_transforms(n: int, order: Literal["C", "F"], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(spectra, "TOGETHER", 130)
    rows = np.random.default_rng(n).standard_normal((3, n)).copy(order)
    expected = dct(rows, norm="ortho")
    assert cosine_transform(rows) is rows
    np.testing.assert_allclose(rows, expected, atol=1e-12)


@pytest.mark.parametrize(("shape", "width"), [((50,), 7), ((50, 3), 5), ((3, 2), 7), ((20, 4, 2), 3)])
def test_windowed_medians(shape: tuple[int, ...], width: int, monkeypatch: pytest.MonkeyPatch) -> None:
    values = np.random.default_rng(0).standard_normal(shape)
    expected = median_filter(values, size=(width, *[1] * (len(shape) - 1)), mode="nearest")
    np.testing.assert_array_equal(windowed_median(values, width), expected)
    monkeypatch.setattr(spectra, "LARGE", 0)
    np.testing.assert_array_equal(windowed_median(values, width), expected)
