"""The place of an error is a thing, not a command: what one command computes is computed by others, too."""

from __future__ import annotations

import ast
from pathlib import Path

import hydroopt
from hydroopt.cli import COMMANDS

PACKAGE = Path(hydroopt.__file__).parent


def test_no_error_of_the_library_names_a_command_as_its_place() -> None:
    named = [f"{file.relative_to(PACKAGE)}:{node.value.lineno}"
             for file in PACKAGE.rglob("*.py") if file.parent.name != "cli"
             for node in ast.walk(ast.parse(file.read_text("utf-8")))
             if isinstance(node, ast.keyword) and node.arg == "where"
             and isinstance(node.value, ast.Constant) and node.value.value in COMMANDS]
    assert not named
