"""`hydroopt plan-poses` as a user runs it."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from hydroopt.cli import app
from hydroopt.errors import ProblemError


def plan_poses(*arguments: object) -> str:
    done = CliRunner().invoke(app, ["plan-poses", *map(str, arguments)], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return done.stdout


@pytest.mark.slow
def test_poses_are_planned_by_a_criterion(tmp_path: Path) -> None:
    printed = plan_poses("cat215b", "-n", 4, "--criterion", "E", "--seed", 3, "-o", tmp_path)
    assert {file.name for file in tmp_path.iterdir()} == {"sheet.txt", "poses.csv", "postures.csv", "plan.json",
                                                           "parameters.csv", "report.html"}
    assert (tmp_path / "sheet.txt").read_text("utf-8") in printed  # below the verdict
    content = json.loads((tmp_path / "plan.json").read_text("utf-8"))
    assert content["poses"] == 12, "four in each of three stages"
    assert (content["seed"], content["criterion"], content["job"]) == (3, "E", "pose plan")


def test_stages_and_parameters_can_be_left_out(tmp_path: Path) -> None:
    printed = plan_poses("cat215b", "-n", 9, "--stage", "stick_moves", "--candidates", 60, "--fix", "ball.y=0 mm",
                         "--json", "-o", tmp_path)
    content = json.loads(printed)
    assert (content["poses"], content["candidates"], content["fixed"]) == (9, 60, {"ball.y": 0.0})


def test_unknown_parameters_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ProblemError, match="no parameter has this name"):
        plan_poses("cat215b", "-n", 9, "--fix", "bowl.y=0 mm", "-o", tmp_path)
