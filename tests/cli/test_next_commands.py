"""The commands that verdicts print as next steps can be copied: they run as they stand, in a folder with a space."""

from __future__ import annotations

import re
import shlex
import shutil
from collections.abc import Callable
from pathlib import Path

import pandas as pd
import pytest
from typer.testing import CliRunner

import hydroopt
from hydroopt.cli import app
from hydroopt.results import json_file

HOW_TO = Path(__file__).parents[2] / "docs/how-to"
RIG = "'my rig.toml'"
NOT_TO_BE_WIDE = {"excite": ("--search-seconds", "1"), "control": ("--rate", "50")}
"""Options that make a command of a test short; the last one of an option counts."""


def run(command: str) -> None:
    program, name, *words = shlex.split(command)
    assert program == "hydroopt"
    done = CliRunner().invoke(app, [name, *words, *NOT_TO_BE_WIDE.get(name, ())])
    assert done.exit_code == 0, f"{command}: {done.output[-600:]}"


def steps(folder: str) -> list[str]:
    """The commands of all next steps of an answer."""
    verdict = json_file.read(Path(folder))["verdict"]
    return [step["command"] for step in verdict["next_steps"] if step["command"]]


def logged(seed: int = 2, machine: str = "patu655_lift") -> None:
    run(f"hydroopt simulate {machine} --duration 15 --seed {seed} -o rec")
    shutil.copy("rec/log.csv", "log.csv")


def driven() -> None:
    run("hydroopt simulate patu655_lift --valve-test --seed 2 -o 'my run'")


def posed() -> None:
    """The poses of a sheet, filled in, in the place of its table and beside."""
    for sheet in ("my out", "poses", "motion"):
        if (Path(sheet) / "postures.csv").exists():
            run(f"hydroopt simulate {RIG} --postures '{sheet}/postures.csv' --seed 3 -o filled")
            if (Path(sheet) / "poses.csv").exists():
                shutil.copy("filled/poses.csv", f"{sheet}/poses.csv")
            shutil.copy("filled/poses.csv", "poses.csv")


def misread() -> None:
    """Poses of a plan, in one of which the station's reading is 10 cm off."""
    run(f"hydroopt plan-poses {RIG} -n 25 -o poses")
    run(f"hydroopt simulate {RIG} --postures poses/postures.csv --seed 3 -o filled")
    table = pd.read_csv("filled/poses.csv")
    table.loc[6, "station.tip.z [m]"] += 0.1
    table.to_csv("poses.csv", index=False)


def nothing() -> None:
    """Nothing has to be measured."""


CASES: dict[str, tuple[Callable[[], None], str, Callable[[], None]]] = {
    "check": (logged, "hydroopt check patu655_lift log.csv -o 'my out'", nothing),
    "identify": (logged, "hydroopt identify patu655_lift log.csv -o 'my out'", nothing),
    "identify, held out": (logged, "hydroopt identify patu655_lift log.csv --holdout 0.3 -o 'my out'", nothing),
    "excite": (nothing, "hydroopt excite patu655_lift -o 'my out'", logged),
    "measure-up": (nothing, f"hydroopt measure-up {RIG} --tip-std '10 mm' -o 'my out'", posed),
    "what-next, poses": (nothing, f"hydroopt what-next {RIG} --tip-std '10 mm' --budget 30 -o 'my out'", posed),
    "what-next, forces": (nothing, "hydroopt what-next patu655_lift --force-std '1 %' -o 'my out'", logged),
    "plan-poses": (nothing, f"hydroopt plan-poses {RIG} -n 12 -o 'my out'", posed),
    "calibrate": (misread, f"hydroopt calibrate {RIG} poses.csv -o 'my out'", nothing),
    "identify-valves": (
        driven, "hydroopt identify-valves patu655_lift 'my run/log.csv' --holdout 0.3 -o 'my out'",
        nothing),
}
"""By job: what is there, the command whose next steps are run, and what is measured before that."""


@pytest.mark.slow
@pytest.mark.parametrize("job", CASES)
def test_next_commands_run_as_they_stand(job: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    work = tmp_path / "a site's folder"
    work.mkdir()
    monkeypatch.chdir(work)
    shutil.copy(HOW_TO / "measure_up.toml", "my rig.toml")
    before, command, measured = CASES[job]
    before()
    run(command)
    found = steps("my out")
    assert found
    for each in found:
        for part in each.split(" && "):
            measured()
            run(part)


def test_no_next_step_quotes_a_command_that_cannot_be_copied() -> None:
    root = Path(hydroopt.__file__).parent
    quoted = {str(file.relative_to(root)): found for file in root.rglob("*.py")
              if (found := re.findall(r"NextStep\((?:[^()]|\([^()]*\))*'hydroopt[^()]*\)", file.read_text("utf-8")))}
    assert not quoted
