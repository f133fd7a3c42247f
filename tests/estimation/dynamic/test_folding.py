"""Triangles against the sums of squares that they stand for."""

from collections.abc import Callable

import numpy as np
import pytest

from hydroopt.estimation.dynamic.column_basis import ColumnBasis, column_bases
from hydroopt.estimation.dynamic.folding import ActuatorTriangles
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
        np.testing.assert_allclose(one.squares(v), np.sum(left**2, axis=0), rtol=1e-10)
        np.testing.assert_allclose(np.sum((one.full @ v) ** 2, axis=1), np.sum(left**2, axis=0), rtol=1e-10)
        np.testing.assert_allclose(one.sums @ v, left.sum(axis=0), rtol=1e-8)
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
