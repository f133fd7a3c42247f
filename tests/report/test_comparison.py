"""The folders of a comparison and of a payload, and a session that is kept instead of its logs."""

from __future__ import annotations

import csv
import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from fixtures.pages import stands_alone
from hydroopt import cli, load_machine, read_log
from hydroopt.cli import app
from hydroopt.errors import SolverError
from hydroopt.estimation.dynamic.experiment import experiment
from hydroopt.estimation.dynamic.payload import payload
from hydroopt.estimation.dynamic.session_comparison import compare
from hydroopt.estimation.dynamic.stored_information import stored_information
from hydroopt.model.model import Model
from hydroopt.report.page import prose
from hydroopt.results.answer import load
from hydroopt.results.diagnostic import Diagnostic, Meaning
from hydroopt.results.status import Status

CRANE = load_machine("patu655_lift")


def run(*arguments: str) -> str:
    done = CliRunner().invoke(app, list(arguments), catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return done.stdout


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two logs of a crane, and the folder that identify makes of the first."""
    root = tmp_path_factory.mktemp("crane")
    for name, seed in (("a", "1"), ("b", "2")):
        run("simulate", "patu655_lift", "-o", str(root / name), "--duration", "20", "--rate", "20", "--seed", seed,
            "--quiet")
    run("identify", "patu655_lift", str(root / "a/log.csv"), "-o", str(root / "kept"), "--quiet")
    return root


@pytest.mark.slow
def test_a_folder_tells_what_its_logs_told(made: Path) -> None:
    before, after = (read_log(made / name / "log.csv") for name in "ab")
    from_logs, from_folder = (compare(CRANE, [first, after]) for first in (before, made / "kept"))
    assert from_folder.p_value == pytest.approx(from_logs.p_value, rel=1e-9)
    for one, other in zip(from_logs.differences, from_folder.differences, strict=True):
        for key in ("value", "std", "ci95", "p_value", "detectable"):
            assert getattr(other, key) == pytest.approx(getattr(one, key), rel=1e-6)
    loads = [payload(CRANE, first, [after], link="lift") for first in ([before], made / "kept")]
    assert [q.value for q in loads[1].moment] == pytest.approx([q.value for q in loads[0].moment], rel=1e-9,
                                                               nan_ok=True)
    assert loads[1].before.inputs == loads[0].before.inputs


def test_compare_leaves_json_table_and_page(made: Path, tmp_path: Path) -> None:
    printed = run("compare", "patu655_lift", str(made / "kept"), str(made / "b/log.csv"), "-o", str(tmp_path))
    content = json.loads((tmp_path / "comparison.json").read_text())
    assert (content["job"], content["status"]) == ("comparison of sessions", "ok")
    assert content["machine"]["sha256"] == CRANE.sha256
    assert [one["name"] for one in content["differences"]] == ["lift_cylinder.f_coulomb", "lift_cylinder.f_viscous"]
    with (tmp_path / "comparison.csv").open() as file:
        rows = list(csv.DictReader(file))
    for row, one in zip(rows, content["differences"], strict=True):
        assert float(row["value"]) == one["value"]
        assert [float(row["low"]), float(row["high"])] == one["ci95"]
    page = (tmp_path / "report.html").read_text()
    assert stands_alone(page)
    (finding,) = content["findings"]
    assert printed.count(finding["text"]) == page.count(str(prose(finding["text"]))) == 1
    assert {path.name for path in tmp_path.iterdir()} == {"comparison.json", "comparison.csv", "sessions.csv",
                                                          "report.html"}


def test_three_sessions_leave_json_tables_and_page(made: Path, tmp_path: Path,
                                                   monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    later = read_log(made / "b/log.csv")
    halves = later.split(0.5)
    for name, half in zip(("b", "c"), halves, strict=True):
        half.to_frame().to_parquet(tmp_path / f"{name}.parquet")
    out = tmp_path / "out"
    printed = run("compare", "patu655_lift", str(made / "kept"), str(tmp_path / "b.parquet"),
                  str(tmp_path / "c.parquet"), "-o", str(out))
    content = json.loads((out / "comparison.json").read_text())
    assert (content["job"], content["status"]) == ("comparison of sessions", "ok")
    assert [one["role"] for one in content["inputs"]] == ["session 1", "session 2", "session 3"]
    page = (out / "report.html").read_text()
    assert all(len(one["sessions"]) == 3 for one in content["differences"])
    assert str(prose(content["findings"][0]["text"])) in page
    with (out / "sessions.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [(row["session"], row["name"]) for row in rows] == [
        (str(k), name) for name in ("lift_cylinder.f_coulomb", "lift_cylinder.f_viscous") for k in (1, 2, 3)]
    assert float(rows[2]["change"]) == content["differences"][0]["sessions"][2]["change"]
    assert {path.name for path in out.iterdir()} == {"comparison.json", "comparison.csv", "sessions.csv",
                                                     "report.html"}
    answer = load(out)
    assert printed.startswith(f"{answer.verdict.card()}\n\n")


@pytest.mark.slow
def test_json_is_the_file_and_what_is_not_told_is_null(made: Path, tmp_path: Path) -> None:
    printed = json.loads(run("identify-payload", "patu655_lift", "--unloaded", str(made / "kept"), "--loaded",
                             str(made / "b/log.csv"), "--link", "lift", "--friction-changes", "--gain-error", "0.02",
                             "--json", "-o", str(tmp_path)))
    assert printed | {"created": ""} == json.loads((tmp_path / "payload.json").read_text()) | {"created": ""}
    assert {path.name for path in tmp_path.iterdir()} == {"payload.json", "payload.csv", "report.html"}
    numbers = {one["name"]: one for one in printed["quantities"]}
    assert numbers["m"]["value"] is None
    assert numbers["m"]["std"] is None
    assert numbers["m"]["ci95"] is None
    assert numbers["mc_x"]["ci95"][0] < numbers["mc_x"]["value"] < numbers["mc_x"]["ci95"][1]
    assert [one["name"] for one in printed["gains"]] == ["lift_cylinder.gain"]
    assert [one["name"] for one in printed["friction"]] == ["lift_cylinder.f_coulomb", "lift_cylinder.f_viscous"]
    assert "mass of the payload not separable" in {one["kind"] for one in printed["diagnostics"]}


@pytest.mark.slow
def test_what_is_loaded_says_the_same(made: Path, tmp_path: Path) -> None:
    before, after = ([read_log(made / name / "log.csv")] for name in "ab")
    answers = (compare(CRANE, [before, after]), payload(CRANE, before, after, link="lift"))
    for k, answer in enumerate(answers):
        answer.save(tmp_path / str(k))
        loaded = load(tmp_path / str(k))
        for text in (repr, str):
            assert text(loaded) == text(answer)
        for name in ("parameters", "findings", "diagnostics", "status", "inputs", "job"):
            assert getattr(loaded, name) == getattr(answer, name), name
        loaded.save(tmp_path / f"again{k}")
        for file in (tmp_path / str(k)).glob("*.csv"):
            assert (tmp_path / f"again{k}" / file.name).read_bytes() == file.read_bytes()


@pytest.mark.parametrize(("command", "options"), [("compare", ((), ())),
                                                  ("identify-payload", (["--unloaded"], ["--loaded"]))])
@pytest.mark.slow
def test_a_misread_log_ends_the_command_with_3(made: Path, tmp_path: Path, command: str, options) -> None:
    later = read_log(made / "b/log.csv")
    wrong = {name: values / 1e5 if ".p_" in name else values for name, values in later.channels.items()}
    replace(later, channels=wrong).to_frame().to_parquet(tmp_path / "bar.parquet")
    done = CliRunner().invoke(app, [command, "patu655_lift", *options[0], str(made / "kept"), *options[1],
                                    str(tmp_path / "bar.parquet"), "-o", str(tmp_path / "out")])
    assert isinstance(done.exception, SolverError), done.output
    assert done.exception.exit_code == 3
    answer = load(tmp_path / "out")
    assert answer.status is Status.SUSPECT
    assert answer.diagnostics[0].kind == "log misread"
    assert "pressures in bar" in answer.diagnostics[0].evidence["reading"]


def test_what_contradicts_a_log_is_known_from_its_folder(made: Path, tmp_path: Path) -> None:
    misread = Diagnostic("log misread", ("lift.q",), {"log": "a.csv", "reading": "the sign of lift.q reversed"},
                         "It is misread.", meaning=Meaning.REFUTATION)
    content = json.loads((made / "kept/estimate.json").read_text()) | {"diagnostics": [misread.as_dict()]}
    (tmp_path / "estimate.json").write_text(json.dumps(content))
    (tmp_path / "information.csv").write_bytes((made / "kept/information.csv").read_bytes())
    assert stored_information(Model(CRANE), tmp_path).of_logs == (misread,)


@pytest.mark.slow
def test_quiet_is_quiet(made: Path, tmp_path: Path) -> None:
    assert run("compare", "patu655_lift", str(made / "a/log.csv"), str(made / "b/log.csv"),
               "--parts", "lift_cylinder.f_viscous", "--quiet", "-o", str(tmp_path)) == ""


def test_a_failed_solver_leaves_its_reason_only(made: Path, tmp_path: Path, monkeypatch, capsys) -> None:
    def fails(*_, **__):
        raise SolverError("no answer", where="here", remedy="try again")
    compare(CRANE, [read_log(made / name / "log.csv") for name in "ab"]).save(tmp_path)
    monkeypatch.setattr("hydroopt.estimation.dynamic.session_comparison.compare", fails)
    monkeypatch.setattr(sys, "argv", ["hydroopt", "compare", "patu655_lift", str(made / "kept"),
                                      str(made / "b/log.csv"), "-o", str(tmp_path)])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 3
    assert "here: no answer; try again." in capsys.readouterr().err
    content = json.loads((tmp_path / "comparison.json").read_text())
    assert content["status"] == "failed"
    assert [path.name for path in tmp_path.iterdir()] == ["comparison.json"]


def test_what_is_kept_reproduces_the_fit(made: Path) -> None:
    """Independent of the code that reads it: the triangles fit the log as its own least squares do."""
    content = json.loads((made / "kept/estimate.json").read_text())
    with (made / "kept/information.csv").open() as file:
        rows = list(csv.DictReader(file))
    names = [one["name"] for one in content["parameters"]]
    T = np.array([[float(row[key]) for key in [*names, "force"]] for row in rows])
    data = experiment(Model(CRANE), read_log(made / "a/log.csv"))
    taken = data.inside & data.known[:, 0]
    K, force = (values[taken, 0] for values in (data.equations()[0][0], data.force))
    size = np.maximum(np.linalg.norm(K, axis=0), 1e-12)

    def error(rows: np.ndarray, right: np.ndarray) -> float:
        psi = np.linalg.lstsq(rows / size, right, rcond=1e-9)[0] / size
        return float(np.linalg.norm(force - K @ psi))

    assert error(T[:, :-1], T[:, -1]) == pytest.approx(error(K, force), rel=0.02)
    assert content["weights"]["lift_cylinder"]["samples"] == len(force)
