"""`hydroopt check` and `hydroopt models` as a user runs them."""

from __future__ import annotations

import json
import shlex
from pathlib import Path

import pytest
from typer.testing import CliRunner

import hydroopt
from hydroopt.cli import app
from hydroopt.errors import SolverError


def run(*arguments: str) -> str:
    done = CliRunner().invoke(app, list(arguments), catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return done.stdout


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("lift")
    run("simulate", "patu655_lift", "--duration", "20", "--rate", "20", "--seed", "1", "-o", str(out))
    return out / "log.csv"


def test_a_good_log_is_usable_and_the_next_step_is_named(log: Path, tmp_path: Path) -> None:
    text = run("check", "patu655_lift", str(log), "-o", str(tmp_path / "out"))
    assert text.splitlines()[0].endswith(": ok")
    assert "usable      identification from these logs" in text
    assert "hydroopt identify patu655_lift" in text
    saved = hydroopt.load(tmp_path / "out")
    assert saved.job == "check of logs"
    assert saved.parameters["lift_cylinder.f_coulomb"].std is not None


def test_the_next_command_runs_as_it_is_printed(log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A log under foreign names, whose dropped samples split it into stretches that are too short alone."""
    lines = log.read_text().splitlines()
    lines[0] = ",".join(name.replace(".", "/") for name in lines[0].split(","))
    kept = [line for k, line in enumerate(lines) if k == 0 or k % 40 > 4]
    (tmp_path / "my log.csv").write_text("\n".join(kept) + "\n")
    monkeypatch.chdir(tmp_path)
    columns = {name.replace("/", ".").split()[0]: name for name in lines[0].split(",")}
    (tmp_path / "map.toml").write_text("[columns]\n" + "".join(
        f'"{channel}" = {{ column = "{name}", unit = "{name.split("[")[1][:-1]}" }}\n'
        for channel, name in columns.items()))
    options = ("patu655_lift", "my log.csv", "--map", "map.toml", "--treat", "spike=keep")
    steps = json.loads(run("check", *options, "--json"))["verdict"]["next_steps"]
    assert "--treat gap=keep" in steps[0]["text"]
    found = run("check", *options, "--treat", "gap=keep")
    assert "Not judged here: offsets" in found
    command = shlex.split(next(line for line in found.splitlines() if line.strip().startswith("hydroopt identify")))
    assert command[4:] == ["--map", "map.toml", "--treat", "spike=keep", "--treat", "gap=keep", "--holdout", "0.3",
                           "-o", "out"]
    assert run(*command[1:]).splitlines()[0].endswith(": ok")


def test_as_json(log: Path) -> None:
    content = json.loads(run("check", "patu655_lift", str(log), "--json"))
    assert content["conditioning"]["rank"] == content["conditioning"]["structural_rank"] == 5
    assert content["verdict"]["unbounded"][0]["usable"] == "usable"


def test_a_log_with_a_flipped_sign_is_not_usable(log: Path, tmp_path: Path) -> None:
    lines = log.read_text().splitlines()
    column = lines[0].split(",").index("lift.q [rad]")
    flipped = [line.split(",") for line in lines[1:]]
    for cells in flipped:
        cells[column] = repr(-float(cells[column]))
    wrong = tmp_path / "flipped.csv"
    wrong.write_text("\n".join([lines[0], *(",".join(cells) for cells in flipped)]) + "\n")
    with pytest.raises(SolverError, match="contradict the machine file"):
        CliRunner().invoke(app, ["check", "patu655_lift", str(wrong)], catch_exceptions=False)
    text = CliRunner().invoke(app, ["check", "patu655_lift", str(wrong)]).stdout
    assert ": suspect. Read with " in text.splitlines()[0]
    assert "the sign of lift.q reversed" in " ".join(text.split())
    assert "usable" not in text.replace("not usable", "")
    assert "identify" not in text.lower().replace("identification from these logs", "").replace("identifies", "")


def test_models_lists_every_bundled_machine() -> None:
    rows = json.loads(run("models", "--json"))
    assert [row["name"] for row in rows] == list(hydroopt.bundled())
    crane = next(row for row in rows if row["name"] == "patu655")
    assert (crane["joints"], crane["moved_by"]) == (2, "2 cylinders")
    assert all(row["assumed"] <= row["stated"] for row in rows)
