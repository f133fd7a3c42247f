"""Banded normal equations against dense linear algebra."""

import numpy as np

from hydroopt.estimation.motion.banded import Bordered, Rows, inverse_band


def _problem(seed=0, size=40, width=7, others=5):
    rng = np.random.default_rng(seed)
    whole = np.zeros((size + others, size + others))
    for start in range(size - width + 1):
        rows = np.zeros((3, size + others))
        rows[:, start:start + width], rows[:, size:] = rng.normal(size=(3, width)), rng.normal(size=(3, others))
        whole += rows.T @ rows
    whole += np.eye(size + others)
    band = np.zeros((width, size))
    for offset in range(width):
        band[offset, :size - offset] = np.diag(whole[:size, :size], -offset)
    return whole, band, size, rng.normal(size=size + others)


def test_a_solution_and_its_covariance_are_those_of_the_dense_equations():
    whole, band, size, right = _problem()
    made = Bordered(band, whole[:size, size:], whole[size:, size:], right[:size], right[size:])
    expected, inverse = np.linalg.solve(whole, right), np.linalg.inv(whole)
    schur, side = made.reduced
    np.testing.assert_allclose(np.linalg.solve(schur, side), expected[size:], rtol=1e-9)
    np.testing.assert_allclose(made.inner(expected[size:]), expected[:size], rtol=1e-9)
    found = made.inverse_band(np.linalg.inv(schur))
    for offset in range(len(band)):
        np.testing.assert_allclose(found[offset, :size - offset], np.diag(inverse[:size, :size], -offset), atol=1e-12)


def test_the_band_of_an_inverse_is_that_of_the_dense_one():
    whole, band, size, _ = _problem(seed=3)
    inverse = np.linalg.inv(whole[:size, :size])
    lower = np.linalg.cholesky(whole[:size, :size])
    factor = np.zeros_like(band)
    for offset in range(len(band)):
        factor[offset, :size - offset] = np.diag(lower, -offset)
    found = inverse_band(factor)
    for offset in range(len(band)):
        np.testing.assert_allclose(found[offset, :size - offset], np.diag(inverse, -offset), atol=1e-12)


def test_rows_add_up_to_normal_equations_and_are_projected_as_these_are_reduced():
    rng = np.random.default_rng(1)
    blocks = [Rows(rng.normal(size=(samples, 3)), rng.normal(size=(samples, 3, width)),
                   rng.normal(size=(samples, 3, 2)), 2 * rng.integers(0, (12 - width) // 2 + 1, samples))
              for samples, width in ((30, 6), (20, 2))]
    made = Bordered.of(blocks, 12, 6, 2)
    whole = np.concatenate([np.column_stack([by_path.toarray(), by_common, left])
                            for by_path, by_common, left in (rows.matrices(12) for rows in blocks)])
    expected = whole.T @ whole
    for offset in range(6):
        np.testing.assert_allclose(made.band[offset, :12 - offset], np.diag(expected[:12, :12], -offset))
    np.testing.assert_allclose(made.border, expected[:12, 12:14])
    np.testing.assert_allclose(made.corner, expected[12:14, 12:14])
    np.testing.assert_allclose([*made.right, *made.right_corner, made.squares], expected[:, 14])
    left = np.concatenate([made.projected(rows) for rows in blocks])
    matrix, right = made.reduced
    np.testing.assert_allclose(left.T @ left[:, :2], np.vstack([matrix, right]), atol=1e-10)
