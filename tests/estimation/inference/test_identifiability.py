"""Rank, base parameters and collinearity of matrices whose dependencies are known because we made them."""

from __future__ import annotations

import numpy as np
import pytest

from hydroopt.estimation.inference.identifiability import (
    COMBINATION,
    FULL,
    NONE,
    analyse,
    confounded,
    random_states,
    structural,
)
from hydroopt.machine.machine_file import load_machine
from hydroopt.model.model import Model


def made(seed: int) -> tuple[np.ndarray, np.ndarray, list[int]]:
    """K (80, 12), its true grouping (8, 12) and the dependent columns, each an integer sum of columns before it."""
    rng = np.random.default_rng(seed)
    K = rng.standard_normal((80, 12))
    dependent = sorted(rng.choice(np.arange(4, 12), 4, replace=False).tolist())
    basis = [k for k in range(12) if k not in dependent]
    grouping = np.zeros((8, 12))
    grouping[np.arange(8), basis] = 1
    for k in dependent:
        before = [i for i, b in enumerate(basis) if b < k]
        some = rng.choice(before, 2, replace=False)
        grouping[some, k] = rng.choice([-3, -2, -1, 1, 2, 3], 2)
        K[:, k] = K[:, basis] @ grouping[:, k]
    return K, grouping, dependent


NAMES = tuple("abcdefghijkl")


@pytest.mark.parametrize("seed", range(8))
def test_dependencies_that_we_made_are_found(seed: int) -> None:
    K, grouping, dependent = made(seed)
    found = analyse(K, NAMES)
    assert found.rank == np.linalg.matrix_rank(K) == 8
    assert found.basis == tuple(k for k in range(12) if k not in dependent)
    np.testing.assert_allclose(found.grouping, grouping, atol=1e-9)
    in_sums = set(dependent) | {found.basis[i] for i in np.flatnonzero(np.any(grouping[:, dependent], axis=1))}
    assert found.category == tuple(COMBINATION if k in in_sums else FULL for k in range(12))
    assert found.count(FULL) + found.count(COMBINATION) == 12
    psi = np.random.default_rng(seed + 100).standard_normal(12)
    np.testing.assert_allclose(K[:, found.basis] @ (found.grouping @ psi), K @ psi, atol=1e-9)
    scaled = K / np.linalg.norm(K, axis=0)
    values = np.linalg.svd(scaled, compute_uv=False)
    assert found.condition_number == pytest.approx(values[0] / values[7], rel=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_order_of_rows_and_size_of_columns_do_not_matter(seed: int) -> None:
    K, grouping, _ = made(seed)
    rng = np.random.default_rng(seed)
    size = 10.0 ** rng.integers(-6, 7, 12)
    found = analyse(K, NAMES)
    other = analyse((K * size)[rng.permutation(80)], NAMES)
    assert (other.rank, other.basis, other.category) == (found.rank, found.basis, found.category)
    assert other.condition_number == pytest.approx(found.condition_number, rel=1e-6)
    # K·ψ = (K·S)·(S⁻¹·ψ): a grouping of scaled columns is the scaled grouping
    np.testing.assert_allclose(
        other.grouping, grouping * size / size[list(other.basis)][:, None], rtol=1e-6, atol=1e-300
    )
    triangle = analyse(np.linalg.qr(K, mode="r"), NAMES)
    assert (triangle.basis, triangle.category) == (found.basis, found.category)


def test_columns_of_zeros_are_not_identifiable() -> None:
    K, _, _ = made(1)
    K[:, 0] = 0
    found = analyse(K, NAMES)
    assert found.category[0] == NONE
    assert not found.grouping[:, 0].any()
    assert 0 not in found.basis
    nothing = analyse(np.zeros((5, 3)), "abc")
    assert (nothing.rank, nothing.basis, nothing.category) == (0, (), (NONE,) * 3)
    assert nothing.condition_number == np.inf


def test_fewer_equations_than_parameters() -> None:
    found = analyse(np.random.default_rng(0).standard_normal((3, 6)), "abcdef")
    assert (found.rank, found.basis, found.category) == (3, (0, 1, 2), (COMBINATION,) * 6)


def test_sums_in_words() -> None:
    x, y = np.random.default_rng(0).standard_normal((2, 30))
    K = np.column_stack([x, y, x, -y, 5.18 * x, -0.25 * y])
    found = analyse(K, ["boom.mc_x", "boom.m", "rod.m", "rod.mc_x", "stick.m", "stick.mc_x"])
    assert found.expression(0) == "boom.mc_x + rod.m + 5.18·stick.m"
    assert found.expression(1) == "boom.m − rod.mc_x − 0.25·stick.mc_x"


def test_variance_inflation_of_near_collinear_columns() -> None:
    """Two unit columns at the angle φ: each has 1/sin²φ of the variance that it would have alone."""
    basis = np.linalg.qr(np.random.default_rng(0).standard_normal((50, 4)))[0]
    angle = 0.02
    K = basis.copy()
    K[:, 2] = np.cos(angle) * basis[:, 1] + np.sin(angle) * basis[:, 2]
    K *= np.array([1.0, 100.0, 1e-3, 10.0])
    (first, second) = confounded(K, analyse(K, "abcd"))
    assert (first.name, first.partners) == ("b", ("c",))
    assert (second.name, second.partners) == ("c", ("b",))
    assert first.inflation == pytest.approx(1 / np.sin(angle) ** 2, rel=1e-6)
    assert second.inflation == pytest.approx(1 / np.sin(angle) ** 2, rel=1e-6)
    assert not confounded(K, analyse(K, "abcd"), threshold=1.01 / np.sin(angle) ** 2)


def test_variance_inflation_of_a_sum_of_several_columns() -> None:
    """A column that is the sum of three others but for a little: its multiple correlation gives 1/(1 − R²)."""
    rng = np.random.default_rng(1)
    K = rng.standard_normal((200, 5))
    K[:, 4] = K[:, 0] + K[:, 1] + K[:, 2] + 0.03 * rng.standard_normal(200)
    others = K[:, :4] @ np.linalg.lstsq(K[:, :4], K[:, 4], rcond=None)[0]
    expected = np.sum(K[:, 4] ** 2) / np.sum((K[:, 4] - others) ** 2)
    found = {one.name: one for one in confounded(K, analyse(K, "abcde"))}
    assert set(found) == set("abce")
    assert found["e"].inflation == pytest.approx(expected, rel=1e-6)
    assert "d" not in {name for one in found.values() for name in one.partners}


def test_random_states_fill_the_limits() -> None:
    model = Model(load_machine("cat215b"))
    q, qd, qdd = random_states(model, 4000, np.random.default_rng(0))
    for k, joint in enumerate(model.machine.joints):
        limits = model.machine.link(joint).joint
        for values, low, high in ((q, limits.lower, limits.upper), (qd, -limits.max_speed, limits.max_speed),
                                  (qdd, -limits.max_acceleration, limits.max_acceleration)):
            assert low <= values[:, k].min() < low + 0.01 * (high - low)
            assert high >= values[:, k].max() > high - 0.01 * (high - low)


def test_swing_of_the_excavator_shows_only_its_inertia_about_the_vertical() -> None:
    """Section 4.4.2: the cabin turns about its vertical axis, gravity along it."""
    model = Model(load_machine("cat215b"))
    found = structural(model)
    category = dict(zip(found.names, found.category, strict=True))
    hidden = {f"swing.{element}" for element in ("m", "mc_x", "mc_y", "mc_z", "I_xx", "I_xy", "I_xz", "I_yy", "I_yz")}
    assert {name for name in found.names if name.startswith("swing.") and category[name] == NONE} == hidden
    assert category["swing.I_zz"] != NONE
    for name in (
        "swing_motor.tau_offset",
        "swing_motor.tau_coulomb",
        "boom_cylinder.f_coulomb",
        "stick_cylinder.f_coulomb",
    ):
        assert category[name] == FULL
    assert structural(model, seed=9).category == found.category
    assert structural(model, seed=9).basis == found.basis


def test_a_column_that_is_nearly_a_combination_of_others_is_left_out_and_not_the_last_one() -> None:
    """Near the tolerance more columns stand apart than the rank counts: base parameters keep weights of their size."""
    rng = np.random.default_rng(3)
    K = rng.standard_normal((200, 6))
    K[:, 3] = K[:, 0] + K[:, 1] + 2e-6 * rng.standard_normal(200)
    distances = np.linalg.svd(K / np.linalg.norm(K, axis=0), compute_uv=False)
    tolerance = 1.01 * distances[-1] / distances[0]  # the rank is 5, though column 3 is farther off than that
    found = analyse(K, NAMES[:6], tolerance=tolerance)
    assert found.rank == 5
    assert found.basis == (0, 1, 2, 4, 5)
    np.testing.assert_allclose(found.grouping[:, 3], [1, 1, 0, 0, 0], atol=1e-5)
    assert found.category[2] == found.category[5] == FULL
