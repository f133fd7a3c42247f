"""A designed motion beside random ones: the best of them, what the comparison says, and condition numbers."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import hydroopt as ho
from fixtures.tiers import tiered
from hydroopt.excitation.motion.basis import Fourier
from hydroopt.excitation.motion.design import excitation_problem
from hydroopt.excitation.motion.excitation import Excitation
from hydroopt.excitation.motion.problem import ExcitationProblem
from hydroopt.excitation.motion.random_motion import best_random_motion, random_motion, resting_posture
from hydroopt.report.excitation import render
from hydroopt.results.diagnostic import of_kind

COUNT = 12


@pytest.fixture(scope="module")
def problem() -> ExcitationProblem:
    return excitation_problem(ho.load_machine("cat215b"), Fourier(6.0, 2, blend=1.0))


@pytest.fixture(scope="module")
def best(problem: ExcitationProblem) -> np.ndarray:
    return best_random_motion(problem, COUNT, seed=3)


@pytest.mark.slow
def test_the_best_random_motion_keeps_all_limits_and_no_other_is_better(problem: ExcitationProblem,
                                                                        best: np.ndarray) -> None:
    assert problem.excess(best, problem.fine) <= 0
    rest = resting_posture(problem, np.random.default_rng(3))
    others = [problem.value(random_motion(problem, rest, np.random.default_rng((3, k, COUNT)))) for k in range(COUNT)]
    assert problem.value(best) == pytest.approx(min(others), abs=0.01)  # but for the digits of its scale
    assert np.diff(sorted(others)[:2]) > 0.05


@pytest.mark.slow
def test_a_seed_draws_the_same_motions(problem: ExcitationProblem, best: np.ndarray) -> None:
    assert np.array_equal(best_random_motion(problem, COUNT, seed=3), best)
    assert not np.array_equal(best_random_motion(problem, 2, seed=4), best)


def test_condition_numbers_are_those_of_the_regressor() -> None:
    problem = excitation_problem(ho.load_machine("patu655_lift"), Fourier(6.0, 2, blend=1.0))
    motion = Excitation(problem, best_random_motion(problem, 2, seed=1))
    asked, model = problem.parameters, problem.information.model
    path = motion.trajectory
    K = model.over(model.regressor, path.q, path.qd, path.qdd)[0][:, :, list(asked.columns)]
    raw = K.reshape(-1, K.shape[2])
    scaled = (K * asked.weight[:, None] * asked.scale).reshape(raw.shape)
    assert motion.condition_numbers == pytest.approx({
        "raw": np.linalg.cond(raw), "unit_columns": np.linalg.cond(raw / np.linalg.norm(raw, axis=0)),
        "scaled": np.linalg.cond(scaled)}, rel=1e-6)
    assert motion.condition_numbers["unit_columns"] < motion.condition_numbers["raw"]


def test_a_motion_that_does_not_tell_all_excites_fewer_base_parameters(problem: ExcitationProblem,
                                                                       best: np.ndarray) -> None:
    still = Excitation(problem, problem.posture(problem.mean))
    assert 0 < still.excited < Excitation(problem, best).excited <= len(still.names)
    assert all(1 <= value < 1e13 for value in still.condition_numbers.values())


@pytest.mark.parametrize("criterion", tiered(["D", "A", "E", "condition"], lambda criterion: criterion == "D"))
@pytest.mark.slow
def test_the_gain_is_a_ratio_of_standard_deviations(criterion: str, monkeypatch: pytest.MonkeyPatch,
                                                    tmp_path: Path) -> None:
    monkeypatch.setattr(Excitation, "random_motions", 2)
    problem = excitation_problem(ho.load_machine("patu655_lift"), Fourier(6.0, 2, blend=1.0), criterion=criterion)
    x = problem.posture(problem.mean)
    x[problem.basis.names.index("sin1")] = 0.2
    motion = Excitation(problem, x, seed=1)
    model, asked = problem.information.model, problem.parameters
    rows = [(model.over(model.regressor, path.q, path.qd, path.qdd)[0][:, :, list(asked.columns)]
             * asked.weight[:, None] * asked.scale).reshape(-1, len(asked.columns))
            for path in (motion.trajectory, motion.best_random.trajectory)]
    spread = [np.linalg.eigvalsh(np.linalg.inv(each.T @ each)) for each in rows]
    own, other = ({"D": np.exp(np.mean(np.log(v)) / 2), "A": np.sqrt(np.sum(v)), "E": np.sqrt(v[-1]),
                   "condition": np.sqrt(v[-1] / v[0])}[criterion] for v in spread)
    assert motion.gain == pytest.approx(other / own, rel=1e-4)
    motion.save(tmp_path, pages={"report.html": render(motion)})
    said = json.loads((tmp_path / "excitation.json").read_text())
    assert said["best_random"]["motions"] == 2
    assert said["best_random"]["ratio"] == pytest.approx(motion.gain)
    assert set(said["condition_numbers"]) == set(said["best_random"]["condition_numbers"]) == {
        "raw", "unit_columns", "scaled"}
    assert "best of 2 random motions" in (tmp_path / "report.html").read_text()
    assert f"best of 2 random motions has {motion.gain:.2g} times the {motion.compared}" in motion.verdict.card()
    assert bool(of_kind(motion.diagnostics, "a random motion tells more")) == (motion.gain < 1)
    assert not of_kind(motion.best_random.diagnostics, "a random motion tells more")
    timid = Excitation(problem, problem.posture(problem.mean) + 0.3 * (x - problem.posture(problem.mean)), seed=1)
    assert criterion == "condition" or of_kind(timid.diagnostics, "a random motion tells more")
