"""What lies in the working directory changes nothing that hydroopt runs."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import matplotlib
import pytest
from matplotlib.figure import Figure

from hydroopt.machine.machine_file import load_machine
from hydroopt.plots.figures import STYLE, svg

ROOT = Path(__file__).parents[1]
MODULES = ("ast", "casadi", "control", "cvxpy", "lazy_loader", "matplotlib", "numpy", "pickle", "selectors", "signal",
           "socket", "struct", "tempfile", "threading", "typer")
"""Names under which foreign modules lie there: of libraries, and of what Python itself imports to start a process."""


@pytest.fixture
def hostile(tmp_path: Path) -> Path:
    """A folder whose files each leave `marker`, should anything run or obey them."""
    for name in MODULES:
        (tmp_path / f"{name}.py").write_text(f"open({str(tmp_path / 'marker')!r}, 'a').write('{name} ')\n")
    (tmp_path / "matplotlibrc").write_text("text.usetex: True\nbackend: module://casadi\nno such setting\n")
    (tmp_path / "ipopt.opt").write_text(f"output_file {tmp_path / 'marker'}\n")
    for name in ("pyproject.toml", "hydroopt.toml", "patu655_lift", "patu655_lift.toml", "dask.yaml"):
        (tmp_path / name).write_text("nothing that can be read [")
    return tmp_path


def run(folder: Path, *arguments: str) -> str:
    """What a command prints in a folder; nothing was told of, or left there."""
    before = set(folder.iterdir())
    done = subprocess.run([sys.executable, *arguments], cwd=folder, capture_output=True, text=True, check=False,
                          env={**os.environ, "PYTHONPATH": str(ROOT)})
    assert done.returncode == 0, done.stderr
    assert not done.stderr
    assert set(folder.iterdir()) == before
    return done.stdout


@pytest.mark.slow
def test_a_command_runs_nothing_that_lies_there(hostile: Path) -> None:
    assert "PATU 655" in run(hostile, "-m", "hydroopt", "show", "patu655_lift")


@pytest.mark.slow
def test_a_study_and_its_processes_run_nothing_that_lies_there(hostile: Path, tmp_path_factory: pytest.TempPathFactory
                                                               ) -> None:
    assert "1 cells, 0 failed" in run(
        hostile, "-m", "hydroopt", "study", "montecarlo", "patu655_lift", "--cells", "1", "--processes", "1",
        "--method", "nlp", "--duration", "6", "-o", str(tmp_path_factory.mktemp("out")))


@pytest.mark.parametrize("module", [
    "hydroopt.plots.figures", pytest.param("hydroopt.control.python_control", marks=pytest.mark.slow)])
@pytest.mark.slow
def test_matplotlib_reads_no_settings_there(module: str, hostile: Path) -> None:
    code = f"import os, {module}, matplotlib as m; print(m.rcParams['text.usetex'], os.getcwd())"
    assert run(hostile, "-P", "-c", code) == f"False {hostile}\n"


def test_where_one_cannot_go_back_to_matplotlib_is_imported_from(tmp_path: Path) -> None:
    gone = tmp_path / "gone"
    gone.mkdir()
    code = "import os, sys; os.rmdir(os.getcwd()); import hydroopt.plots.figures; print('matplotlib' in sys.modules)"
    done = subprocess.run([sys.executable, "-P", "-c", code], cwd=gone, capture_output=True, text=True, check=True,
                          env={**os.environ, "PYTHONPATH": str(ROOT)})
    assert done.stdout == "True\n"


def test_figures_look_the_same_whatever_matplotlib_was_told() -> None:
    def drawn() -> str:
        with matplotlib.rc_context(STYLE):
            figure = Figure()
            figure.subplots().plot([0, 1], [0, 1], label="a_b")
        return svg(figure, "line")

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
