"""A suspect answer ends with exit code 3 and marks its machine, which all commands refuse unless they are forced."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import hydroopt as ho
from hydroopt.cli import app
from hydroopt.errors import SolverError


@pytest.fixture(scope="module")
def suspect(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Answer of a log whose pressures are 0.1 s late."""
    folder, model = tmp_path_factory.mktemp("late"), ho.Model("patu655_lift")
    log = ho.simulate(model, ho.random_trajectory(model, duration=30.0, rate=50.0, seed=3), seed=3)
    replace(log, channels={name: np.concatenate([np.repeat(x[:1], 5), x[:-5]]) if ".p_" in name else x
                           for name, x in log.channels.items()}).write(folder / "log.csv")
    done = CliRunner().invoke(app, ["identify", "patu655_lift", str(folder / "log.csv"), "-o", str(folder / "out")])
    assert isinstance(done.exception, SolverError), done.output
    assert done.exception.exit_code == 3
    assert done.output.startswith("patu655_lift: identification by sdp: suspect. ")
    return folder


@pytest.mark.parametrize("arguments", [
    ["show", "MACHINE"], ["codegen", "MACHINE", "-o", "c"], ["codegen", "out", "-o", "c"],
    ["simulate", "MACHINE", "--duration", "5", "-o", "run"], ["check", "MACHINE", "log.csv"],
    ["excite", "out", "-o", "e"], ["control", "out", "--motion", "log.csv", "-o", "loops"],
    ["plan-poses", "MACHINE", "-n", "5", "-o", "poses"],
    ["weigh", "MACHINE", "log.csv", "--calibration", "log.csv", "--full-scale", "100 kg", "-o", "w"],
    ["convert", "MACHINE", "arm.urdf"],
    ["identify", "MACHINE", "log.csv", "-o", "again"]], ids=lambda arguments: " ".join(arguments[:2]))
def test_commands_refuse_its_machine(suspect: Path, tmp_path: Path, arguments: list[str]) -> None:
    places = {"MACHINE": suspect / "out/patu655_lift.toml", "log.csv": suspect / "log.csv", "out": suspect / "out"}
    made = [str(places.get(each, tmp_path / each if arguments[k - 1] == "-o" or each == "arm.urdf" else each))
            for k, each in enumerate(arguments)]
    done = CliRunner().invoke(app, made)
    assert isinstance(done.exception, SolverError), done.output
    assert done.exception.exit_code == 3
    assert "its numbers are those of a suspect answer: The likeliest cause" in str(done.exception)
    assert str(done.exception).endswith("or accept it with --force.")
    assert not any(tmp_path.iterdir())


def test_what_is_made_by_force_says_so(suspect: Path, tmp_path: Path) -> None:
    assert ho.load_machine(suspect / "out/patu655_lift.toml").suspect.startswith("The likeliest cause of the misfit")
    done = CliRunner().invoke(app, ["codegen", str(suspect / "out"), "--force", "-o", str(tmp_path / "c")])
    assert done.exit_code == 0, done.output
    assert any("SUSPECT" in path.read_text("utf-8") for path in (tmp_path / "c").glob("*.h"))
    done = CliRunner().invoke(app, ["identify", "patu655_lift", str(suspect / "log.csv"), "--force", "--quiet",
                                    "-o", str(tmp_path / "again")])
    assert done.exit_code == 0, done.output
    assert ho.load_machine(tmp_path / "again/patu655_lift.toml").suspect
    done = CliRunner().invoke(app, ["convert", str(suspect / "out"), str(tmp_path / "kept.toml"), "--force"])
    assert done.exit_code == 0, done.output
    assert ho.load_machine(tmp_path / "kept.toml").suspect
