"""Distances of a machine's parts are those of dense points, and what is built close is left out."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np
import pytest

from fixtures.tiers import tiered
from hydroopt import Model, load_machine, read_machine
from hydroopt.errors import MachineError
from hydroopt.limits.limits import Limits
from hydroopt.limits.parts import Part, distance, distance_to_point, pairs, parts
from hydroopt.machine.machine_file import bundled
from hydroopt.model.scene_graph import SceneGraph


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


def beside(name: str, balls: Sequence[tuple[float, float, float]], extra: str = "") -> Limits:
    """The limits of a bundled machine beside balls of 0.2 m that stand on its base."""
    obstacles = "".join(
        f'[[obstacles]]\nname = "ball{k}"\nlink = "base"\ncentre = ["{x} m", "{y} m", "{z} m"]\nradius = "0.2 m"\n'
        for k, (x, y, z) in enumerate(balls))
    return Limits(Model(read_machine(f'based_on = "{name}"\nname = "beside"\n{extra}\n{obstacles}')))


def shown(limits: Limits, name: str, q: list[float]) -> np.ndarray:
    """Values of the rows of a name at a posture."""
    values = np.asarray(limits.function(q, 0 * np.array(q), 0 * np.array(q))).ravel()
    return np.array([value for row, value in zip(limits.rows, values, strict=True) if row.name == name])


def test_a_scissor_lifts_platform_reaches_as_far_as_its_roller() -> None:
    """Arms of 2 m: the platform stands 2·sin(left) high, from above the left pivot to where the roller goes."""
    left, reach = 0.7, 2 * np.cos(np.radians(12))
    height = 2 * np.sin(left)
    limits = beside("scissor_lift", [(along, height + 0.5, 0.0) for along in (1.0, reach, reach + 0.3)])
    for ball, apart in enumerate((0.5, 0.5, np.hypot(0.3, 0.5))):
        assert shown(limits, f"distance of platform to ball{ball}", [left]) == pytest.approx(apart - 0.2, abs=1e-5)
    higher = 2 * np.sin(0.8)
    assert shown(limits, "distance of platform to ball0", [0.8]) == pytest.approx(height + 0.3 - higher, abs=1e-5)


def test_a_telescopes_section_is_a_part_inside_the_stick() -> None:
    """Boom level and telescope straight down at x = 3.4 m: the section's end is 1.1 times its travel of 1.4 m above."""
    q = [0.0, 0.0, -np.pi / 2, 0.5, 0.0, 0.0, 0.0]
    limits = beside("forestry_crane", [(3.9, 0.0, 0.3), (3.9, 0.0, 1.9 - 2.5 + 1.54 + 0.4)])
    for ball, apart in enumerate((0.5, np.hypot(0.4, 0.5))):
        assert shown(limits, f"distance of first to ball{ball}", q) == pytest.approx(apart - 0.2, abs=1e-6)


@pytest.mark.parametrize("name", ["forestry_crane", "knuckle_boom_crane"])
def test_the_outer_ends_of_telescopes_stay_above_ground(name: str) -> None:
    """By forward kinematics, whichever end of a section is the lower one."""
    limits = beside(name, [], 'ground = "-20 m"')
    model, machine = limits.model, limits.model.machine
    low, high = machine.ranges.T
    q = np.random.default_rng(1).uniform(low, high)
    for link, pose in zip(machine.links, model.over(model.forward_kinematics, q[None]), strict=True):
        if link.joint.type == "prismatic":
            height = pose[0, 2, 3] + 20.0
            assert np.min(np.abs(shown(limits, f"{link.name} above ground", q.tolist()) - height)) < 1e-9


@pytest.fixture(scope="module")
def pins() -> np.ndarray:
    """Those of the platform: pairs on a circle of 1.6 m, 0.2 m apart, two of them 120 degrees from the first."""
    first = np.array([[np.sqrt(1.6**2 - 0.1**2), side] for side in (0.1, -0.1)])
    return np.vstack([first @ np.array([[c, s], [-s, c]]) for c, s in (
        (np.cos(a), np.sin(a)) for a in (0.0, 2 * np.pi / 3, -2 * np.pi / 3))])


def test_a_platform_on_six_cylinders_is_drawn_from_pin_to_pin(pins: np.ndarray) -> None:
    body = SceneGraph(load_machine("stewart_platform")).bodies[-1]
    ends = body.lines[:, 0]
    np.testing.assert_array_equal(body.lines[:, 1], np.roll(ends, -1, axis=0))
    apart = np.linalg.norm(ends[:, None] - np.column_stack([pins, np.zeros(6)]), axis=2)
    assert np.max(np.min(apart, axis=1)) < 1e-4
    assert len(ends) == 6


@pytest.mark.slow
def test_limits_know_how_wide_that_platform_is(pins: np.ndarray) -> None:
    limits = beside("stewart_platform", [(0.0, 1.0, 2.9)], 'ground = "0 m"')
    for pitch, roll in ((0.1, 0.0), (0.0, 0.1)):
        heights = shown(limits, "platform above ground", [0.0, 0.0, 2.3, 0.0, pitch, roll])
        expected = 2.3 - np.sin(pitch) * pins[:, 0] + np.sin(roll) * pins[:, 1]
        np.testing.assert_allclose(np.sort(heights), np.sort(expected), atol=1e-4)
    left = pins[pins[:, 1] > 0]  # the nearest of six edges joins the first pair and the second
    edge = left[[np.argmax(left[:, 0]), np.argmax(left[:, 1])]]
    dense = np.hstack([edge[0] + np.linspace(0, 1, 20001)[:, None] * (edge[1] - edge[0]), np.full((20001, 1), 2.3)])
    near = shown(limits, "distance of platform to ball0", [0.0, 0.0, 2.3, 0.0, 0.0, 0.0])
    assert near.min() == pytest.approx(np.min(np.linalg.norm(dense - [0.0, 1.0, 2.9], axis=1)) - 0.2, abs=1e-4)


@pytest.mark.parametrize("name", tiered(bundled(), lambda name: name in ("forestry_crane", "scissor_lift")))
def test_parts_are_what_the_picture_shows(name: str) -> None:
    model = Model(load_machine(name))
    drawn = {body.name: np.vstack([body.points, *([] if body.section is None else [body.section])])
             for body in model.scene_graph.bodies}
    for body in model.scene_graph.bodies:
        ends = np.vstack([body.lines.reshape(-1, 3), *([] if body.section is None else [body.section])])
        assert all(np.min(np.linalg.norm(drawn[body.name] - end, axis=1)) < 1e-6 for end in ends)
    assert {each.link for each in parts(model) if each.link} <= set(drawn)


def test_a_ground_beside_the_vertical_is_refused() -> None:
    """The Tampere manipulator's base has its y axis up: no height along z would ever be below such a ground."""
    with pytest.raises(MachineError, match=r"ground: .* z axis, which points 90 deg away from upwards; describe"):
        beside("tampere_manipulator", [], 'ground = "-1 m"')


@pytest.mark.parametrize(("centre", "built_close"), [((1.0, 1.2, 1.5), False), ((1.0, 0.5, 0.5), True)])
def test_a_boom_keeps_away_from_a_cab_on_its_own_platform(centre: tuple[float, ...], built_close: bool) -> None:
    """All of its line counts, and the cylinder that is pinned there, unless the cab is built close to them."""
    x, y, z = centre
    limits = Limits(Model(read_machine(
        'based_on = "excavator_bucket"\nname = "beside"\n[[obstacles]]\nname = "cab"\nlink = "swing"\n'
        f'centre = ["{x} m", "{y} m", "{z} m"]\nradius = "0.8 m"\n')))
    boom = np.linspace(-0.5, 0.7, 25)
    q = np.column_stack([0 * boom, boom, -1.2 + 0 * boom, -0.4 + 0 * boom])
    named = [row.name for row in limits.rows]
    found = limits.values(q, 0 * q, 0 * q)[:, named.index("distance of boom to cab")]
    of_whole = np.hypot(y, z * np.cos(boom) - x * np.sin(boom)) - 0.8  # the boom's foot is the platform's origin
    assert np.allclose(found, of_whole, atol=1e-6) is not built_close
    assert np.all(found > of_whole - 1e-6)
    assert ("distance of boom_cylinder to cab" in named) is not built_close
