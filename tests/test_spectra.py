"""Cosine transforms, against SciPy."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest
from scipy.fft import dct

from hydroopt import spectra
from hydroopt.spectra import cosine_transform


@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize("n", [1, 2, 3, 4, 5, 64, 65])
def test_cosine_transforms(n: int, order: Literal["C", "F"], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(spectra, "TOGETHER", 130)
    rows = np.random.default_rng(n).standard_normal((3, n)).copy(order)
    expected = dct(rows, norm="ortho")
    assert cosine_transform(rows) is rows
    np.testing.assert_allclose(rows, expected, atol=1e-12)
