"""Rows of which only a window is not zero, against dense matrices."""

from __future__ import annotations

import numpy as np
import pytest

from hydroopt.logs.windowed_rows import WindowedRows


@pytest.mark.parametrize(("rows", "columns", "width"), [(40, 12, 6), (7, 30, 4), (200, 9, 9), (0, 5, 3), (3000, 900, 6),
                                                         (3000, 40, 6)])
@pytest.mark.parametrize("more", [(), (2,), (50,), (3, 2)])
def test_products_are_those_of_the_dense_matrix(rows: int, columns: int, width: int, more: tuple[int, ...]) -> None:
    rng = np.random.default_rng(rows)
    first = np.sort(rng.integers(0, columns - width + 1, rows))
    first[: rows // 2] = np.minimum(first[: rows // 2], (columns - width) // 3)  # columns that no row has
    made = WindowedRows(rng.standard_normal((rows, width)), first, columns)
    dense = np.zeros((rows, columns))
    for row, values, first in zip(dense, made.values, made.first, strict=True):
        row[first : first + width] = values
    coefficients, samples = rng.standard_normal((columns, *more)), rng.standard_normal((rows, *more))
    np.testing.assert_allclose(made @ coefficients, np.tensordot(dense, coefficients, 1), atol=1e-12)
    np.testing.assert_allclose(made.gathered(samples), np.tensordot(dense.T, samples, 1), atol=1e-12)
    gram = dense.T @ dense
    for below in range(width):
        np.testing.assert_allclose(made.gram[below, : columns - below], np.diagonal(gram, -below), atol=1e-12)
