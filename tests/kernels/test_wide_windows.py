"""Rows with wide windows and triangles with a band, against dense matrices."""

import numpy as np
import pytest
from scipy.linalg import cholesky_banded

from hydroopt.kernels import shared_library, wide_windows


@pytest.mark.usefixtures("vectors")
@pytest.mark.parametrize(("rows", "columns", "width", "count"), [(40, 30, 18, 7), (0, 12, 4, 3), (1, 5, 5, 1),
                                                                (300, 90, 24, 65)])
def test_products_are_those_of_the_dense_matrix(rows: int, columns: int, width: int, count: int) -> None:
    rng = np.random.default_rng(rows)
    values, samples = rng.standard_normal((rows, width)), rng.standard_normal((rows, count))
    first, dense = rng.integers(0, columns - width + 1, rows), np.zeros((rows, columns))
    for row, own, at in zip(dense, values, first, strict=True):
        row[at : at + width] = own
    gram, gathered = dense.T @ dense, wide_windows.gathered(values, first, columns, samples.T.copy().T)
    found = wide_windows.gram(values, first, columns)
    if found is None or gathered is None:
        assert found is gathered is shared_library.compiler() is None
        return
    np.testing.assert_allclose(gathered, dense.T @ samples, atol=1e-12)
    for below in range(width):
        np.testing.assert_allclose(found[below, : columns - below], np.diagonal(gram, -below), atol=1e-12)
        assert not np.any(found[below, columns - below :])


@pytest.mark.usefixtures("vectors")
@pytest.mark.parametrize(("columns", "width", "count"), [(50, 7, 9), (3, 3, 1), (20, 1, 4)])
def test_a_triangle_is_solved(columns: int, width: int, count: int) -> None:
    rng = np.random.default_rng(columns)
    band = rng.standard_normal((width, columns))
    band[0] = 3.0 * width + rng.random(columns)
    factor = cholesky_banded(band, lower=True)
    L = np.zeros((columns, columns))
    for below in range(width):
        L += np.diag(factor[below, : columns - below], -below)
    right = rng.standard_normal((columns, count))
    solved = wide_windows.forward(factor, right.copy(order="F"))
    np.testing.assert_allclose(L @ solved, right, atol=1e-12)
