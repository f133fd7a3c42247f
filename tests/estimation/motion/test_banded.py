"""Banded normal equations against dense linear algebra."""

import numpy as np

from hydroopt.estimation.motion.banded import Bordered, add_blocks, inverse_band


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


def test_blocks_add_up_to_a_band():
    rng = np.random.default_rng(1)
    blocks = rng.normal(size=(4, 6, 6))
    blocks = blocks + blocks.transpose(0, 2, 1)
    dense, band = np.zeros((12, 12)), np.zeros((6, 12))
    for k, block in enumerate(blocks):
        dense[2 * k:2 * k + 6, 2 * k:2 * k + 6] += block
    add_blocks(band, blocks, np.arange(4), 2)
    for offset in range(6):
        np.testing.assert_allclose(band[offset, :12 - offset], np.diag(dense, -offset))
