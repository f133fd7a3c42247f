"""`import hydroopt` and its help load nothing that computes."""

import re
import subprocess
import sys

import pytest

import hydroopt
from hydroopt import cli
from hydroopt.control.comparison import FEEDFORWARD, LQG, PI
from hydroopt.control.tuning import SENSITIVITY
from hydroopt.estimation.dynamic import identify as dynamic
from hydroopt.estimation.dynamic.friction_choice import TERMS
from hydroopt.estimation.kinematic import solution as kinematic
from hydroopt.excitation.criteria import CRITERIA

HEAVY = ("casadi", "cvxpy", "control", "dask", "matplotlib", "numpy", "pyarrow", "scipy")


def loaded(*arguments: str) -> set[str]:
    """Which of these libraries a fresh interpreter has imported in the end."""
    done = subprocess.run([sys.executable, "-X", "importtime", *arguments], capture_output=True, text=True, check=True)
    modules = {line.rpartition("|")[2].strip().split(".")[0] for line in done.stderr.splitlines()}
    assert "hydroopt" in modules
    return modules & set(HEAVY)


def test_importing_hydroopt_imports_no_library() -> None:
    assert loaded("-c", "import hydroopt") == set()


def test_help_imports_no_library() -> None:
    assert loaded("-m", "hydroopt", "--help") == set()


def test_help_of_a_command_imports_no_library() -> None:
    """One process shows the help of each command, and says what has been imported by then."""
    commands = [*cli.COMMANDS, "study montecarlo"]
    code = ("import sys; from hydroopt.cli import app\nfor command in sys.argv[1:]:\n"
            "    app([*command.split(), '--help'], prog_name='hydroopt', standalone_mode=False)\n"
            f"    print(command, *sorted({set(HEAVY)} & sys.modules.keys()), file=sys.stderr)")
    done = subprocess.run([sys.executable, "-c", code, *commands], capture_output=True, text=True, check=True)
    assert all(f"Usage: hydroopt {command} " in done.stdout for command in commands)
    assert done.stderr.splitlines() == commands


@pytest.mark.parametrize(("command", "option", "choices"), [
    ("identify", "method", dynamic.METHODS), ("identify", "friction", TERMS),
    ("calibrate", "method", kinematic.METHODS),
    ("excite", "criterion", CRITERIA), ("plan-poses", "criterion", CRITERIA),
    ("control", "controller", (PI, FEEDFORWARD, LQG)), ("control", "sensitivity", (str(SENSITIVITY),))])
def test_help_names_every_choice(command: str, option: str, choices: tuple[str, ...]) -> None:
    """The help stands where importing the modules that define the choices would take time."""
    deferred = cli.Deferred(command)
    (found,) = [each for each in deferred.make_context(command, [], resilient_parsing=True).command.params
                if each.name == option]
    assert all(re.search(rf"\b{re.escape(choice)}\b", found.help) for choice in choices)
    assert option != "sensitivity" or found.default == SENSITIVITY


@pytest.mark.parametrize("name", hydroopt.__all__)
def test_every_public_name_is_there(name: str) -> None:
    assert getattr(hydroopt, name).__module__.startswith("hydroopt.")
