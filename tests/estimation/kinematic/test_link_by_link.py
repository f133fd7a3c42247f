"""Kinematic calibration link by link: what the thesis's method must find, and what it must refuse."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from fixtures.tiers import tiered
from hydroopt.errors import ProblemError
from hydroopt.estimation.kinematic import link_by_link
from hydroopt.estimation.kinematic.calibration import calibrate
from hydroopt.estimation.kinematic.observability import linearise, observability
from hydroopt.estimation.kinematic.problem import CalibrationProblem, calibration_problem
from hydroopt.machine.links import Note
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import load_machine
from hydroopt.model.closed_chain import KinematicModel
from hydroopt.simulation import postures
from studies import closed_postures

ACCURACY = 1e-8
SWEEPS = {"grapple_swing": (20, 65), "stick": (60, 110), "boom": (-45, -15), "swing": (-25, 25)}

Case = tuple[CalibrationProblem, np.ndarray]


def excavator(seed: int = 0, *, count: int = 40, sweep: bool = False, stages: int = 3, noise: int | None = None,
              read: tuple[str, ...] = (), name: str = "cat215b") -> Case:
    """The problem of perfect (or noisy) readings of the excavator with its nominal geometry, and its joint vectors."""
    machine = load_machine(name)  # whose drift the method does not know
    still = tuple(stage.model_copy(update={"drift": 0.0}) for stage in machine.stages)
    machine = machine.model_copy(update={"stages": still})
    model = KinematicModel(machine)
    place = {"geometry": model.parameters.nominal, "fixture": np.array(machine.fixtures[0].position)}
    found = []
    for k, stage in enumerate(machine.stages[:stages]):
        path = np.radians(np.linspace(*SWEEPS[stage.moves[0]], count))[:, None]
        found.append(closed_postures.sweep(model, stage, path, **place) if sweep
                     else closed_postures.random_postures(model, stage, count, seed=3 * seed + k, **place))
    q = np.concatenate(found)
    names = [stage.name for stage in machine.stages[:stages] for _ in range(count)]
    channels = [f"{joint}.q" for joint in ("grapple", "yoke", "upper_arm", "forearm", *read)]
    poses = postures.record(model, q, names, ["ball"] * len(q), geometry=model.parameters.nominal, seed=noise,
                            channels=channels)
    problem = calibration_problem(machine, poses, priors=False)
    pins = {name: problem.start[k] for k, name in enumerate(problem.parameters.names) if "cylinder" in name}
    return problem.fixing(**pins, **{"ball.y": 0.0}), q


def start(problem: CalibrationProblem, seed: int) -> np.ndarray:
    """10 % off in lengths (3 cm in those below 0.3 m) and 5° in angles, up or down at random."""
    own, rng = problem.parameters, np.random.default_rng(seed)
    off = np.where(np.array(own.units) == "rad", np.radians(5), np.maximum(0.1 * np.abs(own.nominal), 0.03))
    return problem.start + np.where(problem.free, rng.choice([-1, 1], len(own)) * off, 0.0)


def apart(q: np.ndarray, truth: np.ndarray) -> float:
    return float(np.max(np.abs(np.angle(np.exp(1j * (q - truth))))))


@pytest.mark.parametrize("sweep", [False, True])
@pytest.mark.parametrize("seed", tiered(range(4), lambda seed: seed == 0))
def test_excavator(seed: int, sweep: bool) -> None:
    problem, q = excavator(seed, sweep=sweep)
    theta, found, _ = link_by_link.sequential_least_squares(problem, start(problem, seed), np.zeros_like(q))
    assert np.max(np.abs(theta - problem.start)) < ACCURACY
    assert apart(found, q) < ACCURACY


def test_what_each_stage_identifies() -> None:
    problem, q = excavator()
    stages = link_by_link.sequential_least_squares(problem, start(problem, 0), q).stages
    assert [(each.stage, each.joint) for each in stages] == [
        ("stick_moves", "stick"), ("boom_moves", "boom"), ("swing_moves", "swing"), ("all", "")]
    assert [set(each.identified) for each in stages] == [
        {"stick.a", "stick.alpha", "stick.beta", "grapple_swing.locked.stick_moves"},
        {"boom.a", "boom.alpha", "boom.beta", "stick.locked.boom_moves"},
        {"swing.a", "swing.alpha", "boom.d", "boom.locked.swing_moves", "ball.x", "ball.z"},
        {"swing.locked.stick_moves", "boom.locked.stick_moves"}]
    assert all(each.rms < ACCURACY and each.iterations > 0 for each in stages)
    # the circle's radius and height count, too
    assert [each.rank for each in stages] == [6, 6, 6, 2]
    assert all(link_by_link.LAST <= each.truncation <= link_by_link.FIRST for each in stages)
    assert stages[2].unknowns == len(stages[2].identified) + len(stages[3].identified)


def test_the_answer_keeps_and_prints_the_iterations_of_each_stage() -> None:
    problem, _ = excavator(count=15, noise=0)
    solved = calibrate(problem, "hierarchical")
    kept = solved.details()["stages"]
    assert [stage["stage"] for stage in kept] == ["stick_moves", "boom_moves", "swing_moves", "all"]
    for stage, result in zip(kept, solved.stages, strict=True):
        assert f"stage {result.stage}" in str(solved)
        assert f"{stage['iterations']} iterations" in str(solved)
        assert stage["truncation"] == result.truncation


FIRST_LINK = {"grapple_swing.a", "grapple_swing.alpha", "grapple.theta", "grapple.a", "grapple.d", "grapple.alpha",
              "yoke.theta", "upper_arm.theta"}


def test_the_first_stage_identifies_the_eight_numbers_of_link_4() -> None:
    """Section 3.6.4: theta_5 to theta_7, alpha_5, a_5, d_5, alpha_4 and a_4, then the later stages as without it."""
    problem, q = excavator(name="cat215b_link4", stages=4)
    first, *later = (found := link_by_link.sequential_least_squares(problem, start(problem, 0), q)).stages
    assert (first.stage, first.joint, set(first.identified)) == ("grapple_swing_moves", "grapple_swing", FIRST_LINK)
    assert first.rank == 10  # with the circle's two, as Section 3.8.1 counts
    assert set(later[0].identified) == {"stick.a", "stick.alpha", "stick.beta", "grapple_swing.locked.stick_moves"}
    assert np.max(np.abs(found.parameters - problem.start)) < ACCURACY


@pytest.mark.slow
def test_a_turn_of_the_whole_machine_stays_open() -> None:
    """Nothing tells where about the swing's axis the fixture stands: its place is found up to that turn."""
    problem, q = excavator()
    problem = replace(problem, fixed={name: value for name, value in problem.fixed.items() if name != "ball.y"})
    found = link_by_link.sequential_least_squares(problem, start(problem, 1), q)
    identified = {name for stage in found.stages for name in stage.identified}
    names = [name for name, free in zip(problem.parameters.names, problem.free, strict=True) if free]
    assert set(names) - identified == {"ball.x", "ball.y", "swing.locked.stick_moves"}
    sure = [problem.parameters.index(name) for name in identified]
    np.testing.assert_allclose(found.parameters[sure], problem.start[sure], rtol=0, atol=ACCURACY)
    x, y = (found.parameters[problem.parameters.index(f"ball.{axis}")] for axis in "xy")
    assert np.hypot(x, y) == pytest.approx(2.16, abs=ACCURACY)
    turn = found.parameters[problem.parameters.index("swing.locked.stick_moves")]
    assert turn == pytest.approx(np.arctan2(y, x), abs=ACCURACY)


def test_without_the_last_stage_the_outer_links_are_found() -> None:
    problem, q = excavator(stages=2)
    found = link_by_link.sequential_least_squares(problem, start(problem, 2), q)
    sure = [problem.parameters.index(name) for stage in found.stages[:2] for name in stage.identified]
    assert len(sure) == 8
    np.testing.assert_allclose(found.parameters[sure], problem.start[sure], rtol=0, atol=ACCURACY)


def test_a_resolver_before_the_moving_joint() -> None:
    """The fixture does not stand still before the stick while the swing's reading varies: the whole loop is closed."""
    problem, q = excavator(read=("swing",))
    found = link_by_link.sequential_least_squares(problem, start(problem, 1), q)
    np.testing.assert_allclose(found.parameters, problem.start, rtol=0, atol=ACCURACY)
    assert apart(found.q, q) < ACCURACY
    assert [(each.stage, each.joint) for each in found.stages] == [
        ("stick_moves", "stick"), ("boom_moves", "boom"), ("swing_moves", ""), ("all", "")]


@pytest.mark.slow
def test_noise_stays_within_reason() -> None:
    problem, q = excavator(count=120, noise=5)
    theta, *_ = link_by_link.sequential_least_squares(problem, problem.start, q)
    assert abs(theta - problem.start)[problem.parameters.index("stick.a")] < 5e-3
    assert abs(theta - problem.start)[problem.parameters.index("boom.a")] < 0.02


def arm(joints: int) -> Machine:
    """A made-up arm of crossed axes, all sensed, with a ball at its end and two fixtures a known distance apart."""
    rng = np.random.default_rng(joints)
    links: list[dict[str, Any]] = []
    notes = {"left.position": Note(sigma=0.1), "right.position": Note(sigma=0.1)}
    for k in range(joints):
        joint = {"type": "revolute", "lower": -3.0, "upper": 3.0, "a": rng.uniform(0.3, 0.6),
                 "d": rng.uniform(0.1, 0.3), "alpha": float(rng.choice([-1, 1]) * rng.uniform(1.3, 1.6)),
                 "theta": rng.uniform(-0.2, 0.2)}
        links.append({"name": f"j{k}", "parent": f"j{k - 1}" if k else "base", "joint": joint})
        notes |= {f"j{k}.joint.{key}": Note(sigma=0.02) for key in ("a", "d", "alpha", "theta")}
    return Machine.model_validate({
        "name": "arm", "links": links, "drives": [{"name": f"drive{k}", "joint": f"j{k}"} for k in range(joints)],
        "calibrator": {"parent": f"j{joints - 1}", "tip": (0.05, 0.0, 0.1)},
        "fixtures": [{"name": "left", "position": (0.5, 0.4, 0.3)}, {"name": "right", "position": (0.6, -0.3, 0.2)}],
        "distances": [{"name": "bar", "between": ("left", "right"), "length": float(np.sqrt(0.01 + 0.49 + 0.01))}],
        "sensors": [{"channels": [f"j{k}.q" for k in range(joints)], "accuracy": 1e-3}], "notes": notes})


@pytest.mark.parametrize("labels", [("", ""), ("first", "second")])
@pytest.mark.parametrize("joints", tiered((4, 5, 6, 7), lambda joints: joints == 4))
def test_all_sensed_with_a_known_distance(joints: int, labels: tuple[str, str]) -> None:
    machine = arm(joints)
    model = KinematicModel(machine)
    rng = np.random.default_rng(1)
    names, stages, found = [], [], []
    for fixture, label in zip(machine.fixtures, labels, strict=True):
        q, closed = postures.close(model, model.parameters.nominal, rng.uniform(-2.5, 2.5, (150, joints)),
                                   range(joints), np.array(fixture.position))
        found.append(q[closed])
        names += [fixture.name] * int(closed.sum())
        stages += [label] * int(closed.sum())
    q = np.concatenate(found)
    poses = postures.record(model, q, stages, names, geometry=model.parameters.nominal, seed=None)
    problem = calibration_problem(machine, poses, priors=False)
    seen = observability(problem, linearise(problem, problem.start, q))
    sure = np.linalg.norm(seen.null_space, axis=1) < 1e-6
    assert sure.sum() == 4 * joints - 6  # base and fixtures turn and rise together, α of the last joint makes up for d
    answer = link_by_link.sequential_least_squares(problem, start(problem, joints), q)
    np.testing.assert_allclose(answer.parameters[sure], problem.start[sure], rtol=0, atol=ACCURACY)
    assert answer.q == pytest.approx(q)
    assert set(answer.stages[0].identified) == {n for n, s in zip(problem.parameters.names, sure, strict=True) if s}


def with_compliance(machine: Machine) -> Machine:
    joint = machine.links[1].joint.model_copy(update={"compliance": 1e-8})
    return machine.model_copy(update={"links": (machine.links[0], machine.links[1].model_copy(
        update={"joint": joint}), *machine.links[2:])})


def with_stage(**change: Any) -> Callable[[Machine], Machine]:
    def changed(machine: Machine) -> Machine:
        return machine.model_copy(update={
            "stages": (machine.stages[0].model_copy(update=change), *machine.stages[1:])})
    return changed


def refuse(problem: CalibrationProblem, q: np.ndarray) -> str:
    with pytest.raises(ProblemError) as error:
        link_by_link.sequential_least_squares(problem, problem.start, q)
    assert "joint" in error.value.remedy
    return str(error.value)


def again(problem: CalibrationProblem, machine: Machine) -> CalibrationProblem:
    return calibration_problem(machine, problem.poses, priors=False)


@pytest.mark.parametrize(("change", "words"), [
    (with_stage(drift=0.01), "'swing.drift.stick_moves': .*drift.*hold the parameter at 0"),
    (with_stage(moves=("boom", "stick"), locked={"swing": 0.0, "grapple_swing": 0.7}),
     "stage 'stick_moves': boom and stick move unsensed"),
    (with_compliance, "'cat215b': joints give way")])
def test_machines_that_the_method_cannot_use(change: Callable[[Machine], Machine], words: str) -> None:
    problem, q = excavator(count=3)
    problem = again(problem, change(problem.model.machine))
    assert re.search(words, refuse(problem, q))


def test_a_sliding_joint_is_refused() -> None:
    problem, q = excavator(count=3)
    machine = problem.model.machine
    stick = machine.links[2]
    slide = stick.model_copy(update={"joint": stick.joint.model_copy(update={"type": "prismatic"})})
    machine = machine.model_copy(update={"links": (*machine.links[:2], slide)})
    assert "'stick' slides unsensed" in refuse(again(problem, machine), q)


def test_other_channels_are_refused() -> None:
    problem, q = excavator(count=3)
    for channel in ("stick_cylinder.length", "stick.distance"):
        layout = problem.layout
        present = layout.present.copy()
        present[4, problem.model.channels.index(channel)] = True
        assert f"cannot use '{channel}'" in refuse(replace(problem, layout=replace(layout, present=present)), q)


def test_poses_without_fixture_or_with_another_loss_are_refused() -> None:
    problem, q = excavator(count=3)
    free = replace(problem, layout=replace(problem.layout, held=np.zeros(len(q), dtype=bool)))
    assert "no pose holds the tip" in refuse(free, q)
    assert "'huber'" in refuse(problem.with_loss("huber"), q)


def test_an_answer_out_of_bounds_is_refused() -> None:
    problem, q = excavator()
    upper = problem.parameters.upper.copy()
    upper[problem.parameters.index("boom.a")] = 5.0
    tight = replace(problem, parameters=replace(problem.parameters, upper=upper))
    assert "'boom.a': the link-by-link method found 5.18 m, outside of the bounds" in refuse(tight, q)


def test_drift_held_at_zero_is_no_drift() -> None:
    problem, q = excavator(stages=3)
    drifting = again(problem, with_stage(drift=0.01)(problem.model.machine))
    still = {name: 0.0 for name in drifting.parameters.names if ".drift." in name}
    drifting = drifting.fixing(**problem.fixed, **still)
    theta, *_ = link_by_link.sequential_least_squares(drifting, start(drifting, 3), q)
    assert np.max(np.abs(theta - drifting.start)) < ACCURACY
