"""The search for a motion: exact derivatives, the same motion twice, and what cannot be kept is named."""

from __future__ import annotations

import json
import pickle
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from fixtures.tiers import tiered
from hydroopt import Model, load_machine, read_log, solve
from hydroopt.errors import ProblemError
from hydroopt.estimation.inference.identifiability import structural
from hydroopt.excitation.criteria import CRITERIA, Information, design_parameters, presumed_noise
from hydroopt.excitation.motion.basis import Basis, Fourier, Spline
from hydroopt.excitation.motion.design import design, excitation_problem, random_motion, resting_posture
from hydroopt.excitation.motion.excitation import Excitation
from hydroopt.excitation.motion.problem import ExcitationProblem
from hydroopt.excitation.motion.sqp import Search, sequential_quadratic_programming
from hydroopt.limits.limits import Limits
from hydroopt.limits.reserves import Reserves
from hydroopt.machine.environment import Obstacle, Pump
from hydroopt.machine.links import Box
from hydroopt.machine.machine import Machine
from hydroopt.report.excitation import render, render_sheet
from hydroopt.results.answer import load
from hydroopt.simulation.reference_motion import reference_motion
from hydroopt.simulation.simulate import random_trajectory

CAT, LIFT = load_machine("cat215b"), load_machine("patu655_lift")
SHORT, SWINGING = Spline(5.0, 4), Fourier(6.0, 2, blend=1.0)


def program(machine: Machine, basis: Basis = SHORT, criterion: str = "D", resting: dict[str, float] | None = None,
            rate: float = 20.0) -> ExcitationProblem:
    model = Model(machine)
    asked = design_parameters(model, presumed_noise(model))
    return ExcitationProblem(Information(model, asked, criterion), Limits(model), basis, rate, resting)


def somewhere(of: ExcitationProblem, seed: int = 0) -> np.ndarray:
    """Variables of a motion about the middle of the joints' ranges."""
    middle = of.posture(of.mean)
    return middle + 0.1 * np.random.default_rng(seed).standard_normal(len(middle))


@pytest.mark.parametrize(("basis", "resting"), [
    pytest.param(SHORT, None, id="spline-all move"), pytest.param(SHORT, {"boom": -0.3}, id="spline-one rests"),
    pytest.param(SWINGING, None, id="series-all move"),
    pytest.param(SWINGING, {"boom": -0.3}, id="series-one rests")])
def test_derivatives_are_those_of_finite_differences(basis: Basis, resting: dict[str, float] | None) -> None:
    """Of criterion and limits by the variables, in a random direction."""
    of = program(CAT, basis, resting=resting)
    x = somewhere(of)
    step, h = np.random.default_rng(1).standard_normal(len(x)), 1e-5
    value, gradient = of.objective(x)
    assert value == pytest.approx(of.value(x), rel=1e-12)
    # rounding asks for wide steps, and Richardson's extrapolation makes these accurate
    narrow, wide = ((of.value(x + k * step) - of.value(x - k * step)) / (2 * k) for k in (1e-4, 2e-4))
    slope = (4 * narrow - wide) / 3
    assert gradient @ step == pytest.approx(slope, rel=1e-6, abs=1e-6)
    change = (of.constraints(x + h * step) - of.constraints(x - h * step)) / (2 * h)
    slopes = of.slopes(x)
    size = np.max(np.abs(change), axis=0) + 1e-4  # rounding reaches 1e-11 of what a resting joint does not change
    assert np.max(np.abs(of.directional_derivative(slopes, step) - change) / size) < 1e-6
    weights = np.random.default_rng(2).standard_normal(change.shape) / size
    assert of.weighted_gradient(slopes, weights) @ step == pytest.approx(np.sum(weights * change), rel=1e-5)
    taken = np.random.default_rng(3).uniform(size=change.shape) < 0.05
    assert np.max(np.abs(of.jacobian(slopes, taken) @ step - change[taken]) / (taken * size)[taken]) < 1e-6


@pytest.mark.parametrize("bayesian", [False, True])
def test_value_is_that_of_sums_over_samples(bayesian: bool) -> None:
    """Information by the regressor of every sample, with the file's priors of the base parameters if they count."""
    model = Model(LIFT)
    seen, scale = structural(model), model.parameters.scale
    asked = design_parameters(model, presumed_noise(model), bayesian=bayesian)
    motion = random_trajectory(model, duration=10, rate=20, seed=2)
    information = np.zeros((len(seen.basis), len(seen.basis)))
    for q, qd, qdd in zip(motion.q, motion.qd, motion.qdd, strict=True):
        rows = np.asarray(model.regressor(q, qd, qdd))[:, list(seen.basis)] / presumed_noise(model)[:, None]
        information += rows.T @ rows
    if bayesian:  # this file says something of every parameter
        information += np.linalg.inv(seen.grouping @ np.linalg.inv(model.parameters.information) @ seen.grouping.T)
    scaled = information * np.outer(scale[list(seen.basis)], scale[list(seen.basis)])
    values = np.linalg.eigvalsh(np.linalg.inv(scaled))
    expected = {"D": np.mean(np.log(values)), "A": np.log(np.mean(values)), "E": np.log(values[-1]),
                "condition": np.log(values[-1] / values[0]) / 2}
    for criterion in CRITERIA:
        of = Information(model, asked, criterion)
        found = of.of(of.factor(motion.q, motion.qd, motion.qdd, 1.0))[0]
        assert found == pytest.approx(expected[criterion], rel=1e-5, abs=1e-5)


@pytest.mark.slow
def test_same_seed_gives_the_same_motion() -> None:
    one, other = (design(program(LIFT, SWINGING), starts=5, seed=3) for _ in range(2))
    np.testing.assert_array_equal(one.coefficients, other.coefficients)
    assert one.value == other.value
    assert not one.stopped


@pytest.mark.slow
def test_more_starts_are_never_worse() -> None:
    of = program(LIFT, SWINGING)
    found = [design(of, starts=starts) for starts in (1, 2, 4)]

    def error(one: Excitation) -> float:
        return float(np.sum(np.log(np.hypot(one.accuracy.base, one.accuracy.bias))))

    # by the criterion, or, where smoothing takes more than noise adds, by both together
    for few, more in pairwise(found):
        smoothed = np.any(few.accuracy.bias > few.accuracy.base)
        assert more.value <= few.value or (smoothed and error(more) <= error(few))


@pytest.mark.parametrize("criterion", tiered(CRITERIA, lambda criterion: criterion == "D"))
def test_motion_tells_more_than_random_ones(criterion: str) -> None:
    """Than random series within all limits, each as wide as they admit."""
    of = program(LIFT, SWINGING, criterion)
    found, rng = design(of, starts=2), np.random.default_rng(5)
    middle, others = of.posture(of.mean), []
    for _ in range(30):
        wave = rng.standard_normal(len(middle))
        for part in 0.9 ** np.arange(60):
            if of.excess(middle + part * wave, of.fine) <= 0:
                others.append(of.value(middle + part * wave))
                break
    assert len(others) == 30
    assert found.value < min(others)


@pytest.mark.slow
def test_program_travels_between_processes() -> None:
    for of in (program(CAT, SWINGING, "A", {"swing": 0.1}), program(LIFT, SHORT, "E")):
        again, x = pickle.loads(pickle.dumps(of)), somewhere(of)
        assert again.value(x) == of.value(x)
        np.testing.assert_array_equal(again.objective(x)[1], of.objective(x)[1])
        np.testing.assert_array_equal(again.constraints(x), of.constraints(x))
        np.testing.assert_array_equal(again.coefficients(x), of.coefficients(x))
        assert [row.name for row in again.limits.rows] == [row.name for row in of.limits.rows]
        assert (again.basis, again.rate, again.resting) == (of.basis, of.rate, of.resting)


def relieved(bar: float) -> Machine:
    """The excavator with another relief valve of its boom."""
    return CAT.model_copy(update={"cylinders": tuple(
        each.model_copy(update={"relief_pressure": bar * 1e5}) if each.name == "boom_cylinder" else each
        for each in CAT.cylinders)})


def ball(centre: tuple[float, float, float], radius: float) -> tuple[Obstacle, ...]:
    return (Obstacle(name="shed", link="base", centre=centre, radius=radius),)


NOWHERE = Box(lower=(5.0, -1.0, -1.0), upper=(7.0, 1.0, 1.0))
IMPOSSIBLE = {
    "a ball around everything": ({"obstacles": ball((0.0, 0.0, 0.0), 30.0)},
                                 "distance of .* to shed.* cannot be kept in any"),
    "ground above everything": ({"ground": 20.0}, "boom above ground, stick above ground.* cannot be kept in any"),
    "relief below what holds the boom": (dict(relieved(20.0)), "boom_cylinder p_head.* cannot be kept in any"),
    "a ball that fills the workspace": (
        {"obstacles": ball((6.0, 0.0, 0.0), 3.0), "workspace": NOWHERE},
        "workspace along x, .*distance of .* to shed.* cannot be kept together in any"),
    "nowhere": ({"workspace": Box(lower=(-1.0, -1.0, 30.0), upper=(1.0, 1.0, 31.0))},
                "workspace along z cannot be kept in any")}


@pytest.mark.parametrize("kind", tiered(IMPOSSIBLE, lambda kind: list(IMPOSSIBLE).index(kind) < 1))
def test_limits_in_conflict_are_named(kind: str) -> None:
    changes, named = IMPOSSIBLE[kind]
    machine = CAT.model_copy(update={key: changes[key] for key in changes if key in (
        "obstacles", "ground", "workspace", "cylinders")})
    with pytest.raises(ProblemError, match=named) as caught:
        design(program(machine), starts=1, search_seconds=2.0)
    assert "machine file" in caught.value.remedy
    assert "tipping" not in caught.value.what


@pytest.mark.slow
def test_posture_of_a_joint_that_rests_may_be_what_cannot_be_kept() -> None:
    """With the boom raised, the tip is never low enough; by itself either can be kept."""
    high = CAT.model_copy(update={"workspace": Box(lower=(-9.0, -9.0, -9.0), upper=(9.0, 9.0, -1.0))})
    design(program(high), starts=1, search_seconds=1.0)
    with pytest.raises(ProblemError, match=r"workspace along z .*posture of joints that rest"):
        design(program(high, resting={"boom": CAT.link("boom").joint.range[0]}), starts=1, search_seconds=1.0)


@pytest.mark.parametrize("litres", [60.0, 0.6])
@pytest.mark.slow
def test_small_pump_leaves_a_small_motion(litres: float) -> None:
    flow = litres / 60e3
    found = design(program(CAT.model_copy(update={"pump": Pump(max_flow=flow)})), starts=1, search_seconds=2.0)
    model, path = found.problem.information.model, found.trajectory
    speed = model.over(model.cylinder_kinematics, path.q, path.qd, path.qdd)[1][:, :, 0]
    motor = CAT.motors[0]
    drawn = abs(path.qd[:, 0]) * motor.torque_per_pressure * motor.gear + sum(
        np.where(speed[:, k] > 0, each.areas[0], -each.areas[1]) * speed[:, k]
        for k, each in enumerate(CAT.cylinders))
    assert 0.3 * flow < np.max(drawn) <= flow * (1 + 1e-9)
    assert min(use.room for use in found.limits) >= 0


def test_a_search_cut_short_says_so_before_anything_else() -> None:
    """On the first line of the card and of the finding, and in the method that JSON files and pages state."""
    found = design(program(LIFT), starts=3, search_seconds=0.01)
    cut = "cut short after 0.01 s"
    assert cut in found.verdict.card().splitlines()[0].partition(": ok")[0]
    assert found.verdict.finding.startswith(f"The search was {cut}. ")
    assert cut in found.content()["method"]
    assert found.content()["stopped"] == "after 0.01 s"
    assert "cut" not in str(replace(found, stopped="").verdict.card())


def test_a_time_limit_without_a_motion_is_no_interruption(monkeypatch: pytest.MonkeyPatch) -> None:
    """Only Ctrl-C interrupts: a script that gives too little time goes on with the sentence that says so."""
    monkeypatch.setattr("hydroopt.excitation.motion.design._ended", lambda problem, rest, *_: (rest, (0.0, 0.0)))
    with pytest.raises(ProblemError, match=r"by any motion that was tried in 0\.01 s, .* or give more time"):
        design(program(LIFT), starts=1, search_seconds=0.01)


@pytest.mark.parametrize("pace", [0.0, -0.5, 1.2, float("nan")])
def test_a_pace_out_of_range_is_refused(pace: float) -> None:
    problem = program(LIFT)
    with pytest.raises(ProblemError, match="cannot be driven at"):
        Excitation(problem, problem.posture(problem.mean)).at_pace(pace)


def test_pages_say_at_which_part_of_its_pace_a_motion_is_driven() -> None:
    problem = program(LIFT)
    rng = np.random.default_rng(1)
    motion = Excitation(problem, random_motion(problem, resting_posture(problem, rng), rng))
    for page in (render, render_sheet):
        assert "designed pace" not in page(motion)
        assert "50 % of the designed pace" in page(motion.at_pace(0.5))


def test_nothing_to_try_is_refused() -> None:
    for options in ({"starts": 0}, {"processes": 0}, {"search_seconds": 0.0}, {"search_seconds": float("nan")}):
        with pytest.raises(ProblemError, match="no start, process or time"):
            design(program(LIFT), **options)


@pytest.mark.parametrize("end", [0, 1])
@pytest.mark.slow
def test_joint_that_rests_at_the_end_of_its_range_is_no_hindrance(end: int) -> None:
    """Room is left only where something moves; else no start would ever be improved."""
    asked = excitation_problem(CAT, Spline(8.0, 5), resting={"stick": CAT.link("stick").joint.range[end]})
    still = resting_posture(asked, np.random.default_rng(0))
    start = random_motion(asked, still, np.random.default_rng(1))
    found = sequential_quadratic_programming(asked, Search.at(start), 0.002, lambda: False, lambda _: None).best
    assert asked.value(found) < asked.value(start) - 0.1
    assert asked.excess(found, asked.grid) <= 0


def test_ipopt_by_hand_finds_no_better_motion_from_the_same_start() -> None:
    """The program that the user gets, against our own solver's optimum, near which IPOPT starts and from afar.

    Without reserves: uncertain friction, which jumps at reversals, makes many local optima.
    """
    problem = excitation_problem(load_machine("patu655_lift"), Fourier(6.0, 2, 1, 1.0), rate=50.0,
                                 reserves=Reserves.none())
    start = random_motion(problem, resting_posture(problem, np.random.default_rng(0)), np.random.default_rng(1))
    found = sequential_quadratic_programming(problem, Search.at(start), 0.0, lambda: False, lambda _: None).best
    program = problem.nlp(start)
    assert program.g_names[: len(problem.limits.rows)] == tuple(row.name for row in problem.limits.rows)
    text = str(problem)
    assert "lift sin2" in text
    assert "criterion D" in text
    assert "lift_cylinder stroke" in text
    options = {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.tol": 1e-8,
               "ipopt.hessian_approximation": "limited-memory", "ipopt.max_iter": 300}
    answer = ca.nlpsol("by_hand", "ipopt", program.as_dict(), options)(**program.arguments())
    x = np.asarray(answer["x"]).ravel()
    assert float(answer["f"]) == pytest.approx(problem.value(x), abs=1e-12)
    assert problem.excess(x, problem.grid) <= 1e-6
    assert problem.value(x) == pytest.approx(problem.value(found), abs=1e-3)
    with pytest.raises(ProblemError, match="not convex"):
        problem.cvxpy()


def test_a_design_is_loaded_as_it_was_saved(tmp_path: Path) -> None:
    motion = solve(excitation_problem(load_machine("patu655_lift"), Fourier(6.0, 2, 1, 1.0), rate=50.0), starts=1,
                   search_seconds=2.0)
    motion.save(tmp_path)
    loaded = load(tmp_path)
    assert repr(loaded) == repr(motion)
    assert loaded.diagnostics == motion.diagnostics
    assert loaded.parameters == motion.parameters
    assert loaded.details() == json.loads(json.dumps(motion.details()))
    path = reference_motion(motion.problem.machine, read_log(tmp_path / "trajectory.csv"))
    np.testing.assert_allclose(path.q, motion.trajectory.q, rtol=1e-12)
