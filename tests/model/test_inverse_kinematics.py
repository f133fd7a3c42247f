"""Inverse kinematics: every branch leads to its target by a second derivation, and none is missing."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from fixtures.tiers import ONE_OF_A_KIND, tiered
from hydroopt.errors import ProblemError
from hydroopt.machine.geometry import Geometry
from hydroopt.machine.machine_file import bundled, load_machine
from hydroopt.model.inverse_kinematics import ALIKE, inverse_kinematics
from hydroopt.model.model import Model
from oracles import subjects
from oracles.complex_machine import ComplexMachine

Array = np.ndarray


@cache
def model(name: str) -> Model:
    return Model(subjects.machine(name))


def pose(subject: Model, q: Array) -> Array:
    """Pose (4, 4) of the tip by the second derivation, or by the model where dependent joints carry it."""
    machine = subject.machine
    if any(machine.link(name).joint.dependent for name in machine.ancestry(machine.tip)):
        place = [link.name for link in machine.links].index(machine.tip)
        return subject.over(subject.forward_kinematics, q[None])[place][0]
    zero = np.zeros(len(q))
    return ComplexMachine(subject.machine).frames(q, zero, zero)[1][subject.machine.tip].value.real


def turned(a: Array, b: Array) -> float:
    """Largest difference of two postures, whole turns aside."""
    return float(np.max(np.abs(np.arctan2(np.sin(a - b), np.cos(a - b)))))


def free(subject: Model) -> list[str]:
    """The first joints that move the tip independently of each other: at most three, fewer of a planar machine."""
    q = subjects.states(subject.machine, np.random.default_rng(10), 1)[0]
    J, found = subject.over(subject.tip_jacobian, q)[0][0, :3], []
    for k in range(len(subject.machine.joints)):
        if np.linalg.matrix_rank(J[:, [*found, k]], tol=1e-6) > len(found):
            found.append(k)
    return [subject.machine.joints[k] for k in found]


@pytest.mark.parametrize("name", tiered(
    [*bundled(), "made_up"], lambda name: name in (*ONE_OF_A_KIND, "ur10", "made_up")))
def test_every_branch_brings_the_tip_there_and_the_first_posture_is_one(name: str) -> None:
    """The place of the tip, by the first joints that move it independently; all others are held."""
    subject, rng = model(name), np.random.default_rng(11)
    moving = free(subject)
    for q in subjects.states(subject.machine, rng, 6)[0]:
        held = {joint: q[k] for k, joint in enumerate(subject.machine.joints) if joint not in moving}
        target = pose(subject, q)[:3, 3]
        postures = inverse_kinematics(subject, target, held=held)
        for each in postures:
            assert np.linalg.norm(pose(subject, each.q)[:3, 3] - target) < 1e-9
            for joint, value in held.items():
                assert each.q[subject.machine.joints.index(joint)] == value
        assert min(turned(each.q, q) for each in postures) < ALIKE


@pytest.mark.parametrize("name", ["ur10", "kr300"])
def test_pose_of_six_joints(name: str) -> None:
    subject, rng = model(name), np.random.default_rng(12)
    for q in subjects.states(subject.machine, rng, 2)[0]:
        target = pose(subject, q)
        postures = inverse_kinematics(subject, target[:3, 3], target[:3, :3])
        for each in postures:
            assert np.max(np.abs(pose(subject, each.q) - target)) < 1e-8
        assert min(turned(each.q, q) for each in postures) < ALIKE
        assert len(postures) in (2, 4, 6, 8)


@pytest.mark.slow
def test_more_starts_find_no_more_branches() -> None:
    subject, rng = model("ur10"), np.random.default_rng(13)
    for q in subjects.states(subject.machine, rng, 10)[0]:
        target = pose(subject, q)
        few, many = (inverse_kinematics(subject, target[:3, 3], target[:3, :3], starts=n) for n in (256, 2048))
        assert len(few) == len(many)


def branches_of_cat215b(place: Array) -> int:
    """Number of branches by the triangle of boom and stick, whose axes are parallel and across that of the swing."""
    joints = {link.name: link.joint for link in model("cat215b").machine.links}
    upper, lower, offset = joints["boom"].a, joints["stick"].a, joints["boom"].d
    out = np.hypot(*place[:2])**2 - offset**2
    if out < 0:
        return 0
    count = 0
    for reach in (np.sqrt(out), -np.sqrt(out)):
        distance = np.hypot(reach - joints["swing"].a, place[2])
        count += 2 * (abs(upper - lower) < distance < upper + lower)
    return count


@pytest.mark.slow
def test_no_branch_of_an_excavator_is_missing() -> None:
    subject, rng = model("cat215b"), np.random.default_rng(14)
    counts = []
    for place in rng.uniform(-7.5, 7.5, (40, 3)) * [1, 1, 0.6]:
        expected = branches_of_cat215b(place)
        counts.append(expected)
        if expected:
            postures = inverse_kinematics(subject, place)
            assert len(postures) == expected
            assert all(np.linalg.norm(pose(subject, each.q)[:3, 3] - place) < 1e-9 for each in postures)
        else:
            with pytest.raises(ProblemError, match="no posture brings the tip"):
                inverse_kinematics(subject, place)
    assert {0, 2, 4} <= set(counts)


def test_unreachable_target_says_how_near_the_tip_comes() -> None:
    subject = model("cat215b")
    joints = {link.name: link.joint for link in subject.machine.links}
    whole = joints["boom"].a + joints["stick"].a + joints["swing"].a
    nearest = 12.0 - np.hypot(whole, joints["boom"].d)
    with pytest.raises(ProblemError, match=rf"is {nearest:.3g} m away; choose a target within reach") as caught:
        inverse_kinematics(subject, np.array([12.0, 0.0, 0.0]))
    assert "(12, 0, 0) m" in caught.value.what


def test_limits_strokes_and_dead_points_are_reported() -> None:
    subject = model("cat215b")
    machine = subject.machine
    boom, offset = machine.cylinders[0], float(Geometry(machine).triangle(machine.cylinders[0])[1].offset)
    dead = np.array([0.3, -offset, 1.4])  # pins and axis in one line: the shortest length
    found = {True: [], False: []}
    for each in inverse_kinematics(subject, pose(subject, dead)[:3, 3]):
        found[turned(each.q, dead) < ALIKE].append(each)
    (one,) = found[True]
    assert one.dead_points == (boom.name,)
    assert one.beyond_stroke[boom.name] < 0
    assert not one.reachable
    aside = np.array([0.0, 0.3, 0.0])
    sides = [next(each for each in inverse_kinematics(subject, pose(subject, q)[:3, 3]) if turned(each.q, q) < ALIKE)
             for q in (dead + aside, dead - aside)]
    assert sorted(boom.name in each.past_dead_points for each in sides) == [False, True]
    lower, upper = machine.link("boom").joint.range
    beyond = next(each for each in inverse_kinematics(subject, pose(subject, np.array([0.3, upper + 0.1, 1.4]))[:3, 3])
                  if turned(each.q, np.array([0.3, upper + 0.1, 1.4])) < ALIKE)
    assert dict(beyond.outside) == pytest.approx({"boom": 0.1}, abs=1e-6)
    inside = inverse_kinematics(subject, pose(subject, np.array([0.3, (lower + upper) / 2, 1.4]))[:3, 3])
    assert inside[0].reachable
    assert not inside[0].singular


def test_stretched_arm_is_singular() -> None:
    subject = model("cat215b")
    postures = inverse_kinematics(subject, pose(subject, np.array([0.3, -0.2, 0.0]))[:3, 3])
    assert any(each.singular and turned(each.q, np.array([0.3, -0.2, 0.0])) < 1e-3 for each in postures)


def test_axes_that_meet_leave_infinitely_many_postures() -> None:
    subject = model("panda")
    q = subjects.states(subject.machine, np.random.default_rng(15), 1)[0][0]
    with pytest.raises(ProblemError, match="infinitely many postures"):
        inverse_kinematics(subject, pose(subject, q)[:3, 3],
                           held=dict(zip(subject.machine.joints[3:], q[3:].tolist(), strict=True)))


def test_tip_on_the_axis_of_a_joint_has_infinitely_many_postures() -> None:
    """Turning about an axis on which the tip lies changes nothing."""
    machine = load_machine("cat215b").with_values({"boom.d": 0.0})
    with pytest.raises(ProblemError, match="infinitely many postures"):
        inverse_kinematics(Model(machine), np.array([0.0, 0.0, 4.0]))
    assert inverse_kinematics(Model(machine), np.array([0.0, 0.0, 4.0]), held={"swing": 0.2})


def test_what_cannot_be_asked_is_refused() -> None:
    subject, place = model("ur10"), np.array([0.5, 0.2, 0.4])
    for arguments, sentence in (({"position": place}, "6 joints move the tip, and 3 numbers .*; hold 3 of"),
                                ({"position": place[:2]}, "three finite coordinates"),
                                ({"position": place * np.nan}, "three finite coordinates"),
                                ({"position": place, "rotation": 2 * np.eye(3)}, "no rotation matrix"),
                                ({"position": place, "rotation": np.diag([1, 1, -1])}, "no rotation matrix"),
                                ({"position": place, "held": {"boom": 0.0}}, "'boom' is not a moving joint"),
                                ({"position": place, "held": dict.fromkeys(subject.machine.joints, 0.0)},
                                 "no joint is free")):
        with pytest.raises(ProblemError, match=sentence):
            inverse_kinematics(subject, **arguments)
