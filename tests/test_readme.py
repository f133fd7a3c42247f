"""What the README shows must run as it stands."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import typer

import hydroopt
from hydroopt.cli import app

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


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_c_in_the_readme_holds_with_the_generated_code(tmp_path: Path) -> None:
    (command,) = re.findall(r"^    hydroopt (codegen .*?) -o out/c", README, re.MULTILINE)
    subprocess.run([sys.executable, "-m", "hydroopt", *command.split(), "-o", "c", "--quiet"], cwd=tmp_path, check=True)
    (tmp_path / "main.c").write_text(block("c") + """
int main(void)
{
    const cat215b_motion_t in = {{0.0f, -0.5f, 1.4f}, {0.0f}, {0.0f}};
    cat215b_efforts_t out;
    return (at_start() != CAT215B_OK) || (each_cycle(&in, &out) != CAT215B_OK)
        || !(out.force[CAT215B_ACTUATOR_BOOM_CYLINDER] > 1e4f); /* the boom rests on its cylinder */
}
""")
    sources = [path for path in (tmp_path / "c").glob("*.c") if "selftest" not in path.name]
    subprocess.run(["cc", "-std=c99", "-Ic", "-o", "main", "main.c", *sources, "-lm"], cwd=tmp_path, check=True)
    assert subprocess.run(["./main"], cwd=tmp_path, check=False).returncode == 0


COMMANDS = re.findall(r"^    hydroopt (.*?)(?:\s+#.*)?$", README, re.MULTILINE)
PARSER = typer.main.get_command(app)


@pytest.mark.parametrize("command", COMMANDS)
def test_commands_in_the_readme_parse(command: str) -> None:
    name, *arguments = command.split()
    with PARSER.make_context("hydroopt", [name]) as context:
        assert isinstance(PARSER, typer.core.TyperGroup)
        subcommand = PARSER.get_command(context, name)
        assert subcommand is not None
        subcommand.make_context(name, arguments, parent=context)


def test_study_table_names_every_study() -> None:
    told = set(re.findall(r"^\| `(\w+)` \|", README, re.MULTILINE))
    there = {path.parent.name for path in (ROOT / "studies").glob("*/run.py")}
    assert there <= told
