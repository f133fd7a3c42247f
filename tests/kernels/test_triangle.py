"""The triangle of many rows against NumPy's."""

import numpy as np
import pytest

from hydroopt.kernels import triangle


def signed(R: np.ndarray) -> np.ndarray:
    return R * np.where(np.diag(R) < 0, -1.0, 1.0)[:, None]


def folded(*blocks: np.ndarray) -> np.ndarray:
    made = triangle.Triangles(1, blocks[0].shape[1])
    for block in blocks:
        made.fold(block, [0, len(block)])
    return made[0]


@pytest.mark.usefixtures("vectors")
@pytest.mark.parametrize("columns", [1, 4, 7, 48])
@pytest.mark.parametrize("rows", [1, 3, 50, 129, 1000])
def test_triangles_are_those_of_numpy_in_any_layout(rows: int, columns: int) -> None:
    rng = np.random.default_rng(rows + columns)
    one = rng.standard_normal((20, columns))
    room = rng.standard_normal((columns, 2 * rows + 3)) * 10.0 ** rng.uniform(-3, 3, (columns, 1))
    for more in (room[:, 1 : rows + 1].T, room.T[:rows], np.ascontiguousarray(room.T[:rows]), room[:, :: -2].T[:rows]):
        R, stacked = folded(one, more), np.vstack([one, more])
        if len(stacked) <= columns:
            np.testing.assert_array_equal(R, stacked)
            continue
        assert np.all(np.tril(R, -1) == 0)
        size = np.linalg.norm(stacked, axis=0)
        np.testing.assert_allclose(signed(R / size), signed(np.linalg.qr(stacked / size, mode="r")), rtol=0, atol=1e-12)


@pytest.mark.usefixtures("vectors")
def test_small_directions_keep_their_size_beside_large_ones() -> None:
    # the products of the columns would have lost what is 1e-9 of them
    rng = np.random.default_rng(1)
    base = rng.standard_normal((5000, 9))
    rows = base[:, [0, 1, 2, 3, 4, 5, 6, 7, 0]]
    rows[:, 8] += 1e-9 * base[:, 8]
    R = signed(folded(rows[:2500], rows[2500:]))
    assert R[8, 8] == pytest.approx(signed(np.linalg.qr(rows, mode="r"))[8, 8], rel=1e-5)


@pytest.mark.usefixtures("vectors")
def test_bands_at_places_with_columns_of_zeros() -> None:
    rng = np.random.default_rng(2)
    rows = rng.standard_normal((900, 6))
    rows[:, [0, 4]] = 0.0
    edges = [0, 0, 2, 7, 40, 500]
    one, other = triangle.Triangles(5, 6), triangle.Triangles(5, 6)
    assert one.empty
    wanted: list[list[np.ndarray]] = [[] for _ in range(5)]
    for made in (one, other, other):
        places = np.sort(rng.choice(900, 500, replace=False))
        made.fold(rows.T.copy().T, edges, places)
        for band, (own, first, end) in enumerate(zip(wanted, edges, edges[1:], strict=False)):
            own.append(rows[places[first:end]])
            assert len(made[band]) <= 6
    before = one.copy()
    one.add(other)
    for band, own in enumerate(wanted):
        for some, stacked in ((one, np.vstack(own)), (before, own[0])):
            np.testing.assert_allclose(some[band].T @ some[band], stacked.T @ stacked, rtol=0, atol=1e-11)
            assert np.all(some[band][:, [0, 4]] == 0)
    assert len(one[0]) == 0
    assert not one.empty


@pytest.mark.usefixtures("vectors")
def test_what_is_no_number_is_not_lost() -> None:
    rows = np.random.default_rng(3).standard_normal((400, 5))
    rows[77, 2] = np.nan
    assert np.any(np.isnan(folded(rows)))
