"""Triangles against the sums of squares that they stand for."""

import numpy as np
import pytest

from hydroopt.estimation.dynamic.folding import Triangles
from hydroopt.estimation.dynamic.frequency_bands import ActuatorBands
from hydroopt.estimation.dynamic.regressor_qr import compressed
from hydroopt.model.model import Model
from hydroopt.simulation.simulate import random_trajectory


def test_the_pattern_misses_no_entry(cat215b: Model) -> None:
    motion = random_trajectory(cat215b, duration=33.0, rate=20.0, seed=2)
    K = cat215b.over(cat215b.regressor, motion.q, motion.qd, motion.qdd)[0]
    assert not np.any((K != 0) & ~cat215b.regressor_pattern)


@pytest.mark.parametrize("middle", [-1, 1, 100, 1000])
def test_bands_keep_the_squares_of_rows_that_differ_between_the_halves(cat215b: Model, middle: int) -> None:
    motion = random_trajectory(cat215b, duration=33.0, rate=20.0, seed=5)
    rng = np.random.default_rng(2)
    K = cat215b.over(cat215b.regressor, motion.q, motion.qd, motion.qdd)[0]
    force, taken = rng.standard_normal(K.shape[:2]), rng.random(K.shape[:2]) < 0.8
    taken[40:90, 1] = False
    later = np.arange(len(K)) >= middle
    logs = [ActuatorBands(cat215b.parameters, cat215b.regressor_pattern) for _ in range(2)]
    for k, start in enumerate(range(0, len(K), 220)):
        part = slice(start, start + 220)
        logs[k % 2].fold(K[part], force[part], taken[part], later[part], 0.05)
    together = ActuatorBands.together(logs)
    np.testing.assert_array_equal(together.samples, taken.sum(axis=0))
    whole, apart = compressed(together), together.channels(contrasts=True)
    assert np.all(np.tril(whole.triangles, -1) == 0)
    for i, (own, extra) in enumerate(zip(together.own, together.contrast, strict=True)):
        v = rng.standard_normal(len(own) + len(extra) + 1)
        sign = np.where(later, 1.0, -1.0)[:, None]
        row = np.hstack([K[:, i, own], sign * K[:, i, extra], force[:, i, None]])
        squares = float(np.sum((row[taken[:, i]] @ v) ** 2))
        assert float(np.sum((apart[i].stacked @ v) ** 2)) == pytest.approx(squares, rel=1e-11)
    for psi in (cat215b.parameters.nominal, cat215b.parameters.scale * rng.standard_normal(K.shape[2])):
        left = np.where(taken, K @ psi - force, 0.0)
        np.testing.assert_allclose(whole.squares(psi), np.sum(left**2, axis=0), rtol=1e-10)


def folded(*blocks: np.ndarray) -> np.ndarray:
    made = Triangles(1, blocks[0].shape[1])
    for block in blocks:
        made.fold(block, [0, len(block)])
    return made[0]


def test_small_directions_keep_their_size_beside_large_ones() -> None:
    # the products of the columns would have lost what is 1e-9 of them
    base = np.random.default_rng(1).standard_normal((5000, 9))
    rows = base[:, [0, 1, 2, 3, 4, 5, 6, 7, 0]]
    rows[:, 8] += 1e-9 * base[:, 8]
    R = folded(rows[:2500], rows[2500:])
    assert abs(R[8, 8]) == pytest.approx(1e-9 * np.sqrt(5000 - 8), rel=0.05)


def test_bands_with_columns_of_zeros() -> None:
    rng = np.random.default_rng(2)
    edges = [0, 0, 2, 7, 40, 500]
    one, other = Triangles(5, 6), Triangles(5, 6)
    wanted: list[list[np.ndarray]] = [[] for _ in range(5)]
    for made in (one, other, other):
        rows = rng.standard_normal((500, 6))
        rows[:, [0, 4]] = 0.0
        made.fold(rows, edges)
        for band, (own, first, end) in enumerate(zip(wanted, edges, edges[1:], strict=False)):
            own.append(rows[first:end])
            assert len(made[band]) <= 6
    one.add([other[band] for band in range(5)])
    for band, own in enumerate(wanted):
        stacked = np.vstack(own)
        np.testing.assert_allclose(one[band].T @ one[band], stacked.T @ stacked, rtol=0, atol=1e-11)
        assert np.all(one[band][:, [0, 4]] == 0)
    assert len(one[0]) == 0


def test_what_is_no_number_is_not_lost() -> None:
    rows = np.random.default_rng(3).standard_normal((400, 5))
    rows[77, 2] = np.nan
    assert np.any(np.isnan(folded(rows)))
