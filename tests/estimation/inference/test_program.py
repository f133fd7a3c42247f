"""Programs handed on to CasADi and cvxpy have the optimum that the solvers find, also when a user extends them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import cvxpy as cp
import numpy as np
import pytest
from scipy import stats

from hydroopt.errors import ProblemError
from hydroopt.estimation.dynamic.estimate import Estimate
from hydroopt.estimation.dynamic.identify import identify
from hydroopt.estimation.dynamic.problem import IdentificationProblem
from hydroopt.estimation.inference.constraints import Constraint, Named, as_casadi
from hydroopt.estimation.inference.nlp import nonlinear_program
from hydroopt.estimation.inference.program import NonlinearProgram
from hydroopt.estimation.inference.whitening import gaussian_posterior

QUIET = {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.tol": 1e-9}


def by_hand(program: NonlinearProgram) -> tuple[np.ndarray, float]:
    answer = ca.nlpsol("solver", "ipopt", program.as_dict(), QUIET)(**program.arguments())
    return np.asarray(answer["x"]).ravel(), float(answer["f"])


def convex_by_hand(problem: cp.Problem) -> float:
    problem.solve(solver=cp.CLARABEL, tol_gap_abs=1e-10, tol_gap_rel=1e-10, tol_feas=1e-10)
    return float(problem.value)


def apart(estimate: Estimate, psi: np.ndarray) -> float:
    """Largest difference from an estimate, in standard deviations."""
    weighted = estimate.weighted_residuals
    slope = gaussian_posterior(estimate.problem, weighted.R, weighted.r).slope
    return float(np.max(np.abs(psi - estimate.psi) / np.linalg.norm(slope, axis=1)))


def objective(estimate: Estimate) -> float:
    """What the estimate minimises: the information about the distance from the least squares of every sample."""
    problem, weighted = estimate.problem, estimate.weighted_residuals
    scale, squares = problem.parameters.scale, problem.prior_misfit(estimate.psi)
    for i, score in enumerate(weighted.scores):
        K, f = [], []
        for data in problem.experiments:
            taken = data.inside & data.known[:, i]
            K.append(data.model.over(data.model.regressor, *data.inputs())[0][taken, i])
            f.append(data.force[taken, i])
        nearest = scale * np.linalg.lstsq(np.vstack(K) * scale, np.concatenate(f), rcond=1e-12)[0]
        size = stats.norm.ppf(0.975) / stats.t.ppf(0.975, np.minimum(score.freedom, 1e9))
        known = np.isfinite(score.freedom)  # the others are rounding errors
        squares += float(np.sum((size * (score.rows @ (estimate.psi - nearest)))[known] ** 2))
        squares += float(np.sum(score.right[~known] ** 2)) + score.rest
    return squares


def light_arm(p: Any) -> Any:
    return p["boom.m"] + p["stick.m"] <= 2300


def product(p: Any) -> Any:
    return p["boom.m"] * p["stick.m"] <= 1.1e6


@pytest.fixture(scope="module")
def noisy(noisy: IdentificationProblem) -> IdentificationProblem:
    """Without its holds, whose equations have weights of their own."""
    return noisy.with_experiments([replace(data, calm=None) for data in noisy.experiments])


@pytest.fixture(scope="module")
def constrained(noisy: IdentificationProblem) -> IdentificationProblem:
    return noisy.with_total_mass("arm", ["boom", "stick"], 2300.0).symmetric("boom", "xy").fix("swing.m", 8000.0)


@pytest.mark.parametrize("changed", [
    pytest.param(lambda problem: problem.subject_to("product", product), marks=pytest.mark.slow),
    pytest.param(lambda problem: problem.with_distance("log-det"), marks=pytest.mark.slow),
    pytest.param(lambda problem: problem.with_loss("huber"), marks=pytest.mark.slow)],
    ids=["user's constraint", "log-det", "huber"])
def test_ipopt_by_hand_finds_the_estimate(constrained: IdentificationProblem, changed: Any) -> None:
    problem = changed(constrained)
    program = problem.nlp()
    estimate = identify(problem, "nlp", intervals=False)
    x, cost = by_hand(program)
    assert apart(estimate, x[: len(estimate.psi)]) < 1e-6
    if problem.loss == "squares":
        # Cholesky products keep a margin of 1e-7 to the edge, which the log-det distance counts
        assert cost == pytest.approx(objective(estimate), rel=1e-9 if problem.distance == "gaussian" else 1e-8)
    assert {"arm", "symmetry of boom about xy", "physical consistency of stick"} <= set(program.g_names)
    assert program.values(x)["swing.m"] == pytest.approx(8000.0)


@pytest.mark.slow
def test_a_user_appends_a_constraint_in_casadi(constrained: IdentificationProblem) -> None:
    program = constrained.nlp()
    x, free = by_hand(program)
    found = program.values(x)
    limit = 0.97 * found["boom.m"] * found["stick.m"]
    extended = replace(program, g=ca.vertcat(program.g, program["boom.m"] * program["stick.m"]),
                       g_names=(*program.g_names, "product"), lbg=np.append(program.lbg, -np.inf),
                       ubg=np.append(program.ubg, limit))
    constrained = constrained.subject_to("product", lambda p: p["boom.m"] * p["stick.m"] <= limit)
    estimate = identify(constrained, "nlp", intervals=False)
    x, cost = by_hand(extended)
    assert apart(estimate, x[: len(estimate.psi)]) < 1e-6
    assert cost == pytest.approx(objective(estimate), rel=1e-9)
    assert cost > free + 1e-3  # the constraint is active


@pytest.mark.slow
def test_the_weights_are_fixed_numbers_of_the_program(noisy: IdentificationProblem) -> None:
    program = noisy.nlp()
    estimate = identify(noisy, "wls")
    expected = estimate.sigma * np.sqrt(estimate.correlation_time)
    np.testing.assert_allclose(program.p_value, expected, rtol=1e-12)
    assert program.p_names == tuple(f"{a.name}.sigma" for a in noisy.model.machine.actuators)
    assert program.p_units == ("N*m", "N", "N")
    cost = ca.Function("f", [program.x, program.p], [program.f])
    half, whole = (float(cost(program.x0, part * program.p_value)) for part in (0.5, 1.0))
    terms = [term._replace(triangle=0 * term.triangle) for term in estimate.weighted_residuals.terms]
    priors = nonlinear_program(noisy, terms)
    rest = float(ca.Function("f", [priors.x, priors.p], [priors.f])(priors.x0, priors.p_value))
    assert half - rest == pytest.approx(4 * (whole - rest), rel=1e-9)


@pytest.mark.parametrize("changed", [lambda problem: problem, lambda problem: problem.with_distance("log-det")],
                         ids=["gaussian", "log-det"])
@pytest.mark.slow
def test_clarabel_by_hand_finds_the_estimate(constrained: IdentificationProblem, changed: Any) -> None:
    problem = changed(constrained)
    program = problem.cvxpy()
    estimate = identify(problem, "sdp", intervals=False)
    cost = convex_by_hand(program.problem)
    assert apart(estimate, program.psi.value) < 1e-6
    assert cost == pytest.approx(objective(estimate), rel=1e-8)
    assert "physical consistency of stick" in program.constraints


def test_a_user_adds_a_constraint_in_cvxpy(noisy: IdentificationProblem) -> None:
    program = noisy.cvxpy()
    free = convex_by_hand(program.problem)
    limit = 0.97 * float((program["boom.m"] + program["stick.m"]).value)
    extended = cp.Problem(program.problem.objective, [
        *program.problem.constraints, program["boom.m"] + program["stick.m"] <= limit])
    lighter = noisy.subject_to("light arm", lambda p: p["boom.m"] + p["stick.m"] <= limit)
    estimate = identify(lighter, "sdp", intervals=False)
    cost = convex_by_hand(extended)
    assert apart(estimate, program.psi.value) < 1e-6
    assert cost == pytest.approx(objective(estimate), rel=1e-8)
    assert cost > free + 1e-3


@pytest.mark.slow
def test_the_two_programs_have_one_objective(noisy: IdentificationProblem) -> None:
    assert convex_by_hand(noisy.cvxpy().problem) == pytest.approx(by_hand(noisy.nlp())[1], rel=1e-6)


def test_what_is_not_convex_is_refused_by_cvxpy(noisy: IdentificationProblem) -> None:
    with pytest.raises(ProblemError, match=r"not convex: product; use problem\.nlp\(\)"):
        noisy.subject_to("product", product).cvxpy()


def test_unknown_names_and_wrong_sizes_are_refused(noisy: IdentificationProblem) -> None:
    program = noisy.nlp()
    with pytest.raises(ProblemError, match=r"'boom\.mass': the program has no such variable"):
        program["boom.mass"]
    with pytest.raises(ProblemError, match=r"parameter 'boom\.mass'"):
        noisy.cvxpy()["boom.mass"]
    with pytest.raises(ProblemError, match="g has 70 rows"):
        replace(program, g_names=())


def test_a_problem_prints_as_an_optimisation_model(constrained: IdentificationProblem) -> None:
    problem = constrained.subject_to("light arm", light_arm).subject_to("product", product)
    problem = problem.with_prior("scales", "stick.m", value=700.0, sigma=10.0)
    text = str(problem)
    for line in (r"variables ψ (82)", "boom.m                     kg      1830      366          0            –",
                 "residuals of boom_cylinder: Σ (e/σ)², e = f − K·ψ [N]", "prior scales: stick.m = 700 ± 10 kg",
                 "boom.m + stick.m = 2300              kg", "boom.m + stick.m ≤ 2300              kg",
                 "((boom.m*stick.m)<=1.1e+06)", "3 linear sums = 0"):
        assert line in text, line
    assert repr(problem) == ("IdentificationProblem(cat215b: 82 parameters, 2 training logs, loss squares, "
                             "4 constraints)")
    assert "boom_cylinder.sigma" in str(problem.nlp())


def test_a_program_in_matrix_symbols_has_empty_parts_of_their_type() -> None:
    x = ca.MX.sym("x", 2)
    program = NonlinearProgram(x=x, f=ca.sumsqr(x - 0.5), x_names=("a", "b"), x_units=("m", "m"), x0=np.zeros(2),
                               lbx=-np.ones(2), ubx=np.ones(2))
    assert {type(part) for part in program.as_dict().values()} == {ca.MX}
    np.testing.assert_allclose(by_hand(program)[0], 0.5, atol=1e-9)


def test_several_relations_at_once_are_refused(noisy: IdentificationProblem) -> None:
    parameters = noisy.parameters
    both = Constraint("both", lambda p: ca.vertcat(p["boom.m"], p["stick.m"]) <= 3000.0)
    with pytest.raises(ProblemError, match="constraint 'both': it does not return a relation"):
        as_casadi(both, Named(parameters, [ca.SX.sym(name) for name in parameters.names].__getitem__))
