"""Options over all commands: one name for one thing, and every option that is spoken of exists."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer

from hydroopt.cli import app

ROOT = Path(__file__).parents[2]
OTHERS = {"--version", "--help", "--nthreads", "--nworkers", "--build", "--install", "--no-show-raw-insn"}
"""Options of other programs that texts speak of."""


def leaves(command: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[str, Any]]:
    """The commands below one, with their names."""
    if hasattr(command, "commands"):
        for name, below in command.commands.items():
            yield from leaves(below, (*path, name))
    else:
        context = command.make_context(path[-1], [], resilient_parsing=True)
        if hasattr(context.command, "commands"):
            yield from leaves(context.command, path)
        else:
            yield " ".join(path), context.command


@pytest.fixture(scope="module")
def options() -> dict[str, dict[str, Any]]:
    """By name of an option the commands that take it, and what each says of it."""
    found: dict[str, dict[str, Any]] = {}
    for name, command in leaves(typer.main.get_command(app)):
        for one in command.params:
            if one.param_type_name == "option":
                found.setdefault(max(one.opts, key=len), {})[name] = one
    return found


def meaning(option: Any) -> tuple[str, bool, bool, tuple[str, ...]]:
    """The first clause of the help, whether it is a switch or repeatable, and its other names."""
    clause = re.split("[;:]", option.help)[0].rstrip(".")
    return clause, option.is_flag, option.multiple, (*option.opts, *option.secondary_opts)


def test_an_option_means_the_same_in_all_commands(options: dict[str, dict[str, Any]]) -> None:
    assert (len(options["--motion"]), len(options["--output"])) >= (4, 17), "the commands were not found"
    for name, commands in options.items():
        meanings = {meaning(one) for one in commands.values()}
        assert len(meanings) == 1, (name, meanings)


def test_different_options_mean_different_things(options: dict[str, dict[str, Any]]) -> None:
    clauses = [meaning(next(iter(commands.values())))[0] for commands in options.values()]
    assert len(set(clauses)) == len(clauses), sorted(clauses)


def test_options_that_texts_speak_of_exist(options: dict[str, dict[str, Any]]) -> None:
    known = {text for commands in options.values() for one in commands.values()
             for text in (*one.opts, *one.secondary_opts)} | OTHERS
    pages = [page for page in (ROOT / "docs").rglob("*.md") if "generated" not in page.parts]
    texts = [ROOT / "README.md", *pages, *(ROOT / "hydroopt").rglob("*.py")]
    spoken = {(word, file.name) for file in texts for word in re.findall(
        r"(?<![\w-])--[a-z][a-z0-9-]+", file.read_text("utf-8"))}
    assert {"--motion", "--fix"} <= {word for word, _ in spoken}
    assert not {pair for pair in spoken if pair[0] not in known}
