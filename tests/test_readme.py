"""What the README shows must run as it stands."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

import hydroopt

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text("utf-8")


def block(language: str) -> str:
    found = re.findall(rf"```{language}\n(.*?)```", README, re.DOTALL)
    assert len(found) == 1
    return found[0]


def test_python_in_the_readme_runs_and_is_short(tmp_path: Path) -> None:
    code = block("python")
    assert len([line for line in code.splitlines() if line.strip()]) <= 15
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], cwd=tmp_path, capture_output=True, text=True,
                          check=False)
    assert done.returncode == 0, done.stderr
    assert "cat215b by sdp: ok" in done.stdout
    assert "residual" in done.stdout


def test_machine_file_in_the_readme_is_valid() -> None:
    machine = hydroopt.read_machine(block("toml"))
    assert machine.joints == ("lift",)
    names = hydroopt.Model(machine).parameters.names
    assert [n for n in names if n.startswith("lift_cylinder")] == ["lift_cylinder.f_coulomb", "lift_cylinder.f_viscous"]


COMMANDS = re.findall(r"^    (hydroopt (?:show|simulate|identify|calibrate|excite) .*?)(?:\s+#.*)?$", README,
                      re.MULTILINE)


@pytest.mark.parametrize("command", COMMANDS)
def test_commands_in_the_readme_parse(command: str) -> None:
    done = subprocess.run([sys.executable, "-m", *command.split()[:2], "--help"], capture_output=True, text=True,
                          check=False)
    assert done.returncode == 0
    for option in re.findall(r"--[a-z-]+", command):
        assert option in done.stdout


def test_study_table_names_every_study() -> None:
    told = set(re.findall(r"^\| `(\w+)` \|", README, re.MULTILINE))
    there = {path.parent.name for path in (ROOT / "studies").glob("*/run.py")}
    assert there <= told
