"""What lies in the working directory changes nothing that hydroopt runs."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import matplotlib
import pytest
from matplotlib.figure import Figure

from hydroopt.machine.machine_file import load_machine
from hydroopt.plots.figures import STYLE, svg
from studies.first_contact import process

ROOT = Path(__file__).parents[1]


def test_imports_and_jobs_change_nothing_in_the_process() -> None:
    modules, changes = process.changed()
    assert modules > 100
    assert not changes


@pytest.mark.parametrize("commands", [process.COMMANDS[:1], pytest.param(process.COMMANDS, marks=pytest.mark.slow)],
                         ids=["one", "all"])
def test_commands_run_and_obey_nothing_that_lies_there(commands: tuple[tuple[str, ...], ...], tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    process.hostile(tmp_path / "there")
    assert not [effect for each in commands for effect in process.effects_on(each, tmp_path / "there", tmp_path)]


def test_a_command_runs_where_one_cannot_go_back(tmp_path: Path) -> None:
    gone = tmp_path / "gone"
    gone.mkdir()
    code = "import os; from hydroopt.__main__ import main; os.rmdir(os.getcwd()); main()"
    done = subprocess.run([sys.executable, "-P", "-c", code, "show", "kr300"], cwd=gone, capture_output=True, text=True,
                          check=False, env=process.ENVIRONMENT)
    assert done.returncode == 0, done.stderr
    assert "KR300" in done.stdout


def test_settings_that_matplotlib_cannot_read_are_named(tmp_path: Path) -> None:
    (tmp_path / "matplotlibrc").write_bytes(b"font.size: 9\xff\n")
    command = [sys.executable, "-m", "hydroopt", "control", "patu655_lift", "--motion", "log.csv", "-o", "out"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, env=process.ENVIRONMENT)
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1].startswith("hydroopt: matplotlibrc: matplotlib cannot read its settings")


def test_figures_look_the_same_whatever_matplotlib_was_told() -> None:
    def drawn() -> str:
        with matplotlib.rc_context(STYLE):
            figure = Figure()
            figure.subplots().plot([0, 1], [0, 1], label="a_b")
        return svg(figure)

    plain = drawn()
    told = {"text.usetex": True, "svg.image_inline": False, "lines.linestyle": ":", "figure.facecolor": "black",
            "axes.prop_cycle": "cycler(color='r')", "axes.xmargin": 0.4}
    with matplotlib.rc_context(told):
        assert drawn() == plain
        assert matplotlib.rcParams["text.usetex"]


def test_a_bundled_name_means_the_bundled_machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copy(ROOT / "models/cat215b.toml", tmp_path / "patu655_lift.toml")
    shutil.copy(ROOT / "models/cat215b.toml", tmp_path / "patu655_lift")
    monkeypatch.chdir(tmp_path)
    assert load_machine("patu655_lift").name == "patu655_lift"
    assert load_machine("patu655_lift.toml").name == "cat215b"
