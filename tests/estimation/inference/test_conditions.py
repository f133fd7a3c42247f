"""What is known of bodies: it holds, it is named, contradictions are refused by name, distances are what they say."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize, nnls
from scipy.stats import wishart

from fixtures.tiers import tiered
from hydroopt.errors import ProblemError, SolverError
from hydroopt.estimation.dynamic.calibrated import calibrated_machine
from hydroopt.estimation.dynamic.diagnostics import diagnose
from hydroopt.estimation.dynamic.identify import identify
from hydroopt.estimation.dynamic.problem import IdentificationProblem, identification_problem
from hydroopt.estimation.inference import conditions as physics
from hydroopt.estimation.inference import convex_program, nlp
from hydroopt.estimation.inference.identifiability import structural
from hydroopt.estimation.inference.posterior import sample
from hydroopt.estimation.inference.whitening import gaussian_posterior
from hydroopt.logs.smoothing import Fourier
from hydroopt.machine.links import Note, Shape
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import dump_machine, load_machine, read_machine
from hydroopt.model.model import Model
from hydroopt.report.identification import render
from hydroopt.results.diagnostic import of_kind
from hydroopt.spatial import inertia

PHI = inertia.from_centre_of_mass(10.0, [0.5, 0.1, 0.05], [0.2, 0.02, 0.01, 1.0, 0.01, 1.1])
SHAPES = {
    "box": Shape.model_validate({"box": {"lower": (-0.5, -0.4, -0.3), "upper": (1.5, 0.5, 0.4)}}),
    "ellipsoid": Shape.model_validate({"ellipsoid": {"centre": (0.5, 0.1, 0.0), "semi_axes": (1.2, 0.6, 0.5)}}),
    "cylinder": Shape.model_validate({"cylinder": {"radius": 0.5, "start": -0.4, "end": 1.6}}),
}
METHODS = ("sdp", "qp", "nlp")


def one_body(phi: np.ndarray = PHI, sigma: tuple[float, float, float] = (1.0, 1.0, 1.0), *,
             mass: Note | None = None, **stated: Any) -> IdentificationProblem:
    """A problem whose only unknown is one body, `phi` ± `sigma`, of which the file states something."""
    link = {"name": "arm", "parent": "base", "joint": {"type": "revolute", "lower": -1.0, "upper": 1.0},
            "body": {"m": phi[0], "mc": tuple(phi[1:4]), "inertia": tuple(phi[4:]), **stated}}
    notes = {f"arm.body.{key}": Note(sigma=s) for key, s in zip(("m", "mc", "inertia"), sigma, strict=True)}
    return IdentificationProblem(Model(Machine.model_validate(
        {"name": "arm", "links": [link], "drives": [{"name": "drive", "joint": "arm"}],
         "notes": notes | ({"arm.body.m": mass} if mass else {})})), ())


def nothing(p: int = 10) -> tuple[np.ndarray, np.ndarray]:
    """Data that say nothing."""
    return np.zeros((p, p)), np.zeros(p)


def solved(problem: IdentificationProblem, method: str,
           data: tuple[np.ndarray, np.ndarray] | None = None) -> convex_program.Optimum:
    posterior = gaussian_posterior(problem, *(data or nothing(len(problem.parameters))))
    return (nlp.interior_point(problem, posterior) if method == "nlp"
            else convex_program.semidefinite_program(problem, posterior, consistent=method == "sdp"))


def of_points(points: np.ndarray, masses: np.ndarray) -> np.ndarray:
    """φ of point masses, from the definition of moments of inertia."""
    tensor = sum(m * ((x @ x) * np.eye(3) - np.outer(x, x)) for x, m in zip(points, masses, strict=True))
    return np.array([masses.sum(), *(masses @ points), *tensor[np.triu_indices(3)]])


def contains(shape: Shape, points: np.ndarray) -> np.ndarray:
    """Whether points lie inside, from the definition of each shape."""
    if shape.box:
        return np.all((points >= shape.box.lower) & (points <= shape.box.upper), axis=1)
    if shape.ellipsoid:
        return np.sum(((points - shape.ellipsoid.centre) / shape.ellipsoid.semi_axes) ** 2, axis=1) <= 1
    tube = shape.cylinder
    assert tube
    return (np.hypot(points[:, 1], points[:, 2]) <= tube.radius) & (points[:, 0] >= tube.start) & (
        points[:, 0] <= tube.end)


def cloud(shape: Shape, rng: np.random.Generator, number: int) -> tuple[np.ndarray, np.ndarray]:
    """Points inside the shape, and others outside."""
    points = rng.uniform([-2, -2, -2], [3, 2, 2], (150 * number, 3))
    good = contains(shape, points)
    return points[good][:number], points[~good][:number]


# --- shapes


@pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES)
def test_point_masses_inside_fulfil_and_each_one_outside_violates(shape: Shape) -> None:
    rng = np.random.default_rng(0)
    inner, outer = cloud(shape, rng, 300)
    conditions = physics.inside(one_body().parameters, "arm", shape)
    for k in range(0, 300, 3):
        few = of_points(inner[k : k + 3], rng.uniform(0.01, 5, 3))
        assert min(c.margin(few) for c in conditions) > -1e-12
    for point in outer:
        lonely = of_points(point[None], np.array([rng.uniform(0.01, 5)]))
        assert min(c.margin(lonely) for c in conditions if c.name.startswith("density")) < 0
        assert min(c.margin(lonely) for c in conditions if c.name.startswith("centre of mass")) < 0


@pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES)
@pytest.mark.slow
def test_no_density_inside_is_ruled_out_and_for_an_ellipsoid_none_else_passes(shape: Shape) -> None:
    """Non-negative least squares looks for masses at many points inside that have the ten parameters."""
    rng = np.random.default_rng(1)
    inner, _ = cloud(shape, rng, 3000)
    atoms = np.column_stack([of_points(x[None], np.ones(1)) for x in inner])
    conditions = physics.inside(one_body().parameters, "arm", shape)
    passed = []
    for _ in range(60):
        phi = of_points(rng.normal([0.5, 0.1, 0.0], [0.8, 0.33, 0.27], (9, 3)), rng.dirichlet(np.ones(9)))
        margin = min(c.margin(phi) for c in conditions)
        short = nnls(atoms, phi)[1]
        assert margin > 0 or short > 1e-9
        if margin > 0.01:
            passed.append(short)
    assert 5 < len(passed) < 50
    if shape.ellipsoid:
        assert max(passed) < 1e-6


def test_every_way_of_stating_a_cylinder_is_the_same() -> None:
    """A cylinder in a box of its size: what the box rules out of the slab along x, the cylinder does."""
    box = Shape.model_validate({"box": {"lower": (-0.4, -9, -9), "upper": (1.6, 9, 9)}})
    np.testing.assert_allclose(box.faces[[0, 3]], SHAPES["cylinder"].faces)


@pytest.mark.parametrize("method", METHODS)
def test_centre_of_mass_is_held_at_the_wall_and_named(method: str) -> None:
    """A sharply known mass of 10 kg cannot have its moment beyond the wall.

    The ellipsoid's tip lies at y = 0.1 m, off the plane of symmetry.
    """
    for kind, wall in (("box", 1.5), ("ellipsoid", 0.5 + 1.2 * np.sqrt(1 - (0.1 / 0.6) ** 2)), ("cylinder", 1.6)):
        problem = one_body(sigma=(1e-4, 5.0, 50.0), shape=SHAPES[kind]).with_prior(
            "pull", "arm.mc_x", value=30.0, sigma=1.0)
        if kind == "ellipsoid":
            problem = problem.symmetric("arm", "xz").symmetric("arm", "xy")
        found = solved(problem, method)
        held = {"centre of mass of arm inside its shape", "density of arm inside its shape"} & set(found.active)
        assert held, found.active
        assert found.psi[1] / found.psi[0] <= wall + 1e-6
        if method == "qp":
            assert "centre of mass of arm inside its shape" in held
            assert found.psi[1] / found.psi[0] == pytest.approx(wall, abs=1e-4)


@pytest.mark.parametrize("method", METHODS)
def test_density_is_held_where_inertia_is_too_large_for_the_shape_and_named(method: str) -> None:
    for shape in SHAPES.values():
        found = solved(one_body(shape=shape).with_prior("pull", "arm.I_yy", value=60.0, sigma=0.1), method)
        assert "density of arm inside its shape" in found.active
        assert "centre of mass of arm inside its shape" not in found.active
        assert min(c.margin(found.psi) for c in physics.inside(one_body().parameters, "arm", shape)) > -1e-6


@pytest.mark.parametrize("kind", SHAPES)
def test_solvers_agree_where_shapes_hold(kind: str) -> None:
    problem = (one_body(shape=SHAPES[kind]).with_prior("pull", "arm.I_yy", value=30.0, sigma=0.5)
               .with_prior("aside", "arm.mc_x", value=14.0, sigma=0.5))
    one, other = solved(problem, "sdp"), solved(problem, "nlp")
    np.testing.assert_allclose(one.psi, other.psi, atol=2e-4)
    assert set(one.active) == set(other.active)


@pytest.mark.slow
def test_samples_respect_a_shape_as_rejection_does() -> None:
    problem = one_body(sigma=(0.5, 0.5, 0.5), shape={"ellipsoid": {
        "centre": (0.5, 0.1, 0.0), "semi_axes": (0.7, 0.35, 0.27)}})
    std = np.repeat(0.5, 10)
    draws = PHI + np.random.default_rng(3).standard_normal((400_000, 10)) * std
    J = np.tensordot(draws, inertia.PSEUDO_BASIS, axes=1)
    A = np.diag(1 / np.array([0.7, 0.35, 0.27]))
    B = np.column_stack([A, -A @ [0.5, 0.1, 0.0]])
    good = (np.linalg.eigvalsh(J)[:, 0] > 0) & (draws[:, 0] > np.einsum("ki,nij,kj->n", B, J, B))
    kept = draws[good]
    assert 300 < len(kept) < 0.5 * np.sum(np.linalg.eigvalsh(J)[:, 0] > 0)
    drawn = [sample(problem, *nothing(), PHI, consistent=True, seed=seed) for seed in range(10)]
    samples = np.concatenate([posterior.samples for posterior in drawn if posterior is not None])
    np.testing.assert_allclose((samples.mean(axis=0) - kept.mean(axis=0)) / std, 0, atol=0.12)
    np.testing.assert_allclose(samples.std(axis=0), kept.std(axis=0), rtol=0.12)
    assert min(c.margin(psi) for c in problem.conditions for psi in samples[::50]) > 0


# --- a machine that states everything


@pytest.fixture(scope="module")
def truth(cat215b: Model, cat_truth: np.ndarray) -> np.ndarray:
    """A truth with a symmetric boom and barrels alike."""
    psi, parameters = cat_truth.copy(), cat215b.parameters
    psi[[parameters.index(f"boom.{name}") for name in ("mc_z", "I_xz", "I_yz")]] = 0.0
    barrels = [parameters.index(f"{name}_cylinder.barrel.m") for name in ("boom", "stick")]
    psi[barrels[1] : barrels[1] + 10] = psi[barrels[0] : barrels[0] + 10]
    psi[parameters.index("stick_cylinder.f_coulomb")] = psi[parameters.index("boom_cylinder.f_coulomb")]
    for name in ("n_barrel", "n_rod"):
        psi[parameters.index(f"stick_cylinder.{name}")] = psi[parameters.index(f"boom_cylinder.{name}")]
    return psi


STATED = ("centre of mass of boom inside its shape", "density of boom inside its shape", "symmetry of boom about xy",
          "centre of mass of stick inside its shape", "density of stick inside its shape",
          "centre of mass of boom_cylinder.barrel inside its shape", "density of boom_cylinder.barrel inside its shape",
          "jacks", "weighbridge")


def described(truth: np.ndarray, parameters: Any, sigma: float | None = None) -> Machine:
    """The excavator with true statements about its bodies."""
    data = load_machine("cat215b").model_dump()
    boom, stick = (next(link["body"] for link in data["links"] if link["name"] == name) for name in ("boom", "stick"))
    boom |= {"symmetric": "xy", "shape": {"box": {"lower": (-5.0, -4.0, -2.5), "upper": (9.0, 4.0, 2.5)}}}
    stick["shape"] = {"ellipsoid": {"centre": (1.0, 0.0, 0.0), "semi_axes": (6.0, 4.0, 4.0)}}
    data["cylinders"][0]["barrel"]["body"]["shape"] = {"cylinder": {"radius": 1.0, "start": -2.0, "end": 3.0}}
    data["identical"] = [{"name": "jacks", "bodies": ["boom_cylinder.barrel", "stick_cylinder.barrel"],
                          "friction": ["boom_cylinder", "stick_cylinder"]}]
    data["total_masses"] = [{"name": "weighbridge", "bodies": ["boom", "stick"],
                             "value": truth[parameters.select(["boom.m", "stick.m"])].sum()}]
    data["notes"] |= {"weighbridge.value": Note(sigma=sigma, source="a ticket")}
    return Machine.model_validate(data)


@pytest.fixture(scope="module")
def machine(cat215b: Model, truth: np.ndarray) -> Machine:
    return described(truth, cat215b.parameters)


@pytest.fixture(scope="module")
def problems(machine: Machine, truth: np.ndarray, record: Any) -> tuple[IdentificationProblem, IdentificationProblem]:
    """Of perfect and of noisy sensors."""
    model = Model(machine)
    return tuple(identification_problem(machine, logs[:-1], logs[-1:], smoothing=Fourier(33.28, 20)) for logs in (
        record(model, truth, (1, 2, 3, 4, 99)), record(model, truth, (1, 2, 99), noise=True)))  # type: ignore[return-value]


@pytest.fixture(scope="module")
def noisy_estimate(problems: tuple[IdentificationProblem, IdentificationProblem]) -> Any:
    return identify(problems[1])


def test_statements_become_constraints_by_name(problems: tuple[IdentificationProblem, IdentificationProblem],
                                               truth: np.ndarray) -> None:
    problem = problems[0]
    assert set(problem.constraint_names) == set(STATED)
    assert min(c.margin(truth) for c in problem.conditions) > -1e-12
    for name in STATED:
        assert f"  {name} " in str(problem)


@pytest.mark.parametrize("method", tiered(METHODS, lambda method: method != "nlp"))
def test_true_statements_leave_noise_free_recovery_exact(
    problems: tuple[IdentificationProblem, IdentificationProblem], truth: np.ndarray, method: Any
) -> None:
    estimate = identify(problems[0], method, tolerance=1e-9, intervals=False)
    assert max(fit.relative for fit in estimate.fit["validation"].values()) < 1e-9
    grouping = structural(estimate.problem.model).grouping
    base = grouping @ truth
    np.testing.assert_allclose(grouping @ estimate.psi, base, rtol=1e-6, atol=1e-12 * np.max(np.abs(base)))


def test_bodies_built_alike_may_stand_on_joints_that_rub_differently(cat215b: Model) -> None:
    assert {"boom.tau_coulomb", "stick.tau_coulomb"} <= set(cat215b.parameters.names)
    condition = physics.likeness(cat215b.parameters, "twins", ["boom", "stick"])
    touched = {cat215b.parameters.names[k] for k in np.flatnonzero(np.any(condition.rows, axis=0))}
    assert touched == {f"{owner}.{name}" for owner in ("boom", "stick") for name in inertia.NAMES}


@pytest.mark.parametrize(("method", "intervals"), tiered(
    ((method, intervals) for method in METHODS for intervals in (False, True)),
    lambda method, intervals: (method, intervals) in {("qp", True), ("sdp", False)}))
def test_equalities_hold_to_rounding_and_are_named(
    problems: tuple[IdentificationProblem, IdentificationProblem], method: Any, intervals: bool
) -> None:
    estimate = identify(problems[1], method, intervals=intervals)
    named = dict(zip(estimate.problem.parameters.names, estimate.bound, strict=True))
    parts = {name: estimate.psi[k] for k, name in enumerate(named)}
    size = {name: estimate.problem.parameters.scale[k] for k, name in enumerate(named)}
    for name in ("mc_z", "I_xz", "I_yz"):
        assert abs(parts[f"boom.{name}"]) < 1e-8 * size[f"boom.{name}"]
        assert named[f"boom.{name}"] in ("symmetry of boom about xy", "physical consistency of boom")
    for name in (*(f"barrel.{n}" for n in inertia.NAMES), "f_coulomb", "n_barrel", "n_rod"):
        one, other = parts[f"boom_cylinder.{name}"], parts[f"stick_cylinder.{name}"]
        assert abs(one - other) < 1e-8 * size[f"boom_cylinder.{name}"]
    assert parts["boom_cylinder.f_offset"] != pytest.approx(parts["stick_cylinder.f_offset"], rel=1e-3)
    total = estimate.problem.model.machine.total_masses[0].value
    assert parts["boom.m"] + parts["stick.m"] == pytest.approx(total, rel=1e-8)
    assert {"symmetry of boom about xy", "jacks", "weighbridge"} <= set(estimate.active)
    assert named["stick_cylinder.f_coulomb"] == "jacks"


@pytest.mark.parametrize("method", ["wls", "ridge", "tsvd"])
def test_linear_methods_refuse_what_the_file_states(
    problems: tuple[IdentificationProblem, IdentificationProblem], method: Any
) -> None:
    with pytest.raises(ProblemError, match=rf"'{method}' cannot honour .*boom about xy.* and 4 more; use qp"):
        identify(problems[1], method)
    alone = problems[1].by_data_alone()
    estimate = identify(alone, method)
    assert abs(estimate.psi[estimate.problem.parameters.index("boom.I_xz")]) > 0
    assert estimate.active == ()
    for added in (alone.symmetric("stick", "xy"), alone.with_total_mass("all", ["boom", "swing"], 9e3)):
        with pytest.raises(ProblemError, match=f"'{method}' cannot honour"):
            identify(added, method)


def test_bounds_of_the_file_are_constraints_and_confidences_are_not() -> None:
    assert one_body(mass=Note(sigma=1.0)).stated_constraints == ()
    bounded = one_body(mass=Note(sigma=1.0, upper=50.0))
    assert bounded.stated_constraints == ("the bounds of arm.m",)
    assert bounded.by_data_alone().stated_constraints == ()


@pytest.mark.parametrize("method", ["wls", "ridge", "tsvd", "qp"])
def test_log_det_needs_possible_bodies(problems: tuple[IdentificationProblem, IdentificationProblem],
                                       method: Any) -> None:
    with pytest.raises(ProblemError, match=f"'{method}' has no log-det distance; use sdp or nlp"):
        identify(problems[1].with_distance("log-det"), method)


@pytest.mark.slow
def test_report_and_json_show_the_names(noisy_estimate: Any) -> None:
    page, content = render(noisy_estimate), noisy_estimate.content()
    for name in STATED:
        assert name in page
    assert {"symmetry of boom about xy", "jacks", "weighbridge"} <= set(content["active_constraints"])
    assert "Distance of bodies from their nominal ones: gaussian" in page
    assert next(row for row in content["parameters"] if row["name"] == "stick_cylinder.n_rod")["bound"] == "jacks"


@pytest.mark.slow
def test_calibrated_machine_keeps_what_was_stated(machine: Machine, noisy_estimate: Any) -> None:
    again = read_machine(dump_machine(calibrated_machine(noisy_estimate)))
    assert (again.total_masses, again.identical) == (machine.total_masses, machine.identical)
    for one, other in zip(again.links, machine.links, strict=True):
        assert (one.body and (one.body.shape, one.body.symmetric)) == (
            other.body and (other.body.shape, other.body.symmetric))
    assert again.cylinders[0].barrel.body == calibrated_machine(noisy_estimate).cylinders[0].barrel.body
    assert again.cylinders[0].barrel.body.shape == machine.cylinders[0].barrel.body.shape  # type: ignore[union-attr]
    assert IdentificationProblem(Model(again), ()).constraint_names == noisy_estimate.problem.constraint_names


def test_calibrated_machine_is_refused_where_a_statement_does_not_hold(problems: tuple[IdentificationProblem,
                                                                                       IdentificationProblem]) -> None:
    free = identify(problems[1], "sdp", intervals=False)
    psi = free.psi.copy()
    psi[free.problem.parameters.index("boom.mc_z")] = 0.5
    object.__setattr__(free, "psi", psi)
    with pytest.raises(ProblemError, match="symmetry of boom about xy: this does not hold"):
        calibrated_machine(free)


def test_dump_and_read_are_inverse(machine: Machine, truth: np.ndarray, cat215b: Model) -> None:
    assert read_machine(dump_machine(machine)) == machine
    unsure = described(truth, cat215b.parameters, sigma=20.0)
    assert read_machine(dump_machine(unsure)) == unsure


def test_a_total_mass_with_sigma_is_a_prior(cat215b: Model, truth: np.ndarray) -> None:
    problem = IdentificationProblem(Model(described(truth, cat215b.parameters, sigma=20.0)), ())
    assert "weighbridge" not in problem.constraint_names
    (prior,) = problem.stated_priors
    assert (prior.name, prior.sigma) == ("weighbridge", 20.0)
    added = IdentificationProblem(cat215b, ()).with_total_mass("weighbridge", ["boom", "stick"], prior.value, 20.0)
    np.testing.assert_array_equal(added.priors[0].row, prior.row)
    np.testing.assert_allclose(added.prior_rows[0][-1], problem.prior_rows[0][-1])
    np.testing.assert_allclose(added.prior_rows[1][-1], problem.prior_rows[1][-1])


def test_a_flat_total_mass_reads_as_one_with_a_note() -> None:
    text = dump_machine(load_machine("cat215b"))
    ticket = ('\n[[total_masses]]\nname = "ticket"\nbodies = ["boom", "stick"]\nvalue = "2.518 t"\nsigma = "1 %"\n'
              'source = "weighbridge"\n')
    machine = read_machine(text.replace("\n[[links]]", ticket + "\n[[links]]", 1))
    assert machine.total_masses[0].value == pytest.approx(2518)
    assert machine.notes["ticket.value"].spread(2518.0) == pytest.approx(25.18)
    assert machine.notes["ticket.value"].source == "weighbridge"
    assert IdentificationProblem(Model(machine), ()).stated_priors[0].sigma == pytest.approx(25.18)


def test_reduced_model_drops_what_speaks_of_cylinders_and_refuses_their_sum(cat215b: Model, machine: Machine) -> None:
    reduced = IdentificationProblem(Model(machine, actuator_inertia=False), ())
    assert "density of boom_cylinder.barrel inside its shape" not in reduced.constraint_names
    (friction,) = (c for c in reduced.conditions if c.name == "jacks")
    assert len(friction.rows) == 3
    data = machine.model_dump()
    data["total_masses"][0]["bodies"] = ["boom", "boom_cylinder.rod"]
    summed = IdentificationProblem(Model(Machine.model_validate(data), actuator_inertia=False), ())
    with pytest.raises(ProblemError, match=r"'weighbridge': 'boom_cylinder\.rod' is not a body of this model"):
        _ = summed.conditions


# --- contradictions


@pytest.mark.parametrize("method", METHODS)
def test_a_total_mass_below_a_lower_bound_names_both(method: Any) -> None:
    problem = one_body(mass=Note(sigma=1.0, lower=5.0)).with_total_mass("ticket", ["arm"], 4.0).symmetric("arm", "xy")
    with pytest.raises(ProblemError) as refusal:
        solved(problem, method)
    assert refusal.value.what == "these cannot hold together: lower bound of arm.m; ticket"


@pytest.mark.parametrize("method", tiered(METHODS, lambda method: method != "nlp"))
@pytest.mark.slow
def test_contradictions_between_statements_name_exactly_those(problems: tuple[IdentificationProblem,
                                                                              IdentificationProblem],
                                                                              method: Any) -> None:
    wish = problems[1].with_total_mass("pair", ["swing", "stick_cylinder.rod"], 8000).fix("swing.m", 8500.0)
    with pytest.raises(ProblemError) as refusal:
        identify(wish, method)
    rod = "lower bound of stick_cylinder.rod.m" if method == "qp" else "physical consistency of stick_cylinder.rod"
    found = refusal.value.what.removeprefix("these cannot hold together: ").split("; ")
    assert sorted(found) == sorted(["pair", "swing.m fixed", rod])


@pytest.mark.parametrize("method", METHODS)
def test_equalities_that_contradict_each_other_are_named(problems: tuple[IdentificationProblem, IdentificationProblem],
                                                         method: Any) -> None:
    wish = problems[1].symmetric("stick", "xz").fix("stick.I_yz", 3.0)
    with pytest.raises(ProblemError) as refusal:
        identify(wish, method)
    assert refusal.value.what == "these cannot hold together: stick.I_yz fixed; symmetry of stick about xz"


@pytest.mark.parametrize("method", METHODS)
def test_moment_outside_the_shape_contradicts_it(method: Any) -> None:
    problem = one_body(shape=SHAPES["cylinder"]).fix("arm.mc_x", 20.0).fix("arm.m", 10.0).symmetric("arm", "xy")
    with pytest.raises(ProblemError) as refusal:
        solved(problem, method)
    found = refusal.value.what.removeprefix("these cannot hold together: ").split("; ")
    assert {"arm.m fixed", "arm.mc_x fixed"} < set(found)
    assert not any("symmetry" in name for name in found)
    assert any("inside its shape" in name for name in found)


def test_ipopt_stays_with_its_own_words_where_a_constraint_is_not_convex() -> None:
    problem = (one_body(mass=Note(sigma=1.0, lower=5.0)).with_total_mass("ticket", ["arm"], 4.0)
               .subject_to("curved", lambda p: p["arm.mc_x"] * p["arm.mc_y"] == 1.0))
    with pytest.raises(SolverError, match="IPOPT failed"):
        solved(problem, "nlp")


@pytest.mark.parametrize(("wish", "message"), [
    (lambda p: p.symmetric("arm", "zz"), "'zz' is not a plane; use xy, xz, yz"),
    (lambda p: p.symmetric("leg", "xy"), "'leg' is not a body of this model; name one of arm"),
    (lambda p: p.symmetric("arm", "xy").symmetric("arm", "xy"), "same name"),
    (lambda p: p.with_total_mass("t", [], 3.0), "sum has no bodies"),
    (lambda p: p.with_total_mass("t", ["arm", "arm"], 3.0), "one of them twice"),
    (lambda p: p.with_total_mass("t", ["leg"], 3.0), "'leg' is not a body"),
    (lambda p: p.with_total_mass("t", ["arm"], 0.0), "0 kg is not a mass"),
    (lambda p: p.with_total_mass("t", ["arm"], 3.0, -1.0), "not a prior"),
    (lambda p: p.with_total_mass("t", ["arm"], 3.0).with_total_mass("t", ["arm"], 4.0), "same name"),
    (lambda p: p.identical("t", ["arm"]), "cannot be identical"),
    (lambda p: p.identical("t", ["arm", "drive"]), "cannot be identical"),
    (lambda p: p.with_distance("euclid"), "'euclid' is not a distance; use gaussian or log-det"),
])
def test_nonsense_is_refused(wish: Any, message: str) -> None:
    with pytest.raises(ProblemError, match=message):
        wish(one_body())


# --- the log-det distance


def divergence(J: np.ndarray, J0: np.ndarray) -> float:
    """D(J‖J0), from eigenvalues."""
    w = np.linalg.eigvals(np.linalg.solve(J0, J)).real
    return float(np.sum(w - np.log(w) - 1)) if np.all(w > 0) else np.inf


def test_a_change_of_density_costs_what_the_confidence_of_the_mass_says() -> None:
    problem = one_body(sigma=(0.7, 1.0, 1.0)).with_distance("log-det")
    (body,) = problem.bodies
    J0 = inertia.pseudo_inertia(PHI)
    for change in (-1e-3, 1e-3):
        cost = body.weight * divergence((1 + change) * J0, J0)
        assert cost == pytest.approx((change * 10 / 0.7) ** 2, rel=2e-3)
        assert problem.prior_misfit((1 + change) * PHI) == pytest.approx(cost, rel=1e-6)
    other = 1.3 * PHI + 0.05 * of_points(np.array([[1.0, 1, 1]]), np.ones(1))
    assert body.distance(other) == pytest.approx(body.weight * divergence(inertia.pseudo_inertia(other), J0))
    assert body.distance(-PHI) == np.inf


def data(seed: int, strength: float = 1.5) -> tuple[np.ndarray, np.ndarray]:
    """Three sums of the ten parameters, measured far from their nominal values."""
    rng = np.random.default_rng(seed)
    R = np.zeros((10, 10))
    R[:3] = strength * rng.standard_normal((3, 10)) / np.maximum(np.abs(PHI), 0.3)
    return R, R @ (PHI * rng.uniform(0.6, 1.8, 10))


def cost_of(problem: IdentificationProblem, R: np.ndarray, r: np.ndarray, phi: np.ndarray) -> float:
    return float(np.sum((R @ phi - r) ** 2)) + problem.bodies[0].weight * divergence(
        inertia.pseudo_inertia(phi), inertia.pseudo_inertia(PHI))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("relative", [0.05, 0.3])
@pytest.mark.slow
def test_log_det_optimum_is_that_of_another_solver(seed: int, relative: float) -> None:
    problem = one_body(sigma=(10 * relative, 1.0, 1.0)).with_distance("log-det")
    R, r = data(seed)
    J0 = np.linalg.cholesky(inertia.pseudo_inertia(PHI))

    def phi(entries: np.ndarray) -> np.ndarray:
        L = np.zeros((4, 4))
        L[np.tril_indices(4)] = entries
        L[range(4), range(4)] = np.exp(L[range(4), range(4)])
        return inertia.from_pseudo_inertia(J0 @ L @ L.T @ J0.T)

    best = minimize(lambda x: cost_of(problem, R, r, phi(x)), np.zeros(10), method="BFGS", options={"gtol": 1e-9})
    for method in ("sdp", "nlp"):
        found = solved(problem, method, (R, r)).psi
        assert cost_of(problem, R, r, found) == pytest.approx(best.fun, rel=1e-6)
        np.testing.assert_allclose(found, phi(best.x), atol=3e-3 * np.max(np.abs(PHI[4:])))


def test_log_det_knows_no_frame() -> None:
    """The same body and data in a frame moved and turned give the same body."""
    R, r = data(0)
    rotation = np.linalg.qr(np.random.default_rng(5).standard_normal((3, 3)))[0]
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation, [0.4, -0.7, 0.2]
    moved = np.column_stack([inertia.from_pseudo_inertia(T @ J @ T.T) for J in inertia.PSEUDO_BASIS])
    here = solved(one_body(sigma=(2.0, 1.0, 1.0)).with_distance("log-det"), "sdp", (R, r)).psi
    there = solved(one_body(moved @ PHI, (2.0, 1.0, 1.0)).with_distance("log-det"), "sdp",
                   (R @ np.linalg.inv(moved), r)).psi
    np.testing.assert_allclose(np.linalg.solve(moved, there), here, atol=1e-4)
    gaussians = [solved(one_body(phi, (2.0, 1.0, 1.0)), "sdp", (A, r)).psi
                 for phi, A in ((PHI, R), (moved @ PHI, R @ np.linalg.inv(moved)))]
    assert np.max(np.abs(np.linalg.solve(moved, gaussians[1]) - gaussians[0])) > 0.05


@pytest.mark.slow
@pytest.mark.parametrize("relative", [0.05, 0.2, 0.5])
def test_samples_of_the_distance_alone_are_wishart(relative: float) -> None:
    """exp(−½κD(J‖J0)) over the ten parameters is a Wishart density: κ + 5 degrees of freedom, scale J0/κ."""
    problem = one_body(sigma=(10 * relative, 1.0, 1.0)).with_distance("log-det")
    weight = 1 / (2 * relative**2)
    exact = wishart(weight + 5, inertia.pseudo_inertia(PHI) / weight).rvs(40_000, random_state=1)
    drawn = [sample(problem, *nothing(), PHI, consistent=True, seed=seed) for seed in range(8)]
    samples = np.tensordot(np.concatenate([d.samples for d in drawn if d is not None]), inertia.PSEUDO_BASIS, axes=1)
    std = exact.std(axis=0)
    np.testing.assert_allclose((samples.mean(axis=0) - exact.mean(axis=0)) / std, 0, atol=0.06)
    np.testing.assert_allclose(samples.std(axis=0) / std, 1, atol=0.06)
    for probability in (0.025, 0.25, 0.75, 0.975):
        below = np.mean(samples[:, 3, 3] < np.quantile(exact[:, 3, 3], probability))
        assert below == pytest.approx(probability, abs=0.02)
    sizes = [np.linalg.slogdet(J)[1] for J in (samples, exact)]
    assert sizes[0].mean() == pytest.approx(sizes[1].mean(), abs=0.06 * sizes[1].std())
    assert sizes[0].std() == pytest.approx(sizes[1].std(), rel=0.06)


@pytest.mark.slow
def test_intervals_with_data_shape_and_symmetry_are_those_of_a_random_walk() -> None:
    """Plain Metropolis over the seven even parameters, with the density written out anew."""
    phi = inertia.from_centre_of_mass(10.0, [0.5, 0.1, 0.0], [0.2, 0.02, 0.0, 1.0, 0.0, 1.1])
    shape = Shape.model_validate({"cylinder": {"radius": 0.6, "start": -0.3, "end": 1.3}})
    problem = one_body(phi, (2.0, 1.0, 1.0), shape=shape, symmetric="xy").with_distance("log-det")
    R, r = data(2, 0.7)
    even = [0, 1, 2, 4, 5, 7, 9]
    J0, weight = np.linalg.inv(inertia.pseudo_inertia(phi)), 0.5 * (10 / 2) ** 2

    def log_density(x: np.ndarray) -> np.ndarray:
        """Of many points (n, 7)."""
        psi = np.zeros((len(x), 10))
        psi[:, even] = x
        J = np.tensordot(psi, inertia.PSEUDO_BASIS, axes=1)
        sign, size = np.linalg.slogdet(J)
        possible = (sign > 0) & (np.linalg.eigvalsh(J)[:, 0] > 0)
        m, mc = psi[:, 0], psi[:, 1:4]
        centred = (mc[:, 0] > -0.3 * m) & (mc[:, 0] < 1.3 * m) & (np.hypot(mc[:, 1], mc[:, 2]) < 0.6 * m)
        dense = (J[:, 1, 1] + J[:, 2, 2] < 0.36 * m) & (1.3 * mc[:, 0] - 0.3 * mc[:, 0] + 0.39 * m > J[:, 0, 0])
        value = -0.5 * np.sum((psi @ R.T - r) ** 2, axis=1) - 0.5 * weight * (
            np.einsum("ij,nji->n", J0, J) - np.where(possible, size, 0))
        return np.where(possible & centred & dense, value, -np.inf)

    rng = np.random.default_rng(8)
    start = solve_start = solved(problem, "sdp", (R, r)).psi
    assert "density of arm inside its shape" in problem.constraint_names
    posterior = sample(problem, R, r, solve_start, consistent=True, seed=0)
    assert posterior is not None
    spread = 2.0 / np.sqrt(7) * np.linalg.cholesky(np.cov(posterior.samples[:, even].T))
    x = np.tile(posterior.mean[even] if posterior.mean is not None else start[even], (400, 1))
    height, kept = log_density(x), []
    for step in range(1500):
        new = x + rng.standard_normal(x.shape) @ spread.T
        candidate = log_density(new)
        taken = np.log(rng.uniform(size=len(x))) < candidate - height
        x[taken], height[taken] = new[taken], candidate[taken]
        if step >= 500 and step % 50 == 0:
            kept.append(x.copy())
    walk = np.concatenate(kept)
    drawn = [posterior, *(sample(problem, R, r, start, consistent=True, seed=seed) for seed in range(1, 8))]
    samples = np.concatenate([d.samples[:, even] for d in drawn if d is not None])
    std = walk.std(axis=0)
    np.testing.assert_allclose((samples.mean(axis=0) - walk.mean(axis=0)) / std, 0, atol=0.1)
    np.testing.assert_allclose(samples.std(axis=0) / std, 1, atol=0.08)
    low, high = np.quantile(samples, [0.025, 0.975], axis=0)
    np.testing.assert_allclose(np.mean((walk > low) & (walk < high), axis=0), 0.95, atol=0.015)


@pytest.mark.slow
def test_wide_confidences_with_log_det_have_a_diagnostic(problems: tuple[IdentificationProblem,
                                                                         IdentificationProblem]) -> None:
    estimate = identify(problems[1].with_distance("log-det"), intervals=False)
    assert not of_kind(diagnose(estimate), "weak log-det distance")
    notes = {key: note for key, note in estimate.problem.model.machine.notes.items() if not key.startswith("boom.body")}
    vague = estimate.problem.model.machine.model_copy(update={"notes": notes})
    weak = IdentificationProblem(Model(vague), estimate.problem.experiments).with_distance("log-det")
    object.__setattr__(estimate, "problem", weak)
    (found,) = of_kind(diagnose(estimate), "weak log-det distance")
    assert found.subject == ("boom",)
    assert round(found.evidence["growth"]) == 11


def test_a_nominal_body_that_cannot_exist_has_no_distance() -> None:
    impossible = PHI.copy()
    impossible[9] = 10.0
    problem = one_body(impossible)
    with pytest.raises(ProblemError, match=r"body 'arm': its nominal numbers are of no body .*; correct its inertia"):
        problem.with_distance("log-det")


def test_scalars_keep_their_priors_with_log_det(cat215b: Model) -> None:
    problem = IdentificationProblem(cat215b, ()).with_distance("log-det")
    solution = solved(problem, "sdp", nothing(len(cat215b.parameters)))
    np.testing.assert_allclose(solution.psi / problem.parameters.scale,
                               problem.parameters.nominal / problem.parameters.scale, atol=1e-5)
    rows, _ = problem.square_rows
    assert np.linalg.matrix_rank(rows) == len(rows) == sum(
        name.rpartition(".")[2] not in inertia.NAMES for name in problem.parameters.names)
