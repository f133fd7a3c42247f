"""Cosine transforms in C against SciPy's."""

import numpy as np
import pytest
from scipy.fft import dct

from hydroopt.kernels import cosine


@pytest.mark.usefixtures("vectors")
@pytest.mark.parametrize("rows", [1, 7, 8, 21])
def test_transforms_are_those_of_scipy(rows: int) -> None:
    room = np.random.default_rng(rows).standard_normal((rows, cosine.SIZE + 8))
    room[-1] = 1e9  # coefficients of one row are no part of another
    given, beside = room[:, : cosine.SIZE], room[:, cosine.SIZE :].copy()
    wanted = dct(given, norm="ortho", axis=1)
    assert cosine.cosine_transform(given) is given
    np.testing.assert_allclose(given[:-1], wanted[:-1], rtol=0, atol=2e-14)
    np.testing.assert_allclose(given[-1], wanted[-1], rtol=0, atol=1e-5)
    np.testing.assert_array_equal(room[:, cosine.SIZE :], beside)


@pytest.mark.usefixtures("vectors")
@pytest.mark.parametrize("size", [cosine.SIZE, 100, 1])
def test_what_is_not_taken_counts_as_zero_even_where_it_is_no_number(size: int) -> None:
    rng = np.random.default_rng(size)
    given, taken = rng.standard_normal((9, size)), rng.random(size) < 0.7
    wanted = dct(np.where(taken, given, 0.0), norm="ortho", axis=1)
    given[:, ~taken] = np.nan
    np.testing.assert_allclose(cosine.cosine_transform(given, taken), wanted, rtol=0, atol=1e-13)
    np.testing.assert_array_equal(cosine.cosine_transform(np.full((2, size), np.inf), np.zeros(size, bool)), 0.0)


@pytest.mark.usefixtures("vectors")
def test_other_lengths_and_machines_without_a_compiler_take_numpy() -> None:
    for size in (cosine.SIZE, 100):
        given = np.random.default_rng(size).standard_normal((3, size))
        wanted = dct(given, norm="ortho", axis=1)
        np.testing.assert_allclose(cosine.cosine_transform(given), wanted, rtol=0, atol=1e-13)
