"""Distances of a machine's parts are those of dense points, and what is built close is left out."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from hydroopt import Model, load_machine
from hydroopt.limits.parts import Part, distance, distance_to_point, pairs


def part(start: np.ndarray, end: np.ndarray) -> Part:
    return Part("part", ca.SX(ca.DM(start)), ca.SX(ca.DM(end)), 0.0, "part", frozenset())


@pytest.mark.parametrize("seed", range(20))
def test_distance_is_that_of_dense_points(seed: int) -> None:
    rng, share = np.random.default_rng(seed), np.linspace(0, 1, 801)[:, None]
    a, b, c, d = rng.uniform(-1, 1, (4, 3))
    if seed % 4 == 1:
        d = c + (b - a) * rng.uniform(0.5, 2)  # parallel
    if seed % 4 == 2:
        b = a  # no length
    if seed % 4 == 3:
        a[2] = b[2] = c[2] = d[2] = 0.0  # in a plane, where they may cross
    one, other = a + share * (b - a), c + share * (d - c)
    dense = np.min(np.linalg.norm(one[:, None] - other[None], axis=2))
    assert float(ca.DM(distance(part(a, b), part(c, d)))) == pytest.approx(dense, abs=3e-3)
    point = rng.uniform(-1, 1, 3)
    assert float(ca.DM(distance_to_point(part(a, b), ca.SX(ca.DM(point))))) == pytest.approx(
        np.min(np.linalg.norm(one - point, axis=1)), abs=3e-3)


@pytest.mark.parametrize(("name", "watched", "left_out"), [
    ("backhoe", [("boom", "bucket")], [("rocker", "bucket"), ("stick", "coupler"), ("boom", "stick")]),
    ("knuckle_boom_crane", [("telescope", "main_cylinder")], [("main", "knuckle"), ("knuckle", "telescope")]),
    ("cat215b", [], [("swing", "stick")])])
def test_parts_that_may_meet_are_watched(name: str, watched: list, left_out: list) -> None:
    found = {(one.name, other.name) for one, other in pairs(Model(load_machine(name)), 0.6)}
    assert set(watched) <= found
    assert not set(left_out) & found
