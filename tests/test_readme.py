"""What the README shows must run as it stands."""

import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import typer
from typer.core import TyperGroup

import hydroopt
from hydroopt.cli import app
from hydroopt.cli.machine_facts import machine_facts

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text("utf-8")


def block(language: str, place: int = 0) -> str:
    """The first one of a language, or one after it."""
    found = re.findall(rf"```{language}\n(.*?)```", README, re.DOTALL)
    assert len(found) > place
    return found[place]


def test_python_in_the_readme_runs_and_is_short(tmp_path: Path) -> None:
    code = block("python")
    assert len([line for line in code.splitlines() if line.strip()]) <= 15
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], cwd=tmp_path, capture_output=True, text=True,
                          check=False)
    assert done.returncode == 0, done.stderr
    assert "cat215b by sdp: ok" in done.stdout
    assert "residual" in done.stdout


def test_gravity_loads_the_boom_of_the_machine_file_in_the_readme() -> None:
    """Level, by moments about the joint: 125 kg at 1.1 m on a lever arm of 0.304 m."""
    machine = hydroopt.read_machine(block("toml"))
    assert machine.joints == ("lift",)
    model = hydroopt.Model(machine)
    names = model.parameters.names
    held = model.inverse_dynamics(0, 0, 0, model.parameters.nominal)
    assert float(held) == pytest.approx(125 * 9.81 * 1.1 / 0.304, rel=2e-3)
    assert "4.4 kN" in README
    facts = {row["name"]: row["identifiability"] for row in machine_facts(machine)["parameters"]}
    assert facts["lift.mc_x"] == "full"
    assert [n for n in names if n.startswith("lift_cylinder")] == ["lift_cylinder.f_coulomb", "lift_cylinder.f_viscous"]


def test_the_linkage_in_the_readme_is_that_of_the_bundled_machine(tmp_path: Path) -> None:
    bundled = hydroopt.load_machine("excavator_bucket")
    text = (ROOT / "models" / "excavator_bucket.toml").read_text("utf-8")
    without, count = re.subn(r"\[\[linkages\]\].*?(?=\[\[motors\]\])", "", text, flags=re.DOTALL)
    assert count == 1
    file = tmp_path / "excavator.toml"
    file.write_text(f"{without}\n{block('toml', 1)}", "utf-8")
    machine = hydroopt.load_machine(str(file))
    at = [0.0, 0.5, -1.0, -0.3]
    lengths = [hydroopt.Model(one).cylinder_kinematics(at, 0, 0)[0] for one in (machine, bundled)]
    assert [float(length) for length in lengths[0].nz] == pytest.approx([*map(float, lengths[1].nz)], abs=2e-3)


@pytest.mark.slow
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


def commands() -> list[str]:
    """What a reader types after the installation, in the order of the README."""
    lines = re.findall(r"^    ((?:hydroopt|make -C) .*?|# .*)$", README, re.MULTILINE)
    return [line if line.startswith("#") else re.split(r"\s+# ", line)[0] for line in lines]


def test_commands_in_the_readme_parse() -> None:
    for line in commands():
        program, *words = shlex.split(line, comments=True) or [""]
        if program == "hydroopt":
            context = typer.main.get_command(app).make_context(program, words)
            while isinstance(context.command, TyperGroup):
                name, *words = words
                command = context.command.get_command(context, name)
                assert command is not None, line
                context = command.make_context(name, words, parent=context)


def test_commands_that_need_a_checkout_say_so() -> None:
    lines = commands()
    needy = [k for k, line in enumerate(lines) if "data/" in line]
    assert needy
    assert all("in a checkout" in lines[k - 1] for k in needy)


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_commands_in_the_readme_run_in_an_empty_directory(tmp_path: Path) -> None:
    program = tmp_path / "bin" / "hydroopt"
    program.parent.mkdir()
    program.write_text(f'#!/bin/sh\nexec {shlex.quote(sys.executable)} -m hydroopt "$@"\n')
    program.chmod(0o755)
    environment = os.environ | {"PATH": f"{program.parent}{os.pathsep}{os.environ['PATH']}", "PYTHONPATH": str(ROOT)}
    place = tmp_path / "empty"
    place.mkdir()
    (place / "crane.toml").write_text(block("toml"))
    data = place / "data"
    for line in commands():
        if line.startswith("#"):
            data.symlink_to(ROOT / "data")
            continue
        done = subprocess.run(line, shell=True, cwd=place, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, f"{line}\n{done.stdout}\n{done.stderr}"
        data.unlink(missing_ok=True)


def test_readme_names_the_distribution() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    assert f"`{project['name']}`" in README
    assert "pip install hydroopt\n" not in README
    assert f"dist/{project['name'].replace('-', '_')}-*.whl" in README


def test_study_table_names_every_study() -> None:
    told = set(re.findall(r"^\| `(\w+)` \|", README, re.MULTILINE))
    there = {path.parent.name for path in (ROOT / "studies").glob("*/run.py")}
    assert there <= told
