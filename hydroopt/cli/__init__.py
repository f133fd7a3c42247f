"""The command `hydroopt`: one module a command, imported when that command runs or shows its own help."""

from __future__ import annotations

import ast
import os
import sys
from collections.abc import Collection
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any, get_args, get_type_hints

import typer
from typer.core import TyperCommand, TyperGroup

from hydroopt.cli.command import Command, off_unless_given
from hydroopt.cli.terminal import WORDS, echo
from hydroopt.errors import HydrooptError, ProblemError, StoppedError
from hydroopt.support import interrupt, memory

JOBS = {"Describe a machine": ("new", "models", "show", "view", "convert"),
        "Measure": ("what-next", "excite", "plan-poses", "measure-up", "design-calibrator", "plan-valve-test",
                    "simulate", "map", "check"),
        "Identify and calibrate": ("identify", "identify-valves", "identify-payload", "compare", "calibrate",
                                   "calibrate-sensors"),
        "Weigh": ("weigh",),
        "Control": ("control", "codegen"),
        "Repeat": ("study",)}
"""Commands by job. A command is the function of its name in the module of its name; the docstring of that function is
its help, whose last paragraph is an example."""
COMMANDS = tuple(name for names in JOBS.values() for name in names)


class Deferred(TyperCommand):
    """A command whose module has not been imported yet: the list of commands needs its name and short help alone."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.key = name.replace("-", "_")

    @cached_property
    def paragraphs(self) -> list[str]:
        """The paragraphs of the command's help, from its source."""
        source = ast.parse(Path(__file__).with_name(f"{self.key}.py").read_text("utf-8"))
        function = next(node for node in source.body if isinstance(node, ast.FunctionDef) and node.name == self.key)
        return (ast.get_docstring(function) or "").split("\n\n")

    @property
    def example(self) -> str:
        """A command line."""
        return self.paragraphs[-1].removeprefix("Example: ")

    def get_short_help_str(self, limit: int = 45) -> str:
        """The first paragraph of the command's help."""
        self.short_help = self.paragraphs[0]
        return super().get_short_help_str(limit)

    def make_context(self, info_name: str | None, args: list[str], parent: Any = None, **extra: Any) -> Any:
        """The context of the command itself."""
        module = import_module(f"{__name__}.{self.key}")
        WORDS.set((str(self.name), *args))
        if hasattr(module, "app"):
            return typer.main.get_command(module.app).make_context(info_name, args, parent, **extra)
        function, group = getattr(module, self.key), typer.Typer(add_completion=False, rich_markup_mode=None)
        group.command(self.name, cls=Command)(function)
        command = typer.main.get_command(group)
        files = {name for name, kind in get_type_hints(function).items() if list[Path] in (kind, *get_args(kind))}
        takes_files = {text for option in command.params if option.name in files for text in option.opts}
        return command.make_context(info_name, _each_file_named(takes_files, args), parent, **extra)


def _each_file_named(takes_files: Collection[str], arguments: list[str]) -> list[str]:
    """Arguments with the option of files before each of its files: ``--validate a b`` as ``--validate a --validate b``.

    A shell's pattern stands for several files: those after the first must not count as other arguments.
    """
    named: list[str] = []
    option = ""
    for argument in arguments:
        if argument.startswith("-"):
            option = argument if argument in takes_files else ""
        elif option and named[-1] != option:
            named.append(option)
        named.append(argument)
    return named


WHOLE = 1000
"""Characters of a help that is not cut."""


class Group(TyperGroup):
    """Commands of one name in front."""

    def get_help_option(self, ctx: Any) -> Any:
        """The option --help."""
        return off_unless_given(super().get_help_option(ctx))

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the commands with all of their first sentence."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, command.get_short_help_str(WHOLE)) for name, command in self.commands.items()])


class Commands(Group):
    """All commands, none of which is imported."""

    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes | {"commands": {name: Deferred(name) for name in COMMANDS}})

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """The arguments. Options for a shell's completion are among those without a default."""
        for option in self.params:
            off_unless_given(option)
        return super().parse_args(ctx, args)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the commands by job, each job with an example."""
        width = formatter.width - 6 - max(len(name) for name in COMMANDS)  # `map` names a submodule here
        for job, names in JOBS.items():
            with formatter.section(job):
                formatter.write_dl([(name, self.commands[name].get_short_help_str(width)) for name in names],
                                   col_max=max(len(name) for name in COMMANDS))
                command = self.commands[names[-1] if job == "Measure" else names[0]]
                assert isinstance(command, Deferred)
                formatter.write_text(f"Example: {command.example}")


app = typer.Typer(cls=Commands, rich_markup_mode=None, pretty_exceptions_enable=False)


def _print_version(wanted: bool) -> None:
    if wanted:
        from hydroopt.support.packages import version

        echo(f"hydroopt {version()}")
        raise typer.Exit


@app.callback()
def hydroopt(
    version: Annotated[bool, typer.Option("--version", callback=_print_version, is_eager=True, help=(
        "Print the version."))] = False,
) -> None:
    """Calibrate hydraulically actuated manipulators: a machine file and logs in, a model with error bars out."""


_USAGE_ERROR: type[Exception] = typer.BadParameter.__mro__[1]
"""What typer raises on wrong arguments: the UsageError of click, or of the copy that typer contains."""


def main() -> None:
    """Run the command. Bad input ends in one sentence and exit code 2, a failed solver in 3."""
    code: Any = 130
    arguments = sys.argv[1:]
    os.environ["PYTHONSAFEPATH"] = "1"  # a command's own processes import nothing from the working directory
    try:
        code = app(arguments or ["--help"], prog_name="hydroopt", standalone_mode=False) or (0 if arguments else 2)
    except BaseException as error:
        if isinstance(error, StoppedError) or (isinstance(error, HydrooptError) and not interrupt.pressed()):
            echo(f"hydroopt: {error}", err=True)
            sys.exit(error.exit_code)
        if interrupt.pressed() or isinstance(error, KeyboardInterrupt | typer.Abort):
            pass  # whatever a library has made of Ctrl-C
        elif isinstance(error, _USAGE_ERROR):
            code = 2
            _explain(error)
        elif memory.exceeded(error):
            code = 2
            most = memory.limit()
            there = f"the {most / 1e9:.1f} GB of memory that it may use" if most < float("inf") else "there is memory"
            echo(f"hydroopt: memory: this takes more than {there}; raise the limit (ulimit -v), or give shorter logs.",
                 err=True)
        else:
            raise
    if code == 130:  # typer's exit code of an interrupt
        echo("hydroopt: interrupted; no result was written", err=True)
    sys.exit(code)


def _explain(error: Any) -> None:
    """Print what is wrong with the arguments as one sentence."""
    context = error.ctx
    command = context.command_path if context else "hydroopt"
    what = " ".join(error.format_message().split()).rstrip(".?").replace(". Did you mean", ", did you mean")
    place = command.partition(" ")[2]
    error = ProblemError(f"{what[:1].lower()}{what[1:]}", where=place, remedy=f"see '{command} --help'")
    echo(f"hydroopt: {str(error).removeprefix(': ')}", err=True)
