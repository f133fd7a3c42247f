"""What next: covariances are those of the estimators, the choice is near the best one, and it says when to stop."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from itertools import permutations
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import hydroopt as ho
from fixtures.sheets import says_what_people_keep
from hydroopt import KinematicModel, Model
from hydroopt.cli import app
from hydroopt.errors import ProblemError
from hydroopt.estimation.inference.identifiability import random_states, structural
from hydroopt.excitation.motion.expected_accuracy import expected_accuracy
from hydroopt.excitation.selection.goals import Goal
from hydroopt.excitation.selection.knowledge import Knowledge
from hydroopt.excitation.selection.measurements import LEVELLED, LOAD, LOADED, Measurement
from hydroopt.excitation.selection.what_next import lack, plan_next, sequence
from hydroopt.logs.poses import Poses
from hydroopt.results.verdict import Purpose
from hydroopt.simulation.pose_table import simulate_poses

LIFT = "patu655_lift"
SURVEYED = Path(__file__).parents[3] / "docs" / "how-to" / "measure_up.toml"


def test_errors_of_the_geometry_pass_on_as_in_two_steps() -> None:
    """Against 40,000 simulated calibrations, each followed by an identification with the calibrated geometry."""
    rng = np.random.default_rng(0)
    of_theta, of_psi = np.diag([4.0, 1.0]), np.diag([1.0, 2.0, 0.5])
    poses, motion = rng.normal(size=(3, 2)), rng.normal(size=(4, 5))
    known = Knowledge.stating("abcde", of_theta, of_psi).with_rows(poses, np.arange(2), geometry_exact=False).with_rows(
        motion, np.arange(5), geometry_exact=True)
    theta, psi = (rng.normal(size=(40000, len(each))) / np.sqrt(np.diag(each)) for each in (of_theta, of_psi))
    read = theta @ poses.T + rng.normal(size=(40000, 3))
    found = np.linalg.solve(of_theta + poses.T @ poses, poses.T @ read.T).T
    forces = theta @ motion[:, :2].T + psi @ motion[:, 2:].T + rng.normal(size=(40000, 4))
    left = forces - found @ motion[:, :2].T
    identified = np.linalg.solve(of_psi + motion[:, 2:].T @ motion[:, 2:], motion[:, 2:].T @ left.T).T
    assert np.cov(np.hstack([found - theta, identified - psi]).T) == pytest.approx(known.covariance, abs=0.02)


def drawn(seed: int) -> tuple[list[Measurement], list[Goal], Knowledge]:
    rng = np.random.default_rng(seed)
    made = [Measurement(name, name, float(rng.integers(0, 8)), float(rng.integers(1, 5)), rng.normal(size=(1, 2, 3)) * (
        rng.uniform(0.3, 3)), np.arange(3)) for name in "abcdef"]
    goal = Goal(Purpose.POSITION, "tip", "m", 1e-6, rng.normal(size=(2, 3)))
    return made, [goal], Knowledge.stating("xyz", np.eye(3), np.zeros((0, 0)))


@pytest.mark.parametrize("seed", range(4))
def test_the_choice_is_near_the_best_of_all(seed: int) -> None:
    made, goals, start = drawn(seed)
    budget, best = 20.0, np.inf
    for order in permutations(made, 4):
        state, left = start, budget
        for each in order:
            if (spent := each.set_up + each.minutes) <= left:
                state, left = state.after(each, 0), left - spent
        best = min(best, lack(goals, state.covariance))
    *_, last = sequence(made, goals, start, minutes=budget)
    assert best <= lack(goals, last.after.covariance) + 1e-9
    assert lack(goals, last.after.covariance) - best < 0.25  # σ within 28 % of the best choice's


def test_two_measurements_that_gain_only_together_are_found() -> None:
    def reading(name: str, *row: float) -> Measurement:
        return Measurement(name, name, 0.0, 1.0, np.array([[row]]), np.arange(3))

    made = [reading("sum", 1e3, 1e3, 0.0), reading("part", 0.0, 1e3, 0.0), reading("little", 0.7, 0.0, 0.0)]
    goal = Goal(Purpose.POSITION, "tip", "m", 1e-3, np.array([[1.0, 0.0, 0.0]]))
    known = Knowledge.stating("xyz", np.diag([1.0, 1e-4, 1.0]), np.zeros((0, 0)))
    names = {ahead: [step.measurement.name for step in sequence(made, [goal], known, minutes=2.0,
                                                                 lookahead=ahead)] for ahead in (True, False)}
    assert set(names[True]) == {"sum", "part"}
    assert names[False][0] == "little"


def test_a_motions_rows_give_the_expected_accuracy() -> None:
    model = ho.Model(ho.load_machine(LIFT))
    structure = structural(model)
    told = expected_accuracy(model, ho.random_trajectory(model, duration=20, rate=20, seed=1), structure)
    by_base = told.rows @ np.linalg.pinv(structure.grouping)
    assert np.sqrt(np.diag(np.linalg.inv(by_base.T @ by_base))) == pytest.approx(told.base, rel=1e-6)


@pytest.mark.slow
def test_answers_count_and_the_rule_stops(tmp_path: Path) -> None:
    log = ho.simulate(LIFT, ho.random_trajectory(LIFT, duration=20, rate=20, seed=5), seed=5)
    ho.solve(ho.identification_problem(LIFT, log)).save(tmp_path / "crane")
    first = plan_next(ho.what_next_problem(LIFT, targets={"force": 0.01}))
    assert first.steps[0].measurement.name == "motion"
    again = ho.what_next_problem(LIFT, [tmp_path / "crane"], targets={"force": 0.01})
    assert plan_next(again).stds[0, 0] < 0.2 * first.stds[0, 0]
    assert plan_next(ho.what_next_problem(LIFT, targets={"force": 1e-6}), minutes=13).stopped == "the minutes are spent"
    assert "a minute" in plan_next(ho.what_next_problem(LIFT, targets={"force": 1e-6}), least=10.0).stopped


@pytest.mark.slow
def test_a_calibration_of_the_step_gives_what_was_expected_of_it(tmp_path: Path) -> None:
    problem = ho.what_next_problem(SURVEYED, targets={"tip": 0.02})
    plan = plan_next(problem)
    step = plan.steps[-1]
    taken = ho.what_next_problem(SURVEYED, targets={"tip": 0.02}, without=[
        each.name for each in problem.measurements if each.name != step.measurement.name])
    plan = plan_next(taken)
    (step,) = plan.steps
    made = simulate_poses(problem.chain, step.measurement.postures.at(step.parts).table, seed=3)
    owner = step.measurement.name
    poses = replace(made.poses, channels={name: values for name, values in made.poses.channels.items()
                                          if name.startswith(f"{owner}.") or name.endswith(".q")})
    ho.solve(ho.calibration_problem(SURVEYED, poses)).save(tmp_path / "calibration")
    again = plan_next(ho.what_next_problem(SURVEYED, [tmp_path / "calibration"], targets={"tip": 0.02}), minutes=1.0)
    assert again.stds[0, 0] == pytest.approx(plan.stds[-1, 0], rel=0.1)
    calibrated = ho.what_next_problem(tmp_path / "calibration", targets={"tip": 0.02})
    (goal,) = calibrated.goals
    assert goal.std(calibrated.knowledge.covariance) == pytest.approx(again.stds[0, 0], rel=0.05)
    alone = ho.what_next_problem(calibrated.machine, targets={"tip": 0.02})  # its file states no correlations
    assert alone.goals[0].std(alone.knowledge.covariance) > 1.3 * again.stds[0, 0]


def test_the_command_writes_sheet_page_and_json(tmp_path: Path) -> None:
    ran = CliRunner().invoke(app, ["what-next", LIFT, "--force-std", "1 %", "--mass-std", "lift.m=1 kg", "-o",
                                   str(tmp_path)], catch_exceptions=False)
    assert ran.exit_code == 0
    assert "Next: Drive motions" in ran.output
    saved = json.loads((tmp_path / "next.json").read_text())
    assert saved["steps"][0]["measurement"] == "motion"
    assert saved["stopped"] in (tmp_path / "sheet.txt").read_text()
    assert "What each kind of measurement would gain now" in (tmp_path / "report.html").read_text()


def test_the_sheet_keeps_people_safe_where_postures_are_driven_to() -> None:
    plan = plan_next(surveyed(), minutes=30.0)
    driven = plan.steps[0].measurement.postures.at(plan.steps[0].parts)
    says_what_people_keep(plan.sheet(), driven.watch)
    assert f"posture {len(driven.q)}: " in plan.sheet()
    assert "Keep everyone" not in plan_next(ho.what_next_problem(LIFT, targets={"force": 0.01})).sheet()


@pytest.mark.parametrize(("options", "sentence"), [
    ({"targets": {"tip": -1.0}}, "cannot be reached"),
    ({"targets": {"force": 0.01}, "without": ["rig"]}, "no measurement 'rig'"),
    ({"targets": {"force": 0.01}, "minutes": {"motion": -1.0}}, "not a duration"),
    ({"targets": {"lift.mc_x": 1.0}}, "is no mass"), ({"targets": {"force": 0.01}, "answers": ["nowhere"]}, "nowhere")])
def test_what_cannot_be_planned_is_refused(options: dict, sentence: str) -> None:
    with pytest.raises(ProblemError, match=sentence):
        plan_next(ho.what_next_problem(LIFT, **options))


def test_a_tip_whose_geometry_is_exact_is_refused() -> None:
    exact = ho.load_machine(LIFT).model_copy(update={"notes": {}})
    with pytest.raises(ProblemError, match="no uncertain number"):
        plan_next(ho.what_next_problem(exact, targets={"tip": 0.01}))


def reading(problem: ho.WhatNextProblem, name: str) -> Measurement:
    return next(each for each in problem.measurements if each.name == name)


@cache
def surveyed() -> ho.WhatNextProblem:
    return replace(ho.what_next_problem(SURVEYED, targets={"tip": 0.01}, without=["station", "plate"]), candidates=8)


def poses_read(problem: ho.WhatNextProblem, names: Sequence[str], seed: int, *, random: bool) -> tuple[Poses, dict]:
    """What is read with some additions and by the joints in the postures of the first of them."""
    measured = reading(problem, names[0])
    made = simulate_poses(KinematicModel(problem.equipped), measured.postures.table, random=random, seed=seed)
    return replace(made.poses, channels={name: values for name, values in made.poses.channels.items() if name.endswith(
        ".q") or name.partition(".")[0] in names}), made.truth


@pytest.mark.parametrize("name", ["pins_boom", "stick_cylinder", "inclination_boom"])
def test_an_addition_gives_what_a_calibration_with_it_gives(name: str) -> None:
    problem = surveyed()
    state = problem.knowledge
    for k in range(len(reading(problem, name).rows)):
        state = state.after(reading(problem, name), k)
    poses, _ = poses_read(problem, [name], 1, random=False)
    found = ho.solve(ho.calibration_problem(problem.equipped, poses))
    std = dict(zip(state.names, np.sqrt(np.diag(state.covariance)), strict=True))
    before = dict(zip(state.names, np.sqrt(np.diag(problem.knowledge.covariance)), strict=True))
    names = found.problem.parameters.names
    free = [k for k, each in enumerate(names) if each in std and np.isfinite(found.std[k])]
    assert [found.std[k] for k in free] == pytest.approx([std[names[k]] for k in free], rel=0.02)
    assert min(std[each] / before[each] for each in std) < 0.95


@pytest.mark.slow
@pytest.mark.parametrize("name", ["pins_boom", "inclination_boom"])
def test_drawn_machines_measured_with_an_addition_err_as_expected(name: str) -> None:
    problem = surveyed()
    state = problem.knowledge
    for k in range(len(reading(problem, name).rows)):
        state = state.after(reading(problem, name), k)
    std = dict(zip(state.names, np.sqrt(np.diag(state.covariance)), strict=True))
    errors = []
    for draw in range(40):
        poses, truth = poses_read(problem, [name], draw, random=True)
        found = ho.solve(ho.calibration_problem(problem.equipped, poses))
        errors.append([(found.theta[found.problem.parameters.index(each)] - truth[each]) / std[each]
                       for each in ("boom.a", "boom.theta", "stick.theta")])
    assert np.sqrt(np.mean(np.square(errors), axis=0)) == pytest.approx(1.0, abs=0.3)


def test_what_an_uncertain_tilt_of_the_base_costs_a_weighed_load_and_levelling_saves() -> None:
    """Against loads weighed by the forces of a machine that is rolled and pitched by a standard deviation."""
    size = 0.02
    problem = ho.what_next_problem(LIFT, targets={"load": 1.0}, base_tilt=size)
    (goal,), level = problem.goals, reading(problem, "level")
    model, psi, before = problem.model, problem.model.parameters.nominal, problem.knowledge
    after = before.after(level, 0)
    rng = np.random.default_rng(1)
    q = random_states(model, len(goal.task), rng)[0]
    qd = 0.1 * np.sqrt(np.mean(problem.task.qd**2, axis=0)) * rng.choice([-1.0, 1.0], q.shape)
    here, off = model.over(model.regressor, q, qd, 0 * q)[0] @ psi, []
    for tilt in size * np.eye(3)[:2]:
        turned = Model(model.machine.model_copy(update={"orientation": tuple(model.machine.orientation + tilt)}))
        off.append(turned.over(turned.regressor, q, qd, 0 * q)[0] @ psi - here)
    for known, part in ((before, 1.0), (after, LEVELLED / np.hypot(size, LEVELLED))):
        exact = known.covariance.copy()
        exact[:2] = exact[:, :2] = 0.0
        weights = goal.weights(known.covariance)
        loads = part * np.array([np.sum(weights * each, axis=1) for each in off])
        rows = np.einsum("sr,srp->sp", weights, goal.task)
        without = np.mean(np.einsum("sp,pk,sk->s", rows, exact, rows)) + goal.floor(known.covariance)
        expected = np.sqrt(without + np.mean(np.sum(loads**2, axis=0)))
        assert goal.std(known.covariance) == pytest.approx(expected, rel=0.02)


def test_a_known_load_teaches_what_a_weighing_of_it_does() -> None:
    """Against 4,000 machines whose forces under a known load are drawn, and ψ found by least squares."""
    problem = ho.what_next_problem(LIFT, targets={"load": 1.0})
    (goal,), known = problem.goals, reading(problem, "known_load")
    after = problem.knowledge.after(known, 0)
    rng, count = np.random.default_rng(3), 4000
    prior = np.linalg.cholesky(problem.knowledge.covariance)
    delta = rng.normal(size=(count, len(prior))) @ prior.T
    mass = LOAD * (1 + LOADED * rng.normal(size=count))
    rows, effect = goal.task[0], goal.effect[0]
    force = delta @ rows.T + (mass - LOAD)[:, None] * effect
    force += rng.normal(size=force.shape) * np.sqrt(goal.noise)
    noise = np.diag(goal.noise) + np.outer(effect, effect) * (LOAD * LOADED) ** 2
    gain = np.linalg.solve(rows @ problem.knowledge.covariance @ rows.T + noise, rows @ problem.knowledge.covariance).T
    left = delta - force @ gain.T
    tasks = goal.rows(after.covariance)
    found = np.sqrt(np.mean(np.sum((left @ tasks.T) ** 2, axis=1)) + goal.floor(after.covariance))
    assert found == pytest.approx(goal.std(after.covariance), rel=0.05)
    assert goal.std(after.covariance) < 0.5 * goal.std(problem.knowledge.covariance)


def test_an_addition_comes_with_what_the_machine_file_needs() -> None:
    problem = surveyed()
    added = {each.name: each for each in problem.additions}
    text = SURVEYED.read_text("utf-8") + "\n\n" + added["pins_boom"].file + "\n\n" + added["inclination_boom"].file
    machine = ho.read_machine(text)
    assert "pins_boom" in {each.name for each in machine.distances}
    only = [each.name for each in problem.measurements if each.name != "pins_boom"]
    plan = plan_next(replace(problem, without=(*problem.without, *only)), minutes=6.0)
    assert plan.steps[0].measurement.file in plan.files()["addition.toml"]
    assert "addition.toml" in plan.next_steps[0].text


@pytest.mark.slow
def test_a_machine_whose_poses_all_hold_the_calibrator_is_taped_without_it() -> None:
    problem = replace(ho.what_next_problem("cat215b", targets={"tip": 0.01}), candidates=8)
    taped, known = reading(problem, "pins_boom"), problem.knowledge
    after = known.after(taped, 0)
    k = known.names.index("boom.a")
    assert after.covariance[k, k] == pytest.approx(1 / (1 / known.covariance[k, k] + 1 / 0.003**2), rel=0.01)
    only = [each.name for each in problem.measurements if each.name != "inclination_boom"]
    plan = plan_next(replace(problem, without=tuple(only)), minutes=20.0, least=0.0)
    assert plan.files()["postures.csv"].startswith("stage,fixture,pose,swing.q [deg],boom.q [deg],stick.q [deg]\n")
    assert "nan" not in plan.sheet()


@pytest.mark.slow
def test_machines_with_inclination_alone_need_no_sensor_at_a_vertical_joint() -> None:
    with pytest.raises(ProblemError, match="states the tip as exact at known joint positions; state a 'sigma'"):
        ho.solve(ho.what_next_problem("excavator_imu", targets={"tip": 0.02}))
    machine = ho.read_machine('based_on = "excavator_imu"\n[[links]]\nname = "boom"\n'
                                    'joint = { a = { value = "6.2354 m", sigma = "15 mm" } }')
    plan = ho.solve(ho.what_next_problem(machine, targets={"tip": 0.008}))
    assert plan.steps[0].measurement.name == "pins_boom"
    assert plan.stds[-1, 0] < 0.008 < plan.stds[0, 0]


@pytest.mark.slow
def test_random_motions_leave_out_those_in_which_passive_joints_leave_their_ranges() -> None:
    """Of a crane whose grapple may sway by 25 deg only; by less than any motion makes, designed ones are asked for."""
    def crane(sway: float) -> ho.Machine:
        return ho.read_machine('based_on = "forestry_crane"\nname = "narrow"\n[[links]]\nname = "sway"\n'
                               f'joint = {{ lower = "-{sway} deg", upper = "{sway} deg" }}\n')

    problem = ho.what_next_problem(crane(25), targets={"load": 100.0})
    for motion in (*problem.motions, problem.task):
        assert ho.simulate(Model(problem.machine), motion, seed=0).size == len(motion.t)
    with pytest.raises(ProblemError, match=r"leaves its range in 10 random motions; give motions that excite"):
        ho.what_next_problem(crane(0.1), targets={"load": 100.0})
