"""Postures at rest keep reserves: against pins and masses put together here, without the limits' own expressions."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from hydroopt import KinematicModel, Model, Poses, load_machine, read_machine
from hydroopt.checks.postures import check_postures
from hydroopt.errors import ProblemError
from hydroopt.excitation.selection.candidate_postures import in_safe_order
from hydroopt.excitation.selection.exchange import fedorov_exchange
from hydroopt.excitation.selection.pose_plan import PosePlan
from hydroopt.excitation.selection.pose_problem import PoseGroup, Postures, pose_problem
from hydroopt.limits.limits import Limits
from hydroopt.limits.postures import PostureLimits
from hydroopt.limits.reserves import DEFAULT, Reserves
from hydroopt.machine.machine import Machine

SURVEYED = '''
based_on = "excavator_bucket"
[tracker]
[calibrator]
parent = "bucket"
[[links]]
name = "boom"
joint = { a = { value = "6.2354 m", sigma = "15 mm" } }
[[obstacles]]
name = "tree"
link = "base"
centre = ["6 m", "2.5 m", "2 m"]
radius = "1 m"
[[obstacles]]
name = "lamp"
link = "boom"
centre = ["4 m", "-0.5 m", "0 m"]
radius = "0.2 m"
[[sensors]]
channels = ["swing.q", "boom.q", "stick.q", "bucket.q"]
accuracy = "0.1 deg"
[[sensors]]
channels = ["tip.x", "tip.y", "tip.z"]
accuracy = "5 mm"
'''
CHASSIS = '''
based_on = "cat215b"
[footprint]
corners = [["-1.65 m", "-1.2 m"], ["1.65 m", "-1.2 m"], ["1.65 m", "1.2 m"], ["-1.65 m", "1.2 m"]]
mass = { value = "6500 kg", sigma = "8 %" }
com = { value = ["0 m", "0.1 m", "-1.2 m"], sigma = "0.1 m" }
'''


def frames(machine: Machine, q: np.ndarray) -> dict[str, np.ndarray]:
    """(4, 4) of each link of a serial machine at its joint, by Eq. 3.8, and at its far end as ``name end``."""
    made = {"base": np.eye(4), "base end": np.eye(4)}

    def turn(axis: int, angle: float) -> np.ndarray:
        found, (a, b) = np.eye(4), [k for k in range(3) if k != axis]
        found[[a, b], [a, b]] = np.cos(angle)
        found[[b, a], [a, b]] = np.array([1, -1]) * np.sin(angle) * (-1 if axis == 1 else 1)
        return found

    def shift(axis: int, by: float) -> np.ndarray:
        found = np.eye(4)
        found[axis, 3] = by
        return found

    at = dict(zip(machine.joints, q, strict=True))
    for link in machine.links:
        joint = link.joint
        if link.parent not in made or (joint.moving and link.name not in at):
            continue  # of a linkage
        value = at.get(link.name, 0.0)
        theta, d = (joint.theta, joint.d + value) if joint.type == "prismatic" else (joint.theta + value, joint.d)
        made[link.name] = made[f"{link.parent} end"] @ shift(2, d) @ turn(2, theta)
        made[f"{link.name} end"] = made[link.name] @ shift(0, joint.a) @ turn(0, joint.alpha) @ turn(1, joint.beta)
    return made


def least(machine: Machine, q: np.ndarray) -> dict[str, float]:
    """Room above ground and to obstacles of a machine's own links in a posture, by 400 points on each."""
    at, found = frames(machine, q), dict[str, float]()
    for name in machine.joints:
        start, end = at[name][:3, 3], at[f"{name} end"][:3, 3]
        if machine.ground is not None and name != "swing":
            found[f"{name} above ground"] = end[2] - machine.ground
        for obstacle in machine.obstacles:
            parent = machine.link(name).parent
            if name == obstacle.link or np.allclose(start, end):
                continue
            centre = (at[obstacle.link] @ [*obstacle.centre, 1.0])[:3]
            share = np.linspace(0.5 if parent == obstacle.link else 0.0, 1.0, 400)[:, None]
            away = np.linalg.norm(start + share * (end - start) - centre, axis=1)
            found[f"{name} {obstacle.name}"] = float(np.min(away)) - obstacle.radius
    return found


@cache
def machine_of(text: str) -> Machine:
    return read_machine(text)


def planned(machine: Machine, reserves: Reserves = DEFAULT, count: int = 6) -> PosePlan:
    return fedorov_exchange(pose_problem(machine, count, reserves=reserves), candidates=40)


@cache
def surveyed() -> tuple[Machine, PosePlan]:
    machine = machine_of(SURVEYED)
    return machine, planned(machine)


def test_planned_postures_keep_their_distance_from_ground_and_obstacles() -> None:
    machine, plan = surveyed()
    assert min(min(least(machine, each).values()) for each in plan.q) > 0.3 - 1e-6
    assert plan.left_out.out > 0
    assert plan.left_out.sentence in plan.sheet()


@pytest.mark.slow
def test_other_reserves_are_kept_and_without_limits_postures_dig_into_the_ground() -> None:
    machine = machine_of(SURVEYED)
    plan = planned(machine, reserves=Reserves(clearance=0.8))
    assert min(min(least(machine, each).values()) for each in plan.q) > 0.8 - 1e-6
    # poses on two sides of the tree
    machine, plan = surveyed()
    q = plan.q.copy()
    q[:2] = [[0.75, 0.3, -1.1, -0.4], [-0.05, 0.3, -1.1, -0.4]]
    there = replace(plan, driven=Postures(plan.problem, q))
    path = [least(machine, q[0] + s * (q[1] - q[0])) for s in np.linspace(0, 1, 200)]
    assert {"distance of stick to tree"} <= set(there.detours[2])
    assert min(each["stick tree"] for each in path) < 0.3
    assert "1 to 2" in there.ways
    bare = machine.model_copy(update={"ground": None, "obstacles": ()})
    unaware = [least(machine, each) for each in planned(bare).q]
    assert min(min(each.values()) for each in unaware) < 0


def test_every_posture_is_judged_as_by_points_on_its_links() -> None:
    machine = machine_of(SURVEYED)
    kept = PostureLimits(KinematicModel(machine), Reserves(tracking=0.0))
    low, high = machine.ranges.T
    q = np.random.default_rng(3).uniform(low, high, (600, len(low)))
    broken = kept.broken(q)
    assert {row.name for row in kept.limits.rows} == set(broken)
    rooms = [least(machine, each) for each in q]
    for name in ("boom above ground", "stick above ground", "bucket above ground"):
        np.testing.assert_array_equal(broken[name], [each[name] < 0.3 for each in rooms])
    for link, obstacle in (("boom", "tree"), ("stick", "tree"), ("bucket", "tree"), ("bucket", "lamp")):
        room = np.array([each[f"{link} {obstacle}"] for each in rooms])
        clear = np.abs(room - 0.3) > 1e-3  # of points
        found = broken[f"distance of {link} to {obstacle}"]
        np.testing.assert_array_equal(found[clear], (room < 0.3)[clear])
        assert found.any()


def test_machines_without_surroundings_leave_nothing_out() -> None:
    plan = planned(load_machine("panda_mukca"), count=12, reserves=Reserves(tracking=0.0))
    assert plan.left_out.out == 0
    assert "All" in plan.left_out.sentence
    assert not plan.detours


@pytest.mark.slow
def test_touching_the_ground_is_no_breach_and_the_rest_keeps_away() -> None:
    machine = read_machine(SURVEYED + '''
[[datums]]
name = "floor"
[[sensors]]
channels = ["floor.tip.z"]
accuracy = "5 mm"
''')
    plan = planned(machine)
    touching = plan.driven.touch != ""
    assert touching.any()
    for q, touches in zip(plan.q, touching, strict=True):
        room = least(machine, q)
        assert room["stick above ground"] > 0.3 - 1e-6
        assert (abs(room["bucket above ground"]) < 1e-6) if touches else (room["bucket above ground"] > 0.3 - 1e-6)


def test_straight_moves_are_judged_on_the_way_and_the_order_avoids_them() -> None:
    """Between two sides of a tree in front of the machine the way is round, over it."""
    machine = read_machine(SURVEYED.replace('"6 m", "2.5 m", "2 m"', '"6.5 m", "0 m", "1.5 m"').replace(
        'radius = "1 m"', 'radius = "1.3 m"'))
    kept = PostureLimits(KinematicModel(machine), Reserves(tracking=0.0))
    left, right, above = [0.5, 0.66, -1.35, -0.51], [-0.5, 0.66, -1.35, -0.51], [0.0, 0.63, -0.66, -1.45]
    q = np.array([left, right, above])
    assert not any(np.any(each) for each in kept.broken(q).values())
    used = kept.move(q[0], q[1])
    path = [least(machine, q[0] + s * (q[1] - q[0])) for s in np.linspace(0, 1, 200)]
    assert {f"distance of {name} to tree" for name in ("boom", "stick", "bucket")
            if min(each[f"{name} tree"] for each in path) < 0.3} == {name for name in used if "tree" in name}
    assert used
    order = in_safe_order(kept, PoseGroup("", "", (), {}, False), q)
    assert order.tolist() in ([0, 2, 1], [1, 2, 0])


def test_too_few_postures_are_refused_with_what_leaves_them_out() -> None:
    machine = machine_of(SURVEYED)
    with pytest.raises(ProblemError, match=r"keep the reserves; left out by .*above ground .*--reserve"):
        planned(machine, reserves=Reserves(clearance=12.0))


def test_a_table_of_poses_is_checked_and_a_plan_passes() -> None:
    machine, plan = surveyed()
    assert not any(each.broken or each.short for each in check_postures(machine, plan.postures).poses)
    names = [f"{joint}.q" for joint in machine.joints]
    q = np.array([[0.0, -0.3, -0.6, 0.0], [-0.37, 0.72, -1.57, -1.28], [0.0, np.nan, -1.8, -0.4]])
    room = [least(machine, each) for each in q[:2]]
    found = check_postures(machine, Poses("own", channels=dict(zip(names, q.T, strict=True))))
    assert [each.judged for each in found.poses] == [True, True, False]
    assert set(found.poses[0].broken) >= {name for name, each in room[0].items() if "ground" in name and each < 0}
    assert found.poses[0].broken
    assert not found.poses[1].broken + found.poses[1].short
    assert str(found.status) == "suspect"
    with pytest.raises(ProblemError, match="no pose states the positions of all joints"):
        check_postures(machine, plan.poses)


def test_what_holds_the_machine_counts_the_uncertain_chassis() -> None:
    """20,000 draws of chassis and bodies as point masses: all edges keep their moment in 99 % of them, each edge as
    often as Bonferroni's inequality says."""
    machine = read_machine(CHASSIS)
    model, foot, rng = Model(machine), machine.footprint, np.random.default_rng(1)
    assert foot is not None
    limits, q = Limits(model), np.array([[0.6, -0.4, 1.5]])
    rows = [k for k, row in enumerate(limits.rows) if row.name.startswith("tipping")][:4]
    promised = (limits.values(q, 0 * q, 0 * q) * limits.scale)[0, rows]
    psi = limits.known.mean + rng.standard_normal((20000, limits.known.root.shape[1])) @ limits.known.root.T
    mass = foot.mass * (1 + 0.08 * rng.standard_normal(20000))
    first = mass[:, None] * (np.array(foot.com) + 0.1 * rng.standard_normal((20000, 3)))
    for owner, block in model.parameters.bodies.items():
        pose = model.dynamics.body_motion(owner).pose
        turned, place = (np.asarray(model.over(function(model, each), q)[0])[0]
                         for each in (pose.rotation, pose.origin))
        mass = mass + psi[:, block.start]
        first = first + psi[:, block.start + 1: block.start + 4] @ turned.T + psi[:, block.start, None] * place[:, 0]
    corners = np.array([[*corner, machine.ground] for corner in foot.corners])
    for k, corner in enumerate(corners):
        along = corners[(k + 1) % 4] - corner
        away = first - mass[:, None] * corner
        # the weight's arm from the edge, to the left of its direction
        holding = machine.gravity * (along[0] * away[:, 1] - along[1] * away[:, 0]) / np.linalg.norm(along)
        assert np.mean(holding < promised[k]) == pytest.approx(0.0025, abs=0.0012)
        exact = Limits(Model(load_machine("cat215b")))
        assert promised[k] < (exact.values(q, 0 * q, 0 * q) * exact.scale)[0, rows[k]] + 2e4


def function(model: Model, value: object) -> object:
    import casadi as ca

    return ca.Function("value", [model.coordinates.q], [ca.densify(value)])
