"""Identified valves from the command line: what they leave behind is strict, whole and a machine again."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from fixtures.pages import data_of, stands_alone
from hydroopt.cli import app
from hydroopt.machine.machine_file import load_machine

CRANE = str(Path(__file__).parents[2] / "studies" / "actuator_coverage" / "crane.toml")
FILES = {"estimate.json", "report.html", "parameters.csv", "fit.csv", "free_run.csv", "crane.toml"}


def run(*arguments: str) -> str:
    done = CliRunner().invoke(app, list(arguments), catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return done.stdout


def table(path: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(path.read_text().splitlines()))


@pytest.fixture(scope="module")
def left(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("valves")
    run("simulate", CRANE, "--driven", "--duration", "5", "--seed", "3", "-o", str(folder / "log"), "--quiet")
    run("identify-valves", CRANE, str(folder / "log" / "log.csv"), "--holdout", "0.3", "-o",
        str(folder / "out"), "--quiet")
    return folder


@pytest.mark.slow
def test_everything_is_left_and_says_the_same(left: Path) -> None:
    content = json.loads((left / "out" / "estimate.json").read_text())
    assert {path.name for path in (left / "out").iterdir()} == FILES
    assert content["status"] == "ok"
    assert [one["role"] for one in content["inputs"]] == ["train", "validation"]
    assert set(content["fit"]) == {"train", "validation"}
    rows = table(left / "out" / "parameters.csv")
    assert [row["name"] for row in rows] == [one["name"] for one in content["parameters"]]
    samples = table(left / "out" / "free_run.csv")
    assert len(samples) == 250
    unseen = [row for row in samples if row["data"] == "validation"]
    error = np.array([float(row["jack.length free"]) - float(row["jack.length"]) for row in unseen])
    assert np.sqrt(np.mean(error**2)) == pytest.approx(content["fit"]["validation"]["jack.length"]["rms"])
    assert content["fit"]["validation"]["jack.length"]["rms"] < 1e-3


@pytest.mark.slow
def test_intervals_hold_what_was_simulated(left: Path) -> None:
    truth = json.loads((left / "log" / "truth.json").read_text())["parameters"]
    content = json.loads((left / "out" / "estimate.json").read_text())
    inside = [one["ci95"][0] <= truth[one["name"]] <= one["ci95"][1] for one in content["parameters"]]
    assert sum(inside) >= len(inside) - 2


@pytest.mark.slow
def test_the_machine_file_holds_the_answer(left: Path) -> None:
    content = json.loads((left / "out" / "estimate.json").read_text())
    machine = load_machine(str(left / "out" / "crane.toml"))
    found = {one["name"]: one for one in content["parameters"]}
    assert machine.oil.bulk_modulus == pytest.approx(found["oil.bulk_modulus"]["value"], rel=1e-6)
    note = machine.notes["jack.circuit.valve.flow_pa"]
    assert note.sigma == pytest.approx(found["jack.flow_pa"]["std"], rel=1e-3)
    assert "identified from" in note.source


@pytest.mark.slow
def test_the_page_shows_free_runs_and_diagnostics(left: Path) -> None:
    page = (left / "out" / "report.html").read_text()
    for title in ("Diagnostics", "Free run", "Parameters", "Balances", "Data"):
        assert f"<h2>{title}</h2>" in page
    lines = [[line["label"] for line in chart["lines"]] for chart in data_of(page)["charts"]]
    assert lines.count(["measured", "free run"]) >= 3
    assert 'class="interval"' in page
    assert "jack.dead_band_reverse" in page
    assert stands_alone(page)


@pytest.mark.slow
def test_commands_drive_a_machine_again(left: Path) -> None:
    run("simulate", CRANE, "--commands", str(left / "log" / "log.csv"), "--no-noise", "-o", str(left / "again"))
    first, again = (table(left / name / "log.csv") for name in ("log", "again"))
    assert [row["jack.u [V]"] for row in first] == [row["jack.u [V]"] for row in again]
    apart = [float(a["jack.length [m]"]) - float(b["jack.length [m]"]) for a, b in zip(first, again, strict=True)]
    assert np.max(np.abs(apart)) < 3e-3
