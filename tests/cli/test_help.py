"""Help: commands by job, each with an example that its own options accept; version and completion."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from hydroopt.cli import COMMANDS, JOBS, app
from hydroopt.machine.machine_file import bundled
from hydroopt.support.packages import version

DEFERRED: Any = typer.main.get_command(app)


def completed(words: str) -> list[str]:
    """What bash would offer after these words."""
    done = subprocess.run([sys.executable, "-m", "hydroopt"], capture_output=True, text=True, check=True, env={
        **os.environ, "_HYDROOPT_COMPLETE": "complete_bash", "COMP_WORDS": f"hydroopt {words}",
        "COMP_CWORD": str(len(words.split()))})
    return done.stdout.split()


def test_help_lists_every_command_once_below_its_job() -> None:
    text = CliRunner().invoke(app, ["--help"]).stdout
    places = [text.index(f"\n{job}:") for job in JOBS]
    assert places == sorted(places)
    for name in COMMANDS:
        assert sum(line.split()[:1] == [name] for line in text.splitlines()) == 1
    assert text.count("Example: hydroopt ") == len(JOBS)


@pytest.mark.parametrize("name", COMMANDS)
def test_the_example_of_a_command_is_one_of_its_command_lines(name: str) -> None:
    program, command, *arguments = shlex.split(DEFERRED.commands[name].example)
    assert (program, command) == ("hydroopt", name)
    context = DEFERRED.commands[name].make_context(name, arguments)
    given = dict(context.params) if not hasattr(context.command, "commands") else {"machine": "cat215b"}
    machine = str(given.get("machine", "cat215b"))
    assert machine in bundled() or machine.endswith((".toml", ".urdf"))


def test_help_keeps_units_in_brackets() -> None:
    text = CliRunner().invoke(app, ["simulate", "--help"]).stdout
    assert "[s]" in text
    assert "[Hz]" in text


def test_version() -> None:
    done = CliRunner().invoke(app, ["--version"])
    assert (done.exit_code, done.stdout) == (0, f"hydroopt {version()}\n")


def test_a_shell_completes_commands_machines_and_options() -> None:
    assert completed("identify-") == ["identify-valves", "identify-payload"]
    assert completed("show pat") == ["patu655", "patu655_lift"]
    assert "--friction" in completed("identify --fri")
