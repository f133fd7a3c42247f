"""`hydroopt plan-valve-test`, and the log that `simulate --valve-test` gives of it."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from hydroopt.cli import app
from hydroopt.errors import ProblemError
from hydroopt.results.answer import load


def run(*arguments: object) -> str:
    done = CliRunner().invoke(app, [*map(str, arguments)], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return done.stdout


def test_the_sheet_states_limits_and_steps(tmp_path: Path) -> None:
    printed = run("plan-valve-test", "cat215b", "-o", tmp_path)
    assert (tmp_path / "sheet.txt").read_text("utf-8").strip() == printed.strip()
    assert "Test of the valves of cat215b: 30 s" in printed
    assert all(f"{joint} position" in printed for joint in ("swing", "boom", "stick"))
    assert "Keep everyone" in printed
    with (tmp_path / "steps.csv").open(encoding="utf-8") as file:
        steps = list(csv.DictReader(file))
    assert {step["actuator"] for step in steps} == {"swing_motor", "boom_cylinder", "stick_cylinder"}
    assert sum(float(step["seconds"]) for step in steps) == pytest.approx(30.0)


@pytest.mark.slow
def test_bodies_and_valves_are_identified_from_one_test(tmp_path: Path) -> None:
    """Flows of a drawn crane within their intervals, as from its 10 s no other log is needed."""
    run("simulate", "patu655_lift", "--valve-test", "--truth", "random", "--seed", "4", "-o", tmp_path / "test")
    run("identify-valves", "patu655_lift", tmp_path / "test" / "log.csv", "-o", tmp_path / "valves", "--quiet")
    truth = json.loads((tmp_path / "test" / "truth.json").read_text("utf-8"))["parameters"]
    flows = [row for name, row in load(tmp_path / "valves").parameters.items() if "flow" in name]
    assert flows
    for row in flows:
        assert row.std is not None
        assert row.value is not None
        assert abs(row.value - truth[row.name]) < 4 * row.std < 0.1 * truth[row.name]


@pytest.mark.parametrize(("arguments", "said"), [
    (("plan-valve-test", "cat215b", "--per-actuator", "2"), "does not cover all openings; give 10 s or more"),
    (("plan-valve-test", "kr300"), "driven directly, not by oil"),
    (("simulate", "cat215b", "--valve-test", "--duration", "3"), "has steps of its own")])
def test_what_cannot_be_is_said(arguments: tuple[str, ...], said: str, tmp_path: Path) -> None:
    with pytest.raises(ProblemError, match=said):
        run(*arguments, "-o", tmp_path / "out")
    assert not (tmp_path / "out").exists() or not list((tmp_path / "out").iterdir())
