"""What a kinematic calibration leaves behind: strict, consistent with the answer, legible, or not there at all."""

from __future__ import annotations

import csv
import json
import re
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from typer.testing import CliRunner

from fixtures.pages import data_of, stands_alone, text_of
from hydroopt import cli
from hydroopt.errors import MachineError, SolverError
from hydroopt.estimation.kinematic.calibration import Calibration, calibrate
from hydroopt.estimation.kinematic.problem import calibration_problem
from hydroopt.estimation.kinematic.residuals import gaps
from hydroopt.logs.poses import Poses
from hydroopt.machine.machine_file import load_machine
from hydroopt.model.closed_chain import KinematicModel
from hydroopt.model.scene_graph import SceneGraph
from hydroopt.report.calibration import render
from hydroopt.report.samples import unpacked
from hydroopt.results.answer import load
from hydroopt.results.diagnostic import of_kind
from hydroopt.results.json_file import COMMON
from hydroopt.results.status import Status
from hydroopt.results.verdict import Action, NextStep, Purpose, Usable
from hydroopt.simulation import postures
from studies import closed_postures

ROOT = Path(__file__).parents[2]
MUKCA = ROOT / "data/mukca_panda_2"
CONTRACT = {*COMMON, "combinations", "conditioning", "correlations", "noise_scale", "suspects", "left_out",
            "uniqueness", "stages", "sides", "validation_coverage", "validation_ratio", "workspace", "loss", "priors",
            "fixed", "seed"}
FILES = {"estimate.json", "report.html", "parameters.csv", "fit.csv", "residuals.csv", "covariance.csv", "cat215b.toml"}
SECTIONS = ("Fit", "Parameters", "Accuracy over the workspace", "Conditioning",
            "Data", "Method")


def table(count: int, seed: int, scale: float = 0.3) -> Poses:
    """Poses of a machine whose shape differs a little from the file's, with one pose that was read wrongly."""
    machine = load_machine("cat215b")
    model = KinematicModel(machine)
    away = np.random.default_rng(7).standard_normal(len(model.parameters))
    geometry = model.parameters.nominal + scale * away * model.parameters.scale * np.array(
        ["cylinder" not in name for name in model.parameters.names])
    fixture = np.array(machine.fixtures[0].position)
    q = [closed_postures.random_postures(model, stage, count, geometry=geometry, fixture=fixture, seed=seed + k)
         for k, stage in enumerate(machine.stages)]
    stages = [stage.name for stage in machine.stages for _ in range(count)]
    return postures.record(model, np.concatenate(q), stages, ["ball"] * len(stages), geometry=geometry, seed=seed)


@pytest.fixture(scope="module")
def solved() -> Calibration:
    poses = table(15, 1)
    wrong = dict(poses.channels) | {"yoke.q": poses.channels["yoke.q"] + 0.02 * (np.arange(45) == 20)}
    poses = Poses("made", poses.stage, poses.fixture, channels=wrong)
    return calibrate(calibration_problem(load_machine("cat215b"), poses, table(4, 50), fixed={"ball.y": 0.0}), seed=3)


@pytest.fixture(scope="module")
def left(solved: Calibration, tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("calibration") / "new"
    solved.save(place, pages={"report.html": render(solved)}, wall_s=2.5)
    return place


def read(place: Path) -> dict[str, Any]:
    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} is not JSON")
    found: dict[str, Any] = json.loads((place / "estimate.json").read_text("utf-8"), parse_constant=refuse)
    return found


def rows(file: Path) -> list[dict[str, str]]:
    with file.open(encoding="utf-8", newline="") as lines:
        return list(csv.DictReader(lines))


def test_files_are_complete_and_the_machine_reads_back(left: Path, solved: Calibration) -> None:
    assert {file.name for file in left.iterdir()} == FILES
    machine = load_machine(left / "cat215b.toml")
    assert machine.link("boom").joint.a == solved["boom.a"].value
    assert machine.notes["boom.joint.a"].sigma == pytest.approx(solved.std[solved.problem.parameters.index("boom.a")])


def test_json_is_what_was_agreed(left: Path) -> None:
    content = read(left)
    assert set(content) == CONTRACT
    assert (content["method"], content["status"], content["seed"], content["wall_s"]) == ("joint", "ok", 3, 2.5)
    for one in content["parameters"]:
        assert set(one) == {"name", "kind", "unit", "nominal", "prior_std", "value", "std", "ci95", "bound",
                            "identifiability", "information_from_data"}
        assert one["identifiability"] in {"full", "combination", "none", "fixed"}
        assert one["ci95"] is None or one["ci95"][0] < one["value"] < one["ci95"][1]
    for pair in content["correlations"]:
        assert set(pair) == {"name", "other", "correlation"}
        assert abs(pair["correlation"]) <= 1
    assert set(content["conditioning"]) == {"rank", "condition_number", "noise_amplification_index", "parameters",
                                            "degrees_of_freedom"}
    assert set(content["workspace"]) == {"point", "median_std", "largest_std"}
    assert 0 < content["workspace"]["median_std"] <= content["workspace"]["largest_std"]
    assert {one["role"]: one["samples"] for one in content["inputs"]} == {"train": 45, "validation": 12}
    for one in content["diagnostics"]:
        assert set(one) == {"kind", "subject", "evidence", "text", "remedy", "meaning"}
        assert one["text"].endswith(".")


def test_numbers_are_those_of_the_answer(left: Path, solved: Calibration) -> None:
    content = read(left)
    for k, one in enumerate(content["parameters"]):
        assert (one["name"], one["value"]) == (solved.problem.parameters.names[k], solved.theta[k])
        assert one["std"] == (None if np.isnan(solved.std[k]) else solved.std[k])
        assert one["identifiability"] == solved.category(one["name"])
    by_name = {one["name"]: one for one in content["parameters"]}
    assert (by_name["ball.y"]["value"], by_name["ball.y"]["identifiability"], by_name["ball.y"]["std"]) == (
        0.0, "fixed", None)
    assert by_name["boom_cylinder.barrel.x"]["identifiability"] == "none"  # the prior tells it, the poses do not
    assert content["noise_scale"] == solved.noise_scale
    for data, one in content["fit"].items():
        assert {key: one["gap"][key] for key in ("rms", "vaf", "unit")} == {
            "rms": solved.fit[data]["gap"].rms, "vaf": solved.fit[data]["gap"].vaf, "unit": "m"}
    assert {(row["data"], float(row["rms"])) for row in rows(left / "fit.csv")} == {
        (data, one["gap"]["rms"]) for data, one in content["fit"].items()}
    table_of = rows(left / "parameters.csv")
    assert [row["value"] for row in table_of] == [repr(one["value"]) for one in content["parameters"]]


def test_the_wrong_pose_is_among_the_suspects(left: Path) -> None:
    content = read(left)
    named = {row for one in content["suspects"] if one["kind"] in ("stage", "stretch", "pose") for row in one["rows"]}
    assert 21 in named
    assert {k + 1 for k, row in enumerate(rows(left / "residuals.csv")) if row["suspect"] == "1"} == named
    for one in content["suspects"]:
        assert set(one) == {"kind", "name", "text", "strength", "size", "rivals", "rows", "poses", "paths"}
        assert any(one["name"] in other["subject"] for other in content["diagnostics"])


def test_residuals_are_those_of_every_pose(left: Path, solved: Calibration) -> None:
    found = rows(left / "residuals.csv")
    assert [row["data"] for row in found] == ["train"] * 45 + ["validation"] * 12
    own = np.linalg.norm(gaps(solved.problem, solved.theta, solved.q)[:, :3], axis=1)
    assert [float(row["gap_after [m]"]) for row in found[:45]] == pytest.approx(own)
    for data, before in (("train", "nominal"), ("validation", None)):
        some = [row for row in found if row["data"] == data]
        size = np.sqrt(np.mean([float(row["gap_after [m]"]) ** 2 for row in some]))
        assert size == pytest.approx(solved.fit[data]["gap"].rms)
        if before:
            size = np.sqrt(np.mean([float(row["gap_before [m]"]) ** 2 for row in some]))
            assert size == pytest.approx(solved.fit[before]["gap"].rms)
    assert found[20]["stage"] == solved.problem.poses.stage[20]


def test_page_stands_alone(left: Path, solved: Calibration) -> None:
    text = (left / "report.html").read_text("utf-8")
    for section in SECTIONS:
        assert f"<h2>{section}</h2>" in text, section
    kinds = [chart["kind"] for chart in data_of(text)["charts"]]
    assert (kinds.count("time"), kinds.count("field")) == (len(solved.fit["train"]), 2)
    assert kinds.count("curves") == len({(each.role, each.link) for each in solved.sides})
    (told,) = re.findall(r'aria-label="(Correlations of [^"]*)"', text)
    assert all(name in told for pair in list(solved.correlated_pairs)[:1] for name in pair)
    assert stands_alone(text)
    assert re.search(r"\bnan\b", re.sub(r"<svg.*?</svg>", "", text_of(text), flags=re.DOTALL)) is None


def test_the_tip_stands_at_its_fixture_in_every_pose_shown(left: Path, solved: Calibration) -> None:
    """The page's own bodies and joint positions against the places that hold the tip."""
    data = data_of((left / "report.html").read_text("utf-8"))
    scene, columns = data["scene"], data["samples"]["columns"]
    q = np.array([unpacked(columns[name]) for name in scene["replayed"]], dtype=float).T
    shown = SceneGraph(solved.machine, calibrator=True)
    held = np.array([mark["at"] for mark in scene["marks"]])
    for row in q[np.isfinite(q).all(axis=1)]:
        poses = shown.poses(dict(zip(shown.columns, row, strict=True)))
        body, at = shown.tip
        tip = (poses[body] @ np.array([*at, 1.0]))[:3]
        assert np.min(np.linalg.norm(held - tip, axis=1)) < 0.02  # what angles and geometry leave


def test_loading_gives_the_same_answer(left: Path, solved: Calibration) -> None:
    loaded = load(left)
    assert (loaded.job, loaded.status, loaded.method, loaded.machine_id) == (
        solved.job, solved.status, solved.method, solved.machine_id)
    assert loaded.parameters == solved.parameters
    assert loaded.diagnostics == solved.diagnostics
    assert loaded.fit == solved.fit
    assert loaded.inputs == solved.inputs
    assert loaded.details() == solved.details()
    assert repr(solved) == repr(loaded) == (
        f"<kinematic calibration of cat215b by joint: ok, {len(solved.parameters)} parameters, "
        f"{len(solved.diagnostics)} diagnostics>")
    assert dict(loaded.files()) == {**solved.files(), "report.html": (left / "report.html").read_text("utf-8")}
    assert loaded["boom.a"].value == solved["boom.a"].value == solved.machine.link("boom").joint.a


def test_what_is_not_determined_has_no_number() -> None:
    answer = calibrate(calibration_problem(load_machine("cat215b"), table(10, 5), priors=False))
    lost = answer.parameters["boom_cylinder.barrel.x"]
    assert (lost.value, lost.std, lost.ci95, lost.identifiability) == (None, None, None, "none")
    unknown = [one for one in answer.parameters.rows if one.value is None]
    assert all(one.identifiability in {"none", "combination"} for one in unknown)
    assert {one.name for one in unknown} == {
        name for one in of_kind(answer.diagnostics, "not determined") for name in one.subject}
    content = answer.details()
    assert content["combinations"]
    assert content["conditioning"]["rank"] < content["conditioning"]["parameters"]


@pytest.mark.slow
def test_impossible_geometry_is_not_written(solved: Calibration, tmp_path: Path,
                                            monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any, **__: Any) -> None:
        raise MachineError("a dead point lies in the range", where="the calibrated machine", remedy="widen it")
    monkeypatch.setattr("hydroopt.estimation.kinematic.solution.read_machine", refuse)
    answer = replace(solved)  # without what was computed before
    answer.save(tmp_path)
    assert {file.name for file in tmp_path.iterdir()} == FILES - {"cat215b.toml", "report.html"}
    assert "a dead point" in str(of_kind(answer.diagnostics, "no calibrated machine")[0])
    assert not any(step.action is Action.USE for step in answer.next_steps)
    monkeypatch.undo()
    assert solved.next_steps[-1].action is Action.USE


def test_a_calibration_that_writes_no_machine_says_so_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    crane = load_machine("patu655_lift")
    model = KinematicModel(crane)
    q = np.linspace(*crane.link("lift").joint.range, 20)[:, None]
    answer = calibrate(calibration_problem(crane, postures.record(
        model, q, [""] * 20, [""] * 20, geometry=model.parameters.nominal,
        channels=postures.measured_channels(model), seed=1)))
    assert answer.status is Status.OK
    monkeypatch.setattr("hydroopt.estimation.kinematic.solution.within_strokes", Mock(
        side_effect=MachineError("a dead point lies in the range", where="lift", remedy="narrow its limits")))
    without = replace(answer)  # without what was computed before
    without.save(tmp_path)
    verdict = load(tmp_path).verdict
    assert verdict == without.verdict
    assert (verdict.status, verdict.cause) == (
        Status.SUSPECT, "No calibrated machine is written: lift: a dead point lies in the range; narrow its limits.")
    assert verdict.next_steps[0] == NextStep(Action.CHECK, "Correct limits in the machine file, or fix parameters.")
    assert not verdict.serves


def run(*arguments: str) -> str:
    done = CliRunner().invoke(cli.app, ["calibrate", *arguments], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return done.stdout


def mukca(*stages: str) -> list[str]:
    return ["panda_mukca", *(str(MUKCA / stage / "hole_0.csv") for stage in stages), "--map", str(MUKCA / "map.toml")]


@pytest.mark.slow
def test_command_on_real_poses(tmp_path: Path) -> None:
    arguments = mukca("front_center", "back_left", "mid_right")
    content = json.loads(run(*arguments, "--holdout-stage", "back_left", "--json", "-o", str(tmp_path)))
    assert content == read(tmp_path)
    assert {Path(one["path"]).parent.name: one["role"] for one in content["inputs"]} == {
        "front_center": "train", "mid_right": "train", "back_left": "validation"}
    assert content["fit"]["train"]["gap"]["rms"] < 0.2 * content["fit"]["nominal"]["gap"]["rms"]
    assert len(rows(tmp_path / "residuals.csv")) == sum(one["samples"] for one in content["inputs"])
    assert (tmp_path / "report.html").exists()
    loaded = load(tmp_path)
    assert [each.as_dict() for each in loaded.parameters.rows] == content["parameters"]
    assert [each.as_dict() for each in loaded.diagnostics] == content["diagnostics"]
    assert ("panda_mukca.toml" not in loaded.files()) == bool(of_kind(loaded.diagnostics, "no calibrated machine"))


@pytest.mark.slow
def test_command_leaves_out_what_does_not_fit(tmp_path: Path) -> None:
    arguments = mukca("high", "front_center", "mid_right", "back_right")
    text = run(*arguments, "--without-suspects", "--fix", "panda_joint5.compliance=0 rad/(N*m)", "-o", str(tmp_path))
    content = read(tmp_path)
    # twelve poses in a row of one of the four files, some by themselves and the others as a stretch
    assert {path for one in content["left_out"] for path in one["paths"]} == {str(MUKCA / "high" / "hole_0.csv")}
    assert {row for one in content["left_out"] for row in one["rows"]} == set(range(7, 19))
    assert "were left out" in text
    assert sum(one["samples"] for one in content["inputs"]) > len(rows(tmp_path / "residuals.csv"))
    by_name = {one["name"]: one for one in content["parameters"]}
    assert by_name["panda_joint5.compliance"]["identifiability"] == "fixed"
    assert by_name["hole_0.high.x"]["identifiability"] == "full"  # from the other poses of that file


@pytest.mark.parametrize(("options", "said"), [
    (("--method", "magic"), "not a method"), (("--loss", "cubes"), "does not exist"),
    (("--fix", "tip.x=1"), "no unit"),
    (("--fix", "tip.x=1 rad"), "rad"), (("--fix", "tip.q=1 m"), "did you mean tip"),
    (("--holdout-stage", "nowhere"), "no pose is of stage"), (("--holdout-stage", "high"), "no training pose is left"),
    (("--starts", "0"), "--starts"), (("--validate", "missing.csv"), "missing.csv")])
def test_wrong_options_end_in_one_sentence(options: tuple[str, ...], said: str, tmp_path: Path,
                                           capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["hydroopt", "calibrate", *mukca("high"), *options, "-o", str(tmp_path / "new")])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 2
    sentence = capsys.readouterr().err.strip().splitlines()
    assert len(sentence) == 1
    assert said in sentence[0]
    assert not (tmp_path / "new").exists()


def test_a_failed_solver_leaves_its_reason(tmp_path: Path, capsys: pytest.CaptureFixture[str],
                                           monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: Any, **__: Any) -> None:
        raise SolverError("no convergence", where="IPOPT", remedy="check the poses")
    monkeypatch.setattr("hydroopt.estimation.kinematic.calibration.calibrate", fail)
    monkeypatch.setattr(sys, "argv", ["hydroopt", "calibrate", *mukca("high"), "-o", str(tmp_path)])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 3
    assert "no convergence" in capsys.readouterr().err
    content = read(tmp_path)
    assert (content["status"], content["reason"]) == ("failed", "IPOPT: no convergence; check the poses.")
    assert [file.name for file in tmp_path.iterdir()] == ["estimate.json"]


def test_machines_that_nothing_holds_have_a_report(tmp_path: Path) -> None:
    """Angles and a cylinder's length alone: the end is the machine's, and its place does not depend on pins."""
    model = KinematicModel(load_machine("wheel_loader"))
    q = np.random.default_rng(0).uniform(*model.ranges.T, (20, len(model.joints)))
    none = [""] * len(q)
    poses = postures.record(model, q, none, none, geometry=model.parameters.nominal, channels=(
        "lift.q", "bucket.q", "lift_cylinder.length", "tilt_cylinder.length"))
    found = calibrate(calibration_problem(model.machine, poses))
    assert found.status == "ok"
    assert np.ptp(found.workspace.position[:, 0]) > 1
    assert np.all(np.isnan(found.workspace.std))
    assert found.workspace.exact == ("lift.a", "bucket.a")
    claim = found.claims[0]
    assert (claim.purpose, claim.usable, claim.bound) == (Purpose.POSITION, Usable.UNTESTED, None)
    assert claim.reason == "the machine file states no sigma of lift.a, bucket.a"
    assert "a sigma of lift.a, bucket.a" in found.next_steps[-2].text
    assert "tilt_cylinder.barrel.x" in render(found)
