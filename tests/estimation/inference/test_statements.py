"""Constraints and priors as text: what they say, what is refused, and what an identification makes of them."""

import json
from pathlib import Path

import cvxpy as cp
import numpy as np
import pytest
from typer.testing import CliRunner

import hydroopt as ho
from fixtures.bad_input_cases import GOOD_LOG, identify, written
from hydroopt.cli import app
from hydroopt.errors import HydrooptError
from hydroopt.estimation.dynamic.identify import identify as identified
from hydroopt.estimation.inference.constraints import Constraint, Expression
from hydroopt.estimation.inference.statements import linear_relation, read_constraint, read_prior
from hydroopt.machine.machine_file import load_machine

PARAMETERS = ho.Model(load_machine("cat215b")).parameters
CONSTRAINTS = {
    "boom.m + stick.m == 2518 kg": ("zero", {"boom.m": 1.0, "stick.m": 1.0}, 2518.0),
    "2.518 t == stick.m + boom.m": ("zero", {"boom.m": -1.0, "stick.m": -1.0}, -2518.0),
    "2*boom.m - 0.5 stick.m/2 <= 3 t": ("nonnegative", {"boom.m": -2.0, "stick.m": 0.25}, -3000.0),
    "-(boom.m - 2·stick.m) >= 1e1 kg": ("nonnegative", {"boom.m": -1.0, "stick.m": 2.0}, 10.0),
    "boom.mc_x <= 1200 mm*boom.m": ("nonnegative", {"boom.mc_x": -1.0, "boom.m": 1.2}, 0.0),
    "boom.mc_x/1.2 m - boom.m <= 0": ("nonnegative", {"boom.mc_x": -1 / 1.2, "boom.m": 1.0}, 0.0),
    "boom.I_xx >= 5e6 kg*mm^2": ("nonnegative", {"boom.I_xx": 1.0}, 5.0),
    "boom_cylinder.f_coulomb == stick_cylinder.f_coulomb + 1 kN":
        ("zero", {"boom_cylinder.f_coulomb": 1.0, "stick_cylinder.f_coulomb": -1.0}, 1000.0)}
REFUSED = {
    "boom.mm == 3 kg": r"parameter 'boom\.mm': no parameter .* did you mean boom\.m",
    "boom == 3 kg": r"parameter 'boom': no parameter .* did you mean boom\.m",
    "boom.m == 5": "5 has no unit; add one of the kind of 'kg'", "boom.m == 3 N": "'N' is not a unit of the kind 'kg'",
    "boom.m + boom.mc_x == 3 kg": "'kg.m' is not a unit of the kind 'kg'",
    "boom.m*stick.m == 3 kg^2": "not linear", "boom.m**2 == 4 kg^2": "not linear",
    "3 kg^2/boom.m <= 1 kg": "not linear",
    "boom.m = 3 kg": "not one relation", "1 kg <= boom.m <= 2 kg": "not one relation", "": "not one relation",
    "boom.m == boom.m": "nothing about any parameter", "1 kg == 2 kg": "nothing about any parameter",
    "boom.m == 1e999 kg": "not finite", "boom.m == kg kg": "not a sum", "boom.m == 3 kg; x": "not a sum",
    "__import__('os').m == 3 kg": "not a sum", "boom.m == (lambda: 3)()": "not a sum",
    "(" * 400 + " == 1 kg": "not a sum",
    "-" * 499 + "boom.m == 1 kg": "not a sum", "boom.m == 5 m^9^9^9": "not linear", "boom.m == 5 kg/0": "not linear"}
PRIORS_REFUSED = {
    "boom.m = 1520 kg": "not a sum of parameters = value", "boom.m == 3 +- 1 kg": "not a sum of parameters = value",
    "boom.m = 1520 +- 20": "has no unit", "boom.m = 3 +- -1 kg": "positive sigma", "boom.m = 3 +- 1 N": "'N' is not",
    "boom.m = x +- 2 kg": "'x kg' is not a number"}


@pytest.mark.parametrize("text", CONSTRAINTS)
def test_a_constraint_says_what_is_written(text: str) -> None:
    kind, row, right = CONSTRAINTS[text]
    condition = read_constraint(PARAMETERS, "c", text)
    places = PARAMETERS.select(row)
    expected = np.zeros(len(PARAMETERS))
    expected[places] = list(row.values())
    size = condition.rows[0, places[0]] / expected[places[0]]
    assert condition.kind == kind
    assert size > 0
    assert np.allclose(condition.rows[0], size * expected, rtol=1e-12)
    assert np.allclose(condition.right, size * right, rtol=1e-12)


@pytest.mark.parametrize(("function", "text"), [
    (lambda p: p["boom.m"] + p["stick.m"] == 2518, "boom.m + stick.m == 2518 kg"),
    (lambda p: 2 * p["boom.m"] - p["stick.m"] / 4 <= 3000, "2*boom.m - 0.25*stick.m <= 3 t"),
    (lambda p: p["boom.mc_x"] >= 1.2 * p["boom.m"] + 10, "boom.mc_x >= 1.2 m*boom.m + 10 kg*m")])
def test_a_linear_function_says_what_a_text_says(function: Expression, text: str) -> None:
    found, expected = linear_relation(PARAMETERS, Constraint("c", function)), read_constraint(PARAMETERS, "c", text)
    assert found is not None
    assert (found.name, found.kind) == ("c", expected.kind)
    np.testing.assert_allclose(np.append(found.rows, found.right), np.append(expected.rows, expected.right), rtol=1e-12)


@pytest.mark.parametrize("function", [
    lambda p: p["boom.m"] * p["stick.m"] <= 1e6, lambda p: cp.square(p["boom.m"]) <= 1e6, lambda p: p["bom.m"] <= 1,
    lambda p: p["boom.m"] <= np.inf, lambda p: 0 * p["boom.m"] <= 1, lambda p: p["boom.m"]])
def test_other_functions_are_left_to_solvers(function: Expression) -> None:
    assert linear_relation(PARAMETERS, Constraint("c", function)) is None


@pytest.mark.parametrize("text", REFUSED)
def test_what_is_no_linear_relation_is_refused(text: str) -> None:
    with pytest.raises(HydrooptError, match=REFUSED[text]):
        read_constraint(PARAMETERS, "c", text)


@pytest.mark.parametrize("text", PRIORS_REFUSED)
def test_what_is_no_prior_is_refused(text: str) -> None:
    with pytest.raises(HydrooptError, match=PRIORS_REFUSED[text]):
        read_prior(PARAMETERS, "p", text)


def test_a_prior_takes_units_of_its_own_and_constants_along() -> None:
    prior = read_prior(PARAMETERS, "p", "boom.m + stick.m - 5 kg = 1.5 t +- 20 kg")
    assert (prior.value, prior.sigma) == (1505.0, 20.0)
    assert dict(zip(np.array(PARAMETERS.names)[prior.row != 0], prior.row[prior.row != 0], strict=True)) == {
        "boom.m": 1.0, "stick.m": 1.0}


STATED = ("--fix", "extension.m=60 kg", "--constraint", "tilt.m + payload.m <= 270 kg",
          "--prior", "linkage.m = 19 +- 0.5 kg", "--prior", "tilt.m = 70 kg +- 2 kg")


@pytest.fixture(scope="module")
def answered(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("stated")
    done = CliRunner().invoke(app, identify(folder, GOOD_LOG, *STATED, "--quiet"), catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return folder / "out"


@pytest.mark.slow
def test_the_command_heeds_statements_and_names_them(answered: Path) -> None:
    said = json.loads((answered / "estimate.json").read_text())
    rows = {row["name"]: row for row in said["parameters"]}
    assert said["fixed"] == {"extension.m": 60.0}
    assert said["constraints"] == [{"name": "tilt.m + payload.m <= 270 kg", "active": True}]
    assert [(one["name"], one["parameters"], one["value"], one["std"]) for one in said["priors"]] == [
        ("linkage.m = 19 +- 0.5 kg", {"linkage.m": 1.0}, 19.0, 0.5),
        ("tilt.m = 70 kg +- 2 kg", {"tilt.m": 1.0}, 70.0, 2.0)]
    held = rows["extension.m"]
    assert (held["value"], held["std"], held["ci95"], held["identifiability"]) == (60.0, None, None, "fixed")
    assert rows["tilt.m"]["value"] + rows["payload.m"]["value"] < 270.0
    assert rows["tilt.m"]["bound"] == "tilt.m + payload.m <= 270 kg"
    assert abs(rows["tilt.m"]["prior_std"] - (7.66995**-2 + 2.0**-2) ** -0.5) < 1e-4
    assert rows["tilt.m"]["std"] < 2.0


def test_the_page_and_the_calibrated_machine_show_statements(answered: Path) -> None:
    page = (answered / "report.html").read_text()
    assert "<li>tilt.m + payload.m &lt;= 270 kg</li>" in page
    assert "<li>extension.m = 60</li>" in page
    assert "not at all, 1 fixed." in page
    link = load_machine(str(answered / "patu655_lift.toml")).link("extension")
    assert link.body is not None
    assert link.body.m == 60.0


@pytest.mark.parametrize("method", ["qp", "nlp"])
@pytest.mark.slow
def test_other_methods_heed_statements_as_sdp_does(method: str, tmp_path: Path) -> None:
    log = ho.read_log(written(tmp_path, "\n".join(GOOD_LOG), "log.csv"))
    problem = (ho.identification_problem(load_machine("patu655_lift"), [log]).fix("extension.m", 60.0)
               .subject_to("weighed", "tilt.m + payload.m <= 270 kg").with_prior("scales", "linkage.m = 19 +- 0.5 kg"))
    first, other = (identified(problem, each, intervals=False).psi for each in ("sdp", method))
    places = problem.parameters.select(("tilt.m", "payload.m"))
    assert abs(first[places].sum() - 270.0) < 1e-4
    if method == "nlp":
        assert np.allclose(first, other, atol=1e-3 * problem.parameters.scale)
    assert abs(other[places].sum() - 270.0) < 1e-3
    assert other[problem.parameters.index("extension.m")] == 60.0


def test_a_text_says_what_a_function_says() -> None:
    model = ho.Model(load_machine("cat215b"))
    motion = ho.random_trajectory(model, duration=6.0, rate=20.0, seed=1)
    problem = ho.identification_problem(model, [ho.simulate(model, motion, seed=1)])
    text = problem.subject_to("weighed", "boom.m + stick.m == 2.3 t").with_prior(
        "balanced", "stick.mc_y = 60 +- 20 kg*m")
    function = problem.subject_to("weighed", lambda p: p["boom.m"] + p["stick.m"] == 2300.0).with_prior(
        "balanced", "stick.mc_y", value=60.0, sigma=20.0)
    one, other = (identified(each, intervals=False).psi for each in (text, function))
    assert np.allclose(one, other, atol=1e-5 * problem.parameters.scale)
