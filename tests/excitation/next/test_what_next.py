"""What next: covariances are those of the estimators, the choice is near the best one, and it says when to stop."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import permutations
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import hydroopt as ho
from hydroopt.cli import app
from hydroopt.errors import ProblemError
from hydroopt.estimation.inference.identifiability import structural
from hydroopt.excitation.motion.expected_accuracy import expected_accuracy
from hydroopt.excitation.next.goals import LinearGoal
from hydroopt.excitation.next.knowledge import Knowledge
from hydroopt.excitation.next.measurements import Measurement
from hydroopt.excitation.next.plan import plan_next
from hydroopt.excitation.next.sequence import State, lack, sequence
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
    known = Knowledge.stating("abcde", of_theta, of_psi).with_rows(poses, slice(0, 2), geometry_exact=False).with_rows(
        motion, slice(0, 5), geometry_exact=True)
    theta, psi = (rng.normal(size=(40000, len(each))) / np.sqrt(np.diag(each)) for each in (of_theta, of_psi))
    read = theta @ poses.T + rng.normal(size=(40000, 3))
    found = np.linalg.solve(of_theta + poses.T @ poses, poses.T @ read.T).T
    forces = theta @ motion[:, :2].T + psi @ motion[:, 2:].T + rng.normal(size=(40000, 4))
    left = forces - found @ motion[:, :2].T
    identified = np.linalg.solve(of_psi + motion[:, 2:].T @ motion[:, 2:], motion[:, 2:].T @ left.T).T
    assert np.cov(np.hstack([found - theta, identified - psi]).T) == pytest.approx(known.covariance, abs=0.02)


def drawn(seed: int) -> tuple[list[Measurement], list[LinearGoal], State]:
    rng = np.random.default_rng(seed)
    made = [Measurement(name, name, float(rng.integers(0, 8)), float(rng.integers(1, 5)), rng.normal(size=(1, 2, 3)) * (
        rng.uniform(0.3, 3)), slice(0, 3), np.zeros((1, 0))) for name in "abcdef"]
    goal = LinearGoal(Purpose.POSITION, "tip", "m", 1e-6, rng.normal(size=(2, 3)))
    return made, [goal], State(Knowledge.stating("xyz", np.eye(3), np.zeros((0, 0))), {})


@pytest.mark.parametrize("seed", range(4))
def test_the_choice_is_near_the_best_of_all(seed: int) -> None:
    made, goals, start = drawn(seed)
    budget, best = 20.0, np.inf
    for order in permutations(made, 4):
        state, left = start, budget
        for each in order:
            if (spent := each.set_up + each.minutes) <= left:
                state, left = state.after(each, 0), left - spent
        best = min(best, lack(goals, state.knowledge.covariance))
    *_, last = sequence(made, goals, start, minutes=budget)
    assert best <= lack(goals, last.after.knowledge.covariance) + 1e-9
    assert lack(goals, last.after.knowledge.covariance) - best < 0.25  # σ within 28 % of the best choice's


def test_two_measurements_that_gain_only_together_are_found() -> None:
    def reading(name: str, *row: float) -> Measurement:
        return Measurement(name, name, 0.0, 1.0, np.array([[row]]), slice(0, 3), np.zeros((1, 0)))

    made = [reading("sum", 1e3, 1e3, 0.0), reading("part", 0.0, 1e3, 0.0), reading("little", 0.7, 0.0, 0.0)]
    goal = LinearGoal(Purpose.POSITION, "tip", "m", 1e-3, np.array([[1.0, 0.0, 0.0]]))
    known = Knowledge.stating("xyz", np.diag([1.0, 1e-4, 1.0]), np.zeros((0, 0)))
    names = {ahead: [step.measurement.name for step in sequence(made, [goal], State(known, {}), minutes=2.0,
                                                                 lookahead=ahead)] for ahead in (True, False)}
    assert set(names[True]) == {"sum", "part"}
    assert names[False][0] == "little"


def test_a_motions_rows_give_the_expected_accuracy() -> None:
    model = ho.Model(ho.load_machine(LIFT))
    structure = structural(model)
    told = expected_accuracy(model, ho.random_trajectory(model, duration=20, rate=20, seed=1), structure)
    by_base = told.rows @ np.linalg.pinv(structure.grouping)
    assert np.sqrt(np.diag(np.linalg.inv(by_base.T @ by_base))) == pytest.approx(told.base, rel=1e-6)


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
    q = step.measurement.q[list(step.parts)]
    joints = problem.chain.joints
    none = np.full(len(q), "")
    table = Poses("planned", none, none, channels={f"{joint}.q": q[:, k] for k, joint in enumerate(joints)},
                  units={f"{joint}.q": "rad" for joint in joints})
    made = simulate_poses(problem.chain, table, seed=3)
    owner = step.measurement.name
    poses = replace(made.poses, channels={name: values for name, values in made.poses.channels.items()
                                          if name.startswith(f"{owner}.") or name.endswith(".q")})
    ho.solve(ho.calibration_problem(SURVEYED, poses)).save(tmp_path / "calibration")
    again = plan_next(ho.what_next_problem(SURVEYED, [tmp_path / "calibration"], targets={"tip": 0.02}), minutes=1.0)
    assert again.stds[0, 0] == pytest.approx(plan.stds[-1, 0], rel=0.1)


def test_the_command_writes_sheet_page_and_json(tmp_path: Path) -> None:
    ran = CliRunner().invoke(app, ["what-next", LIFT, "--force-std", "1 %", "--mass-std", "lift.m=1 kg", "-o",
                                   str(tmp_path)], catch_exceptions=False)
    assert ran.exit_code == 0
    assert "Next: Drive motions" in ran.output
    saved = json.loads((tmp_path / "next.json").read_text())
    assert saved["steps"][0]["measurement"] == "motion"
    assert saved["stopped"] in (tmp_path / "sheet.txt").read_text()
    assert "What each kind of measurement would gain now" in (tmp_path / "report.html").read_text()


@pytest.mark.parametrize(("options", "sentence"), [
    ({"targets": {"tip": -1.0}}, "cannot be reached"), ({"targets": {"tip": 0.01}}, "no uncertain number"),
    ({"targets": {"force": 0.01}, "without": ["rig"]}, "no measurement 'rig'"),
    ({"targets": {"force": 0.01}, "minutes": {"motion": -1.0}}, "not a duration"),
    ({"targets": {"lift.mc_x": 1.0}}, "is no mass"), ({"targets": {"force": 0.01}, "answers": ["nowhere"]}, "nowhere")])
def test_what_cannot_be_planned_is_refused(options: dict, sentence: str) -> None:
    with pytest.raises(ProblemError, match=sentence):
        plan_next(ho.what_next_problem(LIFT, **options))
