"""No command writes into a folder that holds what it reads, or outside of the folder that it was given."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner

import hydroopt as ho
from hydroopt.cli import COMMANDS, app
from hydroopt.machine.machine_file import dump_machine

COMMAND_LINES = {
    "show": "show MACHINE",
    "view": "view ANSWER",
    "what-next": "what-next MACHINE ANSWER",
    "excite": "excite MACHINE --log LOG",
    "plan-poses": "plan-poses MACHINE -n 3",
    "measure-up": "measure-up MACHINE --tip-std 10mm",
    "design-calibrator": "design-calibrator MACHINE -n 3",
    "plan-valve-test": "plan-valve-test MACHINE",
    "simulate": "simulate MACHINE --motion LOG",
    "check": "check MACHINE LOG --map MAP",
    "identify": "identify MACHINE LOG",
    "identify-valves": "identify-valves MACHINE LOG",
    "identify-payload": "identify-payload MACHINE --unloaded ANSWER --loaded LOG",
    "compare": "compare MACHINE ANSWER LOG",
    "calibrate": "calibrate MACHINE POSES",
    "calibrate-sensors": "calibrate-sensors MACHINE LOG",
    "weigh": "weigh MACHINE LOG --calibration ANSWER --known 1200kg:KNOWN --full-scale 2500kg",
    "control": "control ANSWER --motion LOG",
    "codegen": "codegen ANSWER",
    "study": "study montecarlo MACHINE --motion LOG"}
"""Each command with an output folder, and what it reads."""
READ = {"MACHINE": "crane.toml", "LOG": "log.csv", "MAP": "map.toml", "ANSWER": "answer", "POSES": "poses.csv",
        "KNOWN": "known.csv"}


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder for each kind of input."""
    place = tmp_path_factory.mktemp("inputs")
    machine = ho.load_machine("patu655_lift")
    for name in READ:
        (place / name).mkdir()
    log = ho.simulate(machine, ho.random_trajectory(machine, duration=8, rate=20, seed=1), seed=1)
    log.write(place / "LOG/log.csv")
    (place / "MACHINE/crane.toml").write_text(dump_machine(machine))
    ho.solve(ho.identification_problem(machine, log), "wls").save(place / "ANSWER/answer")
    for name in ("MAP", "POSES", "KNOWN"):
        (place / name / READ[name]).write_text("theirs")
    return place


def content(folder: Path) -> dict[str, bytes]:
    return {str(file.relative_to(folder)): file.read_bytes() for file in folder.rglob("*") if file.is_file()}


def test_every_command_with_an_output_folder_is_tried() -> None:
    assert set(COMMANDS) - set(COMMAND_LINES) == {"new", "models", "map", "convert"}


@pytest.mark.parametrize(("command", "kind"), [
    (name, kind) for name, line in COMMAND_LINES.items() for kind in READ if kind in line])
def test_a_folder_that_holds_what_a_command_reads_is_refused(command: str, kind: str, inputs: Path, tmp_path: Path,
                                                             ) -> None:
    place = tmp_path / "inputs"
    shutil.copytree(inputs, place)
    line = COMMAND_LINES[command]
    for name, file in READ.items():
        line = line.replace(name, str(place / name / file))
    before = content(place)
    result = CliRunner().invoke(app, [*line.split(), "-o", str(place / kind)])
    assert "this directory holds" in str(result.exception), (line, result.output, result.exception)
    assert content(place) == before


def test_a_folder_beside_the_inputs_may_have_the_name_of_a_bundled_machine(tmp_path: Path,
                                                                          monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for _ in range(2):
        result = CliRunner().invoke(app, ["show", "kr300", "-o", "kr300"])
        assert result.exit_code == 0, result.exception
    assert content(tmp_path).keys() == {"kr300/machine.html"}
