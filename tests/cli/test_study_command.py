"""`hydroopt study` as a user runs it: what it leaves, and Ctrl-C."""

from __future__ import annotations

import csv
import json
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

from fixtures.pages import data_of, stands_alone
from hydroopt.cli import app
from hydroopt.errors import StoppedError
from hydroopt.study.montecarlo import VARIED

QUICK = ("patu655_lift", "--duration", "6", "--method", "wls")


def run(*arguments: str) -> str:
    done = CliRunner().invoke(app, ["study", *arguments], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return done.stdout


@pytest.fixture(scope="module")
def montecarlo(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    out = tmp_path_factory.mktemp("study") / "out"
    return out, run("montecarlo", *QUICK, "--cells", "5", "--processes", "1", "-o", str(out))


@pytest.mark.slow
def test_two_workers_give_the_same_bits_as_one(montecarlo: tuple[Path, str], tmp_path: Path) -> None:
    said = json.loads(run("montecarlo", *QUICK, "--cells", "5", "--processes", "2", "--json", "-o", str(tmp_path)))
    for name in ("results.csv", "summary.json", "study.json"):
        assert (tmp_path / name).read_bytes() == (montecarlo[0] / name).read_bytes()
    assert said == json.loads((tmp_path / "summary.json").read_text("utf-8"))


def test_a_study_leaves_table_summary_and_report(montecarlo: tuple[Path, str]) -> None:
    out, said = montecarlo
    assert {file.name for file in out.iterdir()} == {
        "study.json", "cells", "results.csv", "summary.json", "report.html"}
    rows = list(csv.DictReader((out / "results.csv").read_text("utf-8").splitlines()))
    summary = json.loads((out / "summary.json").read_text("utf-8"))
    (point,) = summary["points"]
    first = next(row for row in point["parameters"] if row["coverage"] is not None)
    inside = [float(row[f"{first['name']}.inside"]) for row in rows]
    assert first["coverage"] == sum(inside) / 5
    page = (out / "report.html").read_text("utf-8")
    assert stands_alone(page)
    assert data_of(page)["charts"]
    assert "All cells gave a result" in page
    assert "contain the true value" in said


def test_the_same_command_again_computes_nothing(montecarlo: tuple[Path, str]) -> None:
    out, _ = montecarlo
    before = {file.name: file.stat().st_mtime_ns for file in (out / "cells").iterdir()}
    nobody = ("--scheduler", "tcp://127.0.0.1:1")
    assert run("montecarlo", *QUICK, "--cells", "5", *nobody, "--quiet", "-o", str(out)) == ""
    assert {file.name: file.stat().st_mtime_ns for file in (out / "cells").iterdir()} == before


def test_an_interrupted_study_says_how_to_go_on(montecarlo: tuple[Path, str], tmp_path: Path,
                                                monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt
    monkeypatch.setattr("hydroopt.study.run.computed", interrupted)
    out = shutil.copytree(montecarlo[0], tmp_path / "out")
    for name in ("cells/1.json", "cells/3.json", "results.csv"):
        (out / name).unlink()
    done = CliRunner().invoke(app, ["study", "montecarlo", *QUICK, "--cells", "5", "-o", str(out)])
    assert isinstance(done.exception, StoppedError)
    assert done.exception.exit_code == 130
    assert "interrupted after 3 of 5 cells, which are kept; run the same command again" in str(done.exception)
    assert len(list((out / "cells").glob("*.json"))) == 3
    assert not (out / "results.csv").exists()


def test_help_names_what_a_sweep_varies() -> None:
    said = run("montecarlo", "--help")
    assert all(name in said for name in VARIED)


@pytest.fixture
def terminal(tmp_path: Path) -> Iterator[tuple[object, Path]]:
    if sys.platform == "win32":
        pytest.skip("no terminal to press Ctrl-C in")
    from fixtures.terminal import Terminal

    running = Terminal("study", "montecarlo", *QUICK, "--cells", "2000", "--processes", "1", "-o",
                       str(tmp_path / "out"))
    yield running, tmp_path / "out"
    running.close()


@pytest.mark.slow
def test_ctrl_c_keeps_the_cells_and_says_how_to_go_on(terminal: tuple[object, Path]) -> None:
    running, out = terminal
    running.until(lambda: "of 2000 cells " in running.shown and " left" in running.last)
    running.press_ctrl_c()
    assert running.ended() == 130, running.last
    kept = len(list((out / "cells").glob("*.json")))
    assert f"interrupted after {kept} of 2000 cells, which are kept; run the same command again" in running.last
    assert kept > 0
    assert "Traceback" not in running.shown
    assert not (out / "results.csv").exists()
