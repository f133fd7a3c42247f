"""Constrained estimates: two solvers agree, hand-solved cases come out, and impossible wishes are refused by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import SimpleNamespace
from typing import Any

import casadi as ca
import clarabel as conic
import cvxpy as cp
import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.sparse import csc_matrix

from fixtures.tiers import tiered
from hydroopt.errors import ProblemError, SolverError
from hydroopt.estimation.dynamic.estimate import Estimate
from hydroopt.estimation.dynamic.identify import identify
from hydroopt.estimation.dynamic.problem import IdentificationProblem
from hydroopt.estimation.dynamic.regressor_qr import compress
from hydroopt.estimation.inference import clarabel, nlp
from hydroopt.estimation.inference.convex_program import Cone, cones, nearest_point, semidefinite_program
from hydroopt.estimation.inference.whitening import GaussianPosterior, gaussian_posterior
from hydroopt.spatial import inertia

OneBody = Callable[..., IdentificationProblem]


def prior_only(problem: IdentificationProblem) -> GaussianPosterior:
    p = len(problem.parameters)
    return gaussian_posterior(problem, np.zeros((p, p)), np.zeros(p))


@pytest.fixture(scope="module")
def by_sdp(noisy: IdentificationProblem) -> Estimate:
    return identify(noisy, "sdp", intervals=False)


# --- the same answer in other ways


@pytest.mark.slow
def test_interior_point_and_ipopt_agree_on_noisy_data(noisy: IdentificationProblem, by_sdp: Estimate) -> None:
    by_nlp = identify(noisy, "nlp", intervals=False)
    scale = noisy.parameters.scale
    np.testing.assert_allclose(by_sdp.psi / scale, by_nlp.psi / scale, atol=2e-4)
    for data, forces in by_sdp.predictions.items():
        for one, other in zip(forces, by_nlp.predictions[data], strict=True):
            np.testing.assert_allclose(one, other, atol=1e-4 * np.max(np.abs(one)))


def test_quadratic_program_without_active_constraints_is_the_bayesian_update(noisy: IdentificationProblem) -> None:
    free = noisy.subject_to("nothing", lambda p: p["boom.m"] >= -1e6)
    sigma = np.array([800.0, 3000.0, 2500.0])
    R, r, _ = compress(noisy.experiments).weighted(sigma)
    information, nominal = noisy.parameters.information, noisy.parameters.nominal
    expected = nominal + np.linalg.solve(R.T @ R + information + 1e-12 * np.diag(1 / noisy.parameters.scale**2),
                                         R.T @ (r - R @ nominal))
    posterior = gaussian_posterior(free, R, r)
    np.testing.assert_allclose(posterior.offset / noisy.parameters.scale, expected / noisy.parameters.scale, atol=1e-6)
    H = np.linalg.inv(posterior.slope @ posterior.slope.T)
    np.testing.assert_allclose(H, R.T @ R + information, atol=1e-6 * np.max(np.abs(H)))


def test_impossible_principal_moments_solved_by_hand(one_body: OneBody) -> None:
    # (1, 1, 3) violates I_xx + I_yy >= I_zz by one: the nearest on that plane shifts each by a third of it
    problem = one_body(np.array([50.0, 0, 0, 0, 1, 0, 0, 1, 0, 3]))
    for solution in (
        semidefinite_program(problem, prior_only(problem), consistent=True),
        nlp.interior_point(problem, prior_only(problem)),
    ):
        np.testing.assert_allclose(solution.psi, [50, 0, 0, 0, 4 / 3, 0, 0, 4 / 3, 0, 8 / 3], atol=1e-5)
        assert solution.active == ("physical consistency of arm",)


def test_negative_mass_becomes_the_lightest_body(one_body: OneBody) -> None:
    # without first moment the mass alone is wrong, and zero is the nearest that is not
    problem = one_body(np.array([1.0, 0, 0, 0, 2, 0, 0, 2, 0, 2])).with_prior("scale", "arm.m", value=-7.0, sigma=0.5)
    solution = semidefinite_program(problem, prior_only(problem), consistent=True)
    np.testing.assert_allclose(solution.psi, [0, 0, 0, 0, 2, 0, 0, 2, 0, 2], atol=1e-5)


@pytest.mark.parametrize("seed", tiered(range(4), lambda seed: seed == 0))
@pytest.mark.slow
def test_projection_on_possible_bodies_is_that_of_a_cholesky_factor(one_body: OneBody, seed: int) -> None:
    rng = np.random.default_rng(seed)
    phi = np.array([rng.uniform(1, 4), *rng.normal(0, 2, 9)])
    phi[[4, 7, 9]] = rng.uniform(0, 3, 3)
    assert inertia.smallest_eigenvalue(phi) < -0.1
    sigma = (0.7, 1.0, 1.6)
    weights = 1 / np.repeat(sigma, (1, 3, 6))

    def residual(entries: np.ndarray) -> np.ndarray:
        L = np.zeros((4, 4))
        L[np.tril_indices(4)] = entries
        second, moment, m = (L @ L.T)[:3, :3], (L @ L.T)[:3, 3], (L @ L.T)[3, 3]
        tensor = np.trace(second) * np.eye(3) - second
        return weights * (np.array([m, *moment, *tensor[np.triu_indices(3)]]) - phi)

    best = min((least_squares(residual, rng.normal(0, 1, 10), ftol=1e-10, max_nfev=400) for _ in range(2)),
               key=lambda answer: answer.cost)
    problem = one_body(phi, sigma)
    found = semidefinite_program(problem, prior_only(problem), consistent=True).psi
    np.testing.assert_allclose(found, phi + best.fun / weights, atol=2e-3)
    assert np.sum((weights * (found - phi)) ** 2) == pytest.approx(2 * best.cost, rel=1e-4)


# --- what constraints do


def test_every_body_is_possible_and_what_holds_it_is_named(by_sdp: Estimate) -> None:
    assert all(smallest > 0 for smallest in by_sdp.consistency.values())
    held = {a for a in by_sdp.active if a.startswith("physical consistency of ")}
    assert held
    for owner in by_sdp.consistency:
        k = by_sdp.problem.parameters.index(f"{owner}.I_xx")
        named = f"physical consistency of {owner}"
        assert by_sdp.bound[k] == (named if named in held else "")


def test_a_bound_that_holds_is_named_and_others_are_not(noisy: IdentificationProblem) -> None:
    pulled = noisy.with_prior("wrong", "stick_cylinder.f_coulomb", value=-5e4, sigma=10.0)
    estimate = identify(pulled, "qp", intervals=False)
    name = "stick_cylinder.f_coulomb"
    assert f"lower bound of {name}" in estimate.active
    assert estimate[name].value == pytest.approx(0, abs=1e-3)
    assert estimate.bound[noisy.parameters.index(name)] == f"lower bound of {name}"
    assert not any("f_offset" in bound for bound in estimate.bound)


def test_equality_holds_and_is_named(noisy: IdentificationProblem, by_sdp: Estimate) -> None:
    weighed = noisy.subject_to("weighbridge", lambda p: p["boom.m"] + p["stick.m"] == 3000)
    estimate = identify(weighed, "sdp", intervals=False)
    assert estimate["boom.m"].value + estimate["stick.m"].value == pytest.approx(3000, rel=1e-7)
    assert "weighbridge" in estimate.active
    assert abs(by_sdp["boom.m"].value + by_sdp["stick.m"].value - 3000) > 1


@pytest.mark.slow
def test_product_of_masses_by_ipopt(noisy: IdentificationProblem) -> None:
    curved = noisy.subject_to("product", lambda p: p["boom.m"] * p["stick.m"] == 1.2e6)
    with pytest.raises(SolverError, match=r"not convex.*'nlp'"):
        identify(curved, "sdp")
    estimate = identify(curved, "nlp", intervals=False)
    assert estimate["boom.m"].value * estimate["stick.m"].value == pytest.approx(1.2e6, rel=1e-6)
    assert "product" in estimate.active
    assert all(smallest > 0 for smallest in estimate.consistency.values())


@pytest.mark.slow
def test_fix_holds_at_a_value_or_the_nominal_one(noisy: IdentificationProblem) -> None:
    fixed = noisy.fix("boom.m", 1500.0).fix("stick_cylinder.f_offset")
    for method in ("qp", "sdp", "nlp"):
        estimate = identify(fixed, method, intervals=False)
        assert estimate["boom.m"].value == pytest.approx(1500, rel=1e-7)
        assert estimate["stick_cylinder.f_offset"].value == pytest.approx(0, abs=1e-3)
        assert estimate.bound[noisy.parameters.index("boom.m")] == "boom.m fixed"


@pytest.mark.slow
def test_priors_pull_by_name_and_by_expression(noisy: IdentificationProblem) -> None:
    by_name = identify(noisy.with_prior("scale", "boom.m", value=1234.0, sigma=1e-3), intervals=False)
    assert by_name["boom.m"].value == pytest.approx(1234, abs=0.01)
    both = noisy.with_prior("both", lambda p: 2 * p["boom.m"] - p["stick.m"] + 10, value=2000.0, sigma=1e-3)
    estimate = identify(both, intervals=False)
    assert 2 * estimate["boom.m"].value - estimate["stick.m"].value == pytest.approx(1990, abs=0.02)


def test_a_prior_weighs_as_much_as_its_sigma_says(one_body: OneBody) -> None:
    # 10 ± 1 of the file and 16 ± 2 of the user meet at (10 + 16/4)/(1 + 1/4), with 1/σ² = 1 + 1/4
    problem = one_body(np.array([10.0, 0, 0, 0, 1, 0, 0, 1, 0, 1])).with_prior("scale", "arm.m", value=16.0, sigma=2.0)
    posterior = prior_only(problem)
    assert posterior.offset[0] == pytest.approx(11.2, abs=1e-6)
    assert np.sum(posterior.slope[0] ** 2) == pytest.approx(0.8, abs=1e-6)


@pytest.mark.slow
def test_solving_changes_nothing(noisy: IdentificationProblem) -> None:
    before = noisy.parameters.nominal.copy()
    first, again = (identify(noisy, "sdp", seed=7) for _ in range(2))
    np.testing.assert_array_equal(first.psi, again.psi)
    np.testing.assert_array_equal(first.ci95, again.ci95)
    np.testing.assert_array_equal(noisy.parameters.nominal, before)
    with pytest.raises(AttributeError):
        noisy.consistent = False  # type: ignore[misc]


# --- what is refused


@pytest.mark.parametrize("method", ["qp", "sdp"])
def test_contradicting_wishes_are_named_and_no_others(noisy: IdentificationProblem, method: Any) -> None:
    wish = (noisy.subject_to("sane", lambda p: p["swing.m"] <= 1e5).subject_to("light", lambda p: p["boom.m"] == 1000)
            .subject_to("heavy", lambda p: p["boom.m"] == 2000))
    with pytest.raises(ProblemError) as refusal:
        identify(wish, method)
    assert refusal.value.what == "these cannot hold together: light; heavy"


@pytest.mark.slow
def test_weight_below_nothing_contradicts_the_body(noisy: IdentificationProblem) -> None:
    with pytest.raises(ProblemError) as refusal:
        identify(noisy.subject_to("balloon", lambda p: p["boom.m"] <= -5), "sdp")
    assert refusal.value.what == "these cannot hold together: physical consistency of boom; balloon"


def test_weight_below_nothing_contradicts_its_bound_where_bodies_are_free(noisy: IdentificationProblem) -> None:
    with pytest.raises(ProblemError) as refusal:
        identify(noisy.subject_to("balloon", lambda p: p["boom.m"] <= -5), "qp")
    assert refusal.value.what == "these cannot hold together: lower bound of boom.m; balloon"


@pytest.mark.slow
def test_ipopt_says_that_wishes_contradict(noisy: IdentificationProblem) -> None:
    wish = noisy.subject_to("light", lambda p: p["boom.m"] == 1000).subject_to("heavy", lambda p: p["boom.m"] == 2000)
    with pytest.raises(ProblemError) as refusal:
        identify(wish, "nlp")
    assert refusal.value.what == "these cannot hold together: light; heavy"
    with pytest.raises(SolverError, match="contradict each other"):  # what is not convex, nobody else can judge
        identify(wish.subject_to("product", lambda p: p["boom.m"] * p["stick.m"] == 1.2e6), "nlp")


@pytest.mark.parametrize("method", tiered(["sdp", "nlp"], lambda method: method == "sdp"))
@pytest.mark.parametrize("relation", [lambda p: None, lambda p: True, lambda p: p["boom.m"],
                                      lambda p: p["boom.m"] + p["stick.m"], lambda p: 2 * p["boom.m"]],
                         ids=["none", "bool", "parameter", "sum", "product"])
def test_what_is_no_relation_is_refused(noisy: IdentificationProblem, method: Any, relation: Any) -> None:
    with pytest.raises(ProblemError, match="constraint 'empty': it does not return a relation"):
        identify(noisy.subject_to("empty", relation), method)


@pytest.mark.parametrize("method", ["sdp", "nlp"])
def test_misspelt_parameter_gets_a_suggestion(noisy: IdentificationProblem, method: Any) -> None:
    with pytest.raises(ProblemError, match=r"did you mean boom\.m"):
        identify(noisy.subject_to("typo", lambda p: p["bom.m"] == 3), method)
    with pytest.raises(ProblemError, match=r"did you mean stick_cylinder\.f_coulomb"):
        noisy.fix("stick_cylinder.f_coulom")


@pytest.mark.parametrize("method", ["wls", "ridge", "tsvd"])
def test_linear_methods_refuse_what_they_cannot_honour(noisy: IdentificationProblem, method: Any) -> None:
    for extended in (noisy.subject_to("mine", lambda p: p["boom.m"] == 3), noisy.fix("boom.m"),
                     noisy.with_prior("mine", "boom.m", value=3.0, sigma=1.0)):
        with pytest.raises(ProblemError, match=rf"'{method}' cannot honour (mine|boom\.m fixed); use qp, sdp or nlp"):
            identify(extended, method)


@pytest.mark.parametrize(
    ("expression", "sigma"),
    [
        (lambda p: p["boom.m"] ** 2, 1.0),
        (lambda p: p["boom.m"] * p["stick.m"], 1.0),
        (lambda p: ca.vertcat(p["boom.m"], p["stick.m"]), 1.0),
        ("boom.m", 0.0),
        ("boom.m", -1.0),
        ("boom.m", float("nan")),
    ],
    ids=["square", "product", "vector", "zero", "negative", "nan"],
)
def test_priors_that_are_none_are_refused(noisy: IdentificationProblem, expression: Any, sigma: float) -> None:
    with pytest.raises(ProblemError, match="prior 'odd'"):
        noisy.with_prior("odd", expression, value=1.0, sigma=sigma)


def test_functions_of_casadi_are_for_the_nonlinear_method(noisy: IdentificationProblem) -> None:
    def root(p: Mapping[str, Any]) -> Any:
        return ca.sqrt(p["stick.m"]) <= 20.0

    with pytest.raises(ProblemError, match=r"constraint 'root': its function failed \(Wrong .*method 'nlp'") as caught:
        identify(noisy.subject_to("root", root), intervals=False)
    assert "prototypes" not in str(caught.value)
    for expression in (lambda p: ca.sqrt(p["stick.m"]), lambda p: cp.sqrt(p["stick.m"])):
        with pytest.raises(ProblemError, match=r"prior 'root': .*state what is not linear by subject_to .* 'nlp'"):
            noisy.with_prior("root", expression, value=20.0, sigma=1.0)


def test_names_of_constraints_are_taken_once(noisy: IdentificationProblem) -> None:
    once = noisy.subject_to("mine", lambda p: p["boom.m"] == 3)
    with pytest.raises(ProblemError, match="same name"):
        once.subject_to("mine", lambda p: p["boom.m"] == 4)


def test_clarabel_finds_what_cvxpy_finds(one_body: OneBody) -> None:
    problem = one_body(np.array([50.0, 0, 0, 0, 1, 0, 0, 1, 0, 3]))
    within = cones(problem.requirements(consistent=True), prior_only(problem))
    found = nearest_point(np.zeros(10), within, "test")
    assert found is not None
    z = cp.Variable(10)
    cp.Problem(cp.Minimize(cp.sum_squares(z)), [cone.in_cvxpy(z) for cone in within]).solve(solver=cp.CLARABEL)
    np.testing.assert_allclose(found[0], z.value, atol=1e-6)
    assert found[1] == {"physical consistency of arm"}


def test_the_certificate_refuses_what_is_not_the_minimum() -> None:
    """(0, 2) is the point nearest to (−1, 2) whose first coordinate is not negative, with the multiplier 1."""
    program = csc_matrix(np.eye(2)), np.array([1.0, -2.0]), csc_matrix([[-1.0, 0.0]]), np.zeros(1)
    right = np.array([0.0, 2.0]), np.zeros(1), np.ones(1)
    clarabel.certificate(*program, *right).trust("test")
    for wrong in (np.array([0.1, 2.0]), np.array([0.0, 1.9]), np.array([-1.0, 2.0])):
        with pytest.raises(SolverError, match="failed our check"):
            clarabel.certificate(*program, wrong, *right[1:]).trust("test")
    with pytest.raises(SolverError, match="stationarity"):
        clarabel.certificate(*program, *right[:2], np.zeros(1)).trust("test")
    with pytest.raises(SolverError, match="stationarity"):  # inside, where nothing holds it back
        clarabel.certificate(*program, np.array([0.5, 2.0]), np.array([0.5]), np.array([1.5])).trust("test")


def test_contradicting_cones_have_no_point() -> None:
    away = [Cone("above", False, -np.ones(1), np.eye(1)), Cone("below", False, -np.ones(1), -np.eye(1))]
    assert nearest_point(np.zeros(1), away, "test") is None


def test_a_program_that_is_almost_solved_is_tried_another_way(monkeypatch: pytest.MonkeyPatch) -> None:
    real, scaled = conic.DefaultSolver, list[bool]()

    class Tired:
        def __init__(self, *given: object) -> None:
            self.given = given

        def solve(self) -> SimpleNamespace:
            found = real(*self.given).solve()
            scaled.append(self.given[-1].equilibrate_enable)
            first = len(scaled) == 1
            return SimpleNamespace(status="AlmostSolved" if first else found.status, x=np.array(found.x) - 1e-3 * first,
                                   s=found.s, z=found.z)

    monkeypatch.setattr(conic, "DefaultSolver", Tired)
    found = nearest_point(np.array([-1.0, 2.0]), [Cone("positive", False, np.zeros(1), np.array([[1.0, 0.0]]))], "test")
    assert found is not None
    assert found[0] == pytest.approx([0.0, 2.0], abs=1e-7)
    assert scaled == [False, True]
