"""`import hydroopt` and its help load nothing that computes."""

import subprocess
import sys

import pytest

import hydroopt

HEAVY = ("casadi", "cvxpy", "control", "dask", "matplotlib", "numpy", "pyarrow", "pydantic", "scipy")


def loaded(*arguments: str) -> set[str]:
    """Which of these libraries a fresh interpreter has imported in the end."""
    done = subprocess.run([sys.executable, "-X", "importtime", *arguments], capture_output=True, text=True, check=True)
    modules = {line.rpartition("|")[2].strip().split(".")[0] for line in done.stderr.splitlines()}
    assert "hydroopt" in modules
    return modules & set(HEAVY)


def test_importing_hydroopt_imports_no_library() -> None:
    assert loaded("-c", "import hydroopt") == set()


@pytest.mark.parametrize("name", hydroopt.__all__)
def test_every_public_name_is_there(name: str) -> None:
    assert getattr(hydroopt, name).__module__.startswith("hydroopt.")
