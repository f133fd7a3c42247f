"""What the distribution holds, as sdist and as the wheel that is built from it."""

from __future__ import annotations

import os
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

import hydroopt
from hydroopt.support.packages import DISTRIBUTION, version

ROOT = Path(__file__).parents[1]
STEM = f"{DISTRIBUTION.replace('-', '_')}-{version()}"
SDIST_LIMIT = 30e6
"""Size [B] that the sdist stays below."""

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the sdist and the wheel built from it, without access to the network."""
    folder = tmp_path_factory.mktemp("dist")
    subprocess.run([sys.executable, "-m", "build", "--no-isolation", "--outdir", str(folder), str(ROOT)], check=True,
                   capture_output=True)
    return folder


def test_sdist_holds_what_its_tests_need(built: Path) -> None:
    archive = built / f"{STEM}.tar.gz"
    assert archive.stat().st_size < SDIST_LIMIT
    with tarfile.open(archive) as file:
        names = {name.partition("/")[2] for name in file.getnames()}
    assert {"pyproject.toml", "README.md", "CHANGELOG.md", "LICENSE", "Makefile", "constraints.txt",
            "hydroopt/__init__.py", "models/cat215b.toml", "tests/test_distribution.py", "studies/__main__.py",
            "data/kr300/map.toml", "conda/recipe.yaml", "docs/conf.py", "docs/index.md"} <= names
    made = (".git/", "out/", "docs/generated/")
    assert not {name for name in names if "__pycache__" in name or name.startswith(made)}


def test_wheel_holds_the_package_and_the_machines_alone(built: Path) -> None:
    with zipfile.ZipFile(built / f"{STEM}-py3-none-any.whl") as file:
        names = set(file.namelist())
    assert {name.partition("/")[0] for name in names} == {"hydroopt", f"{STEM}.dist-info"}
    assert {f"hydroopt/models/{name}.toml" for name in hydroopt.bundled()} <= names
    tracked = {path.relative_to(ROOT).as_posix() for path in (ROOT / "hydroopt").rglob("*")
               if path.is_file() and "__pycache__" not in path.parts}
    assert tracked <= names
    assert f"{STEM}.dist-info/licenses/LICENSE" in names


def test_the_index_would_take_both(built: Path) -> None:
    done = subprocess.run([sys.executable, "-m", "twine", "check", "--strict", *map(str, built.iterdir())],
                          capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
    assert done.stdout.count("PASSED") == 2


def test_a_machine_loads_from_the_wheel(built: Path, tmp_path: Path) -> None:
    with zipfile.ZipFile(built / f"{STEM}-py3-none-any.whl") as file:
        file.extractall(tmp_path)
    code = "import hydroopt; print(hydroopt.__file__); print(hydroopt.load_machine('cat215b').sha256)"
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, env=os.environ | {"PYTHONPATH": str(tmp_path)},
                          capture_output=True, text=True, check=True)
    assert done.stdout.split() == [str(tmp_path / "hydroopt/__init__.py"), hydroopt.load_machine("cat215b").sha256]
