"""The command as a user runs it, on the real data that ships."""

import itertools
import json
import math
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import hydroopt
from fixtures.tiers import tiered
from hydroopt.cli import app
from hydroopt.cli.machine_facts import machine_facts
from hydroopt.machine.machine_file import dump_machine, load_machine
from hydroopt.model.model import Model

ROOT = Path(__file__).parents[2]
KR300 = ["kr300", str(ROOT / "data/kr300/run_A.mat"), "--map", str(ROOT / "data/kr300/map.toml")]


def run(*arguments: str) -> str:
    done = CliRunner(env={"COLUMNS": "110"}).invoke(app, list(arguments), catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return done.stdout


@pytest.fixture(scope="module")
def kr300(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    out = tmp_path_factory.mktemp("kr300")
    return out, run("identify", *KR300, "--holdout", "0.3", "-o", str(out))


def test_identify_predicts_the_unseen_part_of_a_real_run(kr300: tuple[Path, str]) -> None:
    content = json.loads((kr300[0] / "estimate.json").read_text())
    # a real arm's friction is not the model's: its residuals are beyond noise and smoothing, which claims contain
    assert content["status"] == "ok"
    assert "lack of fit" in {each["kind"] for each in content["diagnostics"]}
    bounds = {each["of"]: each["part"] for each in content["claims"] if each["purpose"] == "force"}
    assert bounds["axis4_drive"] > 0.3  # its small torque is hardly explained
    assert content["fit"]["validation"]["all"]["relative"] <= 0.18
    assert all(body["consistent"] for body in content["physical_consistency"].values())
    assert [i["samples"] for i in content["inputs"]] == [1751, 750]
    assert {i["role"] for i in content["inputs"]} == {"train", "validation"}


def test_identify_leaves_a_calibrated_machine_that_predicts_the_same(kr300: tuple[Path, str]) -> None:
    nominal, calibrated = hydroopt.load_machine("kr300"), hydroopt.load_machine(kr300[0] / "kr300.toml")
    log = hydroopt.read_log(KR300[1], mapping=KR300[3])
    estimate = json.loads((kr300[0] / "estimate.json").read_text())
    _, unseen = log.split(0.7)
    problem = hydroopt.identification_problem(calibrated, [unseen])
    data = problem.experiments[0]
    from hydroopt.estimation.dynamic.regressor_qr import predict
    error = (data.force - predict(problem.model, data, problem.parameters.nominal))[data.inside]
    relative = np.linalg.norm(error) / np.linalg.norm(data.force[data.inside])
    assert math.isclose(relative, estimate["fit"]["validation"]["all"]["relative"], rel_tol=1e-6)
    assert calibrated.links[0].joint == nominal.links[0].joint


def test_identify_says_what_is_in_doubt(kr300: tuple[Path, str]) -> None:
    assert "kinds of notes more are in the JSON file and the report" in kr300[1]
    assert len(kr300[1].splitlines()) <= 24
    assert "report.html" in kr300[1]
    assert "<h2>findings</h2>" in (kr300[0] / "report.html").read_text()


@pytest.mark.slow
def test_json_is_the_file(tmp_path: Path) -> None:
    printed = json.loads(run("identify", *KR300, "--method", "wls", "--json", "-o", str(tmp_path)))
    assert printed == json.loads((tmp_path / "estimate.json").read_text())
    assert not (tmp_path / "kr300.toml").exists()  # impossible bodies are not exported
    assert any(each["kind"] == "bodies not physically consistent" for each in printed["diagnostics"])


def test_quiet_is_quiet(tmp_path: Path) -> None:
    assert run("simulate", "patu655_lift", "-o", str(tmp_path), "--duration", "5", "--quiet") == ""


@pytest.mark.parametrize("machine", tiered(hydroopt.bundled(), lambda machine: machine in ("cat215b", "patu655_lift")))
def test_show(machine: str) -> None:
    facts = json.loads(run("show", machine, "--json"))
    assert facts["machine"]["name"] == machine
    counts = facts["identifiability"]
    assert counts["full"] + counts["combination"] + counts["none"] == len(facts["parameters"])
    text = run("show", machine)
    for joint in facts["joints"]:
        assert joint["joint"] in text


def test_parameter_set_is_chosen() -> None:
    literal = json.loads(run("show", "cat215b", "--set", "thesis_literal", "--json"))
    value = {p["name"]: p["nominal"] for p in literal["parameters"]}
    assert (value["swing.I_xx"], value["boom.I_yy"], value["stick.I_zz"]) == (8000, 15400, 600)


def test_simulate_follows_a_motion_and_repeats_itself(tmp_path: Path) -> None:
    first, second, again = tmp_path / "first", tmp_path / "second", tmp_path / "again"
    run("simulate", "cat215b", "-o", str(first), "--seed", "3", "--duration", "10", "--no-noise")
    for out in (second, again):
        run("simulate", "cat215b", "-o", str(out), "--motion", str(first / "log.csv"), "--parquet", "--seed", "4")
    motion, followed = hydroopt.read_log(first / "log.csv"), hydroopt.read_log(second / "log.parquet")
    noise = followed.channel("boom.q") - motion.channel("boom.q")
    assert np.max(np.abs(noise)) < np.radians(0.1 + 0.011)
    assert (second / "log.parquet").read_bytes() == (again / "log.parquet").read_bytes()
    truth = json.loads((second / "truth.json").read_text())
    assert len(truth["parameters"]) == 82


def test_simulate_samples_at_the_stated_rate(tmp_path: Path) -> None:
    run("simulate", "patu655_lift", "-o", str(tmp_path / "stated"), "--duration", "5", "--quiet")
    run("simulate", "patu655_lift", "-o", str(tmp_path / "asked"), "--duration", "5", "--rate", "20", "--quiet")
    logs = [hydroopt.read_log(tmp_path / name / "log.csv") for name in ("stated", "asked")]
    assert [log.t.size for log in logs] == [500, 100]


def test_simulate_says_which_readings_have_no_errors(tmp_path: Path) -> None:
    (tmp_path / "bare.toml").write_text(dump_machine(load_machine("patu655_lift").model_copy(update={"sensors": ()})))
    said = {name: run("simulate", name, "-o", str(tmp_path / "out"), "--duration", "5", *more)
            for name, more in ((str(tmp_path / "bare.toml"), ()), ("patu655_lift", ("--no-noise",)))}
    assert ["no accuracy in [[sensors]]: lift.q" in text for text in said.values()] == [True, False]


def test_show_takes_the_ranges_of_all_joints_that_a_cylinder_crosses() -> None:
    """Dead length and stroke that cover the lengths of `show` are accepted, by the ends of two joints alone."""
    machine = load_machine("wheel_loader")
    tilt = next(each for each in machine_facts(machine)["cylinders"] if each["cylinder"] == "tilt_cylinder")
    model = Model(machine)
    ends = list(itertools.product(*(machine.link(joint).joint.range for joint in machine.joints)))
    lengths = [float(model.cylinder_kinematics(q, [0, 0], [0, 0])[0][1]) for q in ends]
    assert tilt["length_min_m"] <= min(lengths) + 1e-4 < max(lengths) - 1e-4 <= tilt["length_max_m"]
    middle = np.mean(machine.link("lift").joint.range)
    held = [float(model.cylinder_kinematics((middle, q), [0, 0], [0, 0])[0][1])
            for q in machine.link("bucket").joint.range]
    assert np.ptp(lengths) > 1.2 * np.ptp(held)


def test_relief_pressures_are_the_ends_of_the_pressure_sensors(tmp_path: Path) -> None:
    run("simulate", "patu655_lift", "-o", str(tmp_path), "--duration", "10", "--quiet")
    text = (tmp_path / "log.csv").read_text().splitlines()
    column = text[0].split(",").index("lift_cylinder.p_head [Pa]")
    for row in (200, 201):
        cells = text[row].split(",")
        cells[column] = "2.2e7"
        text[row] = ",".join(cells)
    (tmp_path / "clipped.csv").write_text("\n".join(text) + "\n")
    done = CliRunner().invoke(app, ["identify", "patu655_lift", str(tmp_path / "clipped.csv"), "--treat",
                                    "saturated=error", "-o", str(tmp_path / "out")])
    assert "lift_cylinder.p_head: samples 200–201" in str(done.exception)
    assert "lie at or above 2.1e+07 Pa, the most that is stated" in str(done.exception)
