"""Triangles against the sums of squares that they stand for."""

from collections.abc import Callable

import numpy as np
import pytest

from hydroopt.estimation.dynamic.column_basis import ColumnBasis, KeptRows, column_bases
from hydroopt.estimation.dynamic.folding import ActuatorTriangles, Triangles
from hydroopt.estimation.dynamic.frequency_bands import BANDS, ActuatorBands
from hydroopt.machine.machine_file import load_machine
from hydroopt.model.model import Model
from hydroopt.simulation.simulate import random_trajectory


def every_column(model: Model) -> list[ColumnBasis]:
    return [ColumnBasis.whole(np.flatnonzero(row)) for row in model.regressor_pattern]


@pytest.mark.parametrize("bases", [every_column, column_bases])
def test_triangles_keep_sums_and_squares_of_all_rows(cat215b: Model,
                                                     bases: Callable[[Model], list[ColumnBasis]]) -> None:
    motion = random_trajectory(cat215b, duration=33.0, rate=20.0, seed=1)
    rng = np.random.default_rng(1)
    K = cat215b.over(cat215b.regressor, motion.q, motion.qd, motion.qdd)[0]
    force, taken = 1e4 * rng.standard_normal(K.shape[:2]), rng.random(K.shape[:2]) < 0.7
    taken[40:90, 1] = False
    one, other = (ActuatorTriangles(bases(cat215b), K.shape[2]) for _ in range(2))
    for some, rows in ((one, slice(0, 40)), (one, slice(40, 90)), (other, slice(90, 300)), (other, slice(300, None))):
        some.fold(K[rows], force[rows], taken[rows])
    one.add(other)
    np.testing.assert_array_equal(one.samples, taken.sum(axis=0))
    for psi in (cat215b.parameters.nominal, cat215b.parameters.scale * rng.standard_normal(K.shape[2])):
        left = np.where(taken, K @ psi - force, 0.0)
        v = np.append(psi, -1.0)
        np.testing.assert_allclose(np.sum((one.full @ v) ** 2, axis=1), np.sum(left**2, axis=0), rtol=1e-10)
    np.testing.assert_allclose(one.forces, np.where(taken, force, 0.0).sum(axis=0), rtol=1e-9)
    assert np.all(np.tril(one.full, -1) == 0)


def test_the_pattern_misses_no_entry(cat215b: Model) -> None:
    motion = random_trajectory(cat215b, duration=33.0, rate=20.0, seed=2)
    K = cat215b.over(cat215b.regressor, motion.q, motion.qd, motion.qdd)[0]
    np.testing.assert_array_equal(np.any(K != 0, axis=0), cat215b.regressor_pattern)


@pytest.mark.parametrize("scale", [1.0, 1e-3, 0.0])
@pytest.mark.parametrize("name", ["cat215b", "ur10"])
def test_left_out_columns_follow_from_those_kept_at_every_speed(name: str, scale: float) -> None:
    model = Model(load_machine(name))
    motion = random_trajectory(model, duration=33.0, rate=20.0, seed=3)
    K = model.over(model.regressor, motion.q, scale * motion.qd, scale * motion.qdd)[0]
    for i, basis in enumerate(column_bases(model)):
        assert len(basis.kept) < len(basis.own)
        size = np.linalg.norm(K[:, i], axis=0).max()
        left = np.linalg.norm(K[:, i, basis.kept] @ basis.mixing - K[:, i, basis.own], axis=0)
        assert np.all(left < 1e-11 * size)  # what is zero at rest, too


@pytest.mark.parametrize("count", [60, 300])
def test_rows_of_some_columns_are_those_of_the_whole_regressor(cat215b: Model, count: int) -> None:
    motion = random_trajectory(cat215b, duration=count / 20, rate=20.0, seed=4)
    inputs = [x[:count] for x in (motion.q, motion.qd, motion.qdd)]
    bases = column_bases(cat215b)
    kept = KeptRows(cat215b, [basis.kept for basis in bases])
    force = np.random.default_rng(1).standard_normal((count, 3))
    rows, memory = kept(inputs, force)
    for again in (False, True):
        if again:
            for some in rows:
                some[:] = np.nan
            rows, _ = kept(inputs, force, memory)
        K = cat215b.over(cat215b.regressor, *inputs)[0]
        for i, basis in enumerate(bases):
            wanted = basis.rows(K, force, i)
            np.testing.assert_allclose(rows[i], wanted, rtol=0, atol=1e-13 * np.abs(wanted).max())


@pytest.mark.parametrize("middle", [-1, 1, 100, 1000])
def test_bands_keep_the_squares_of_rows_that_differ_between_the_halves(cat215b: Model, middle: int) -> None:
    motion = random_trajectory(cat215b, duration=33.0, rate=20.0, seed=5)
    rng, bases = np.random.default_rng(2), column_bases(cat215b)
    K = cat215b.over(cat215b.regressor, motion.q, motion.qd, motion.qdd)[0]
    force, taken = rng.standard_normal(K.shape[:2]), rng.random(K.shape[:2]) < 0.8
    later = np.arange(len(K)) >= middle
    bands = ActuatorBands(cat215b.parameters, bases)
    for start in range(0, len(K), 220):
        part = slice(start, start + 220)
        bands.fold([basis.rows(K[part], force[part], i) for i, basis in enumerate(bases)], taken[part], later[part],
                   0.05)
    whole = bands.expanded()
    assert whole.expanded() is whole
    for i, (basis, extra) in enumerate(zip(bases, bands.contrast, strict=True)):
        v = rng.standard_normal(len(basis.own) + len(extra) + 1)
        sign = np.where(later, 1.0, -1.0)[:, None]
        row = np.hstack([K[:, i, basis.own], sign * K[:, i, extra], force[:, i, None]])
        squares = sum(float(np.sum((block @ v) ** 2)) for block in (whole.across[i][b] for b in range(BANDS)))
        assert squares == pytest.approx(float(np.sum((row[taken[:, i]] @ v) ** 2)), rel=1e-11)


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
    assert one.empty
    wanted: list[list[np.ndarray]] = [[] for _ in range(5)]
    for made in (one, other, other):
        rows = rng.standard_normal((500, 6))
        rows[:, [0, 4]] = 0.0
        made.fold(rows, edges)
        for band, (own, first, end) in enumerate(zip(wanted, edges, edges[1:], strict=False)):
            own.append(rows[first:end])
            assert len(made[band]) <= 6
    before = one.copy()
    one.add(other)
    for band, own in enumerate(wanted):
        for some, stacked in ((one, np.vstack(own)), (before, own[0])):
            np.testing.assert_allclose(some[band].T @ some[band], stacked.T @ stacked, rtol=0, atol=1e-11)
            assert np.all(some[band][:, [0, 4]] == 0)
    assert len(one[0]) == 0
    assert not one.empty


def test_what_is_no_number_is_not_lost() -> None:
    rows = np.random.default_rng(3).standard_normal((400, 5))
    rows[77, 2] = np.nan
    assert np.any(np.isnan(folded(rows)))
