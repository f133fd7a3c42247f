"""Cosine transforms in C against SciPy's."""

import numpy as np
import pytest
from scipy.fft import dct

from hydroopt.kernels import cosine
from hydroopt.kernels.compiler import compiler


@pytest.mark.skipif(compiler() is None, reason="no C compiler")
@pytest.mark.parametrize("rows", [1, 7, 8, 21])
def test_compiled_transforms_are_those_of_scipy(rows: int) -> None:
    room = np.random.default_rng(rows).standard_normal((rows, cosine.SIZE + 8))
    room[-1] = 1e9  # coefficients of one row are no part of another
    given, beside = room[:, : cosine.SIZE], room[:, cosine.SIZE :].copy()
    wanted = dct(given, norm="ortho", axis=1)
    assert cosine._compiled() is not None
    assert cosine.cosine_transform(given) is given
    np.testing.assert_allclose(given[:-1], wanted[:-1], rtol=0, atol=2e-14)
    np.testing.assert_allclose(given[-1], wanted[-1], rtol=0, atol=1e-5)
    np.testing.assert_array_equal(room[:, cosine.SIZE :], beside)


def test_other_lengths_and_machines_without_a_compiler_take_numpy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cosine, "_compiled", lambda: None)
    for size in (cosine.SIZE, 100):
        given = np.random.default_rng(size).standard_normal((3, size))
        wanted = dct(given, norm="ortho", axis=1)
        np.testing.assert_allclose(cosine.cosine_transform(given), wanted, rtol=0, atol=1e-13)
