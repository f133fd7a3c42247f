"""What people beside a machine keep: nobody within its largest reach, and stops between the plan and the limits."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

import hydroopt as ho
from hydroopt.control.valve_test import valve_test
from hydroopt.excitation.motion.approach import approach
from hydroopt.excitation.motion.basis import Fourier
from hydroopt.excitation.motion.excitation import Excitation
from hydroopt.excitation.motion.random_motion import random_motion, resting_posture
from hydroopt.limits.limits import MARGIN, Limits
from hydroopt.limits.reserves import Reserves
from hydroopt.limits.watch import ROWS, largest_reach, reach, watch
from hydroopt.model.scene_graph import SceneGraph

MACHINES = ("excavator_bucket", "tampere_manipulator", "wheel_loader")


def away(scene: SceneGraph, q: np.ndarray) -> float:
    """Distance of the farthest far end of a link from the vertical, by matrices of the machine's picture."""
    poses = scene.poses(dict(zip(scene.columns, np.asarray(scene.closure(q)).ravel(), strict=False)))
    ends = np.array([(poses[body.name] @ [*body.far, 1.0])[:2] for body in scene.bodies])
    return float(np.max(np.linalg.norm(ends, axis=1)))


@pytest.mark.parametrize("name", [*MACHINES, "forestry_crane"])
def test_nobody_stands_where_the_machine_can_reach(name: str) -> None:
    """An oracle of other parts: matrices of the picture, random positions, and a search from the best of them."""
    machine, scene = ho.load_machine(name), SceneGraph(ho.load_machine(name))
    ranges = [machine.link(joint).joint.range for joint in machine.joints]
    low, high = np.array(ranges).T
    drawn = np.random.default_rng(2).uniform(low, high, (200, len(low)))
    best = max(drawn, key=lambda q: away(scene, q))
    found = minimize(lambda q: -away(scene, np.clip(q, low, high)), best, method="Powell", bounds=ranges,
                     options={"maxfev": 200})
    largest = largest_reach(ho.Model(machine)).radius
    assert -found.fun - 1e-4 < largest < -found.fun + 1.5


@pytest.fixture(scope="module", params=MACHINES)
def motion(request: pytest.FixtureRequest) -> Excitation:
    problem = ho.excitation_problem(ho.load_machine(request.param), Fourier(period=6.0, harmonics=2), rate=20)
    rng = np.random.default_rng(1)
    return Excitation(problem, random_motion(problem, resting_posture(problem, rng), rng))


def test_a_motion_is_stopped_beyond_the_plan_and_within_the_limits(motion: Excitation) -> None:
    model, reserves = motion.problem.limits.model, motion.problem.limits.reserves
    limits = {row.name: row for row in motion.problem.limits.without_reserves().rows}
    stopped = [use for use in motion.limits if use.margin]
    assert {use.name for use in stopped} >= {f"{joint} position" for joint in model.machine.joints}
    for use in stopped:
        below, above = use.stop
        assert limits[use.name].lower - 1e-9 <= below <= use.lowest - use.margin + 1e-9
        assert use.highest + use.margin - 1e-9 <= above <= limits[use.name].upper + 1e-9
    for joint in model.machine.joints:
        low, high = model.machine.link(joint).joint.range
        margin = next(use.margin for use in stopped if use.name == f"{joint} position")
        assert margin == pytest.approx(MARGIN * reserves.tracking * (high - low))


def test_a_sheet_has_few_values_that_people_see_most_urgent_first(motion: Excitation) -> None:
    watch = motion.watch
    assert 0 < len(watch.stops) <= ROWS
    assert {each.unit for each in watch.stops} <= {"deg", "mm"}
    hidden = ("pressure", "p_", "torque", "tipping", "speed")
    assert not any(word in each.name for each in watch.stops for word in hidden)
    uses = {use.name: use for use in motion.limits}
    left = [uses[each.name].room / uses[each.name].margin for each in watch.stops]
    assert left == sorted(left)
    assert watch.distance >= watch.largest.radius + 2.0
    assert watch.planned.radius <= watch.largest.radius + 1e-6


def test_resting_joints_may_rest_at_the_end_of_their_range() -> None:
    machine = ho.load_machine("tampere_manipulator")
    end = machine.link("telescope").joint.range[0]
    problem = ho.excitation_problem(machine, Fourier(period=6.0, harmonics=2), rate=20, resting={"telescope": end})
    margins = {row.name: row.margin for row in problem.limits.rows}
    assert margins["telescope position"] == 0 < margins["lift position"]
    assert resting_posture(problem, np.random.default_rng(0)) is not None


def test_a_margin_that_is_larger_pulls_the_plan_in() -> None:
    model = ho.Model(ho.load_machine("tampere_manipulator"))
    narrow, wide = (Limits(model, Reserves(tracking=each)) for each in (0.02, 0.001))
    for one, other in zip(narrow.rows, wide.rows, strict=True):
        assert (one.lower, -one.upper) >= (other.lower, -other.upper)
        if one.unit in ("m", "rad"):
            assert one.margin == pytest.approx(20 * other.margin)


def test_sections_that_move_together_are_one_line() -> None:
    sheet = valve_test(ho.Plant(ho.load_machine("forestry_crane"))).watch
    assert [each.name for each in sheet.stops if "first" in each.name] == ["first (with second) position"]
    assert not any(each.name.startswith("second") for each in sheet.stops)


def test_an_approach_is_planned_where_parts_come_near_each_other_within_the_reserve_alone() -> None:
    limits = Limits(ho.Model(ho.load_machine("tampere_manipulator")))
    assert [row.name for row in limits.rows] == [row.name for row in limits.without_reserves().rows]
    found = approach(limits, np.array([0.4, -1.0, 0.3]), np.array([0.6, -1.2, 0.5]), 20.0)
    np.testing.assert_allclose(found.trajectory.q[-1], [0.6, -1.2, 0.5])


@pytest.mark.parametrize(("name", "above", "ground"), [
    ("cat215b", "above the ground", -1.7), ("kr300", "above the origin of the base frame", 0.0)])
def test_heights_are_above_what_they_say(name: str, above: str, ground: float) -> None:
    model = ho.Model(ho.load_machine(name))
    assert (model.machine.ground or 0.0) == ground
    q = np.zeros((1, len(model.machine.joints)))
    told = watch(model, reach(model, q), (), Reserves())
    assert told.largest.highest == pytest.approx(largest_reach(model).highest - ground)
    assert f"reach up to {told.largest.highest:.2f} m {above}" in told.rules[1]
