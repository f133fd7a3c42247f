"""What several commands ask for, and how they tell of progress."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from hydroopt.errors import ProblemError
from hydroopt.estimation.problem import Distance, Loss

MachineName = Annotated[str, typer.Argument(
    metavar="MACHINE", help="A bundled machine's name or a .toml or .urdf file.")]
ParameterSetName = Annotated[str | None, typer.Option("--set", help="Which of the file's sets of inertial parameters.")]
Quiet = Annotated[bool, typer.Option("--quiet", help="No progress and no summary.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]
Directory = Annotated[Path, typer.Option("-o", "--output", help="Directory that receives everything.")]
MapFile = Annotated[Path | None, typer.Option(
    "--map", help="TOML file that says which column is what in foreign logs.")]
Treat = Annotated[list[str] | None, typer.Option(
    help="What to do about a finding, KIND=ACTION, e.g. nan=drop, spike=interpolate, gap=keep; repeatable.")]


@contextmanager
def progress(what: str, quiet: bool) -> Iterator[Callable[[str], None]]:
    """A spinner on a terminal's error stream while something takes its time; what is given says what goes on now."""
    with Console(stderr=True, quiet=quiet).status(what) as status:
        yield status.update


def distance_of(text: str, where: str) -> Distance:
    """The distance between bodies that an option names."""
    if text not in ("gaussian", "log-det"):
        raise ProblemError(f"'{text}' is no distance", where=where, remedy="use gaussian or log-det")
    return text  # type: ignore[return-value]


def loss_of(text: str, where: str) -> Loss:
    """The loss that an option names."""
    if text not in ("squares", "huber", "student_t"):
        raise ProblemError(f"'{text}' is no loss", where=where, remedy="use squares, huber or student_t")
    return text  # type: ignore[return-value]


def refuse_idle(context: typer.Context, options: Collection[str], why: str, remedy: str) -> None:
    """Refuse options that would mean nothing.

    Raises:
        ProblemError: one of them was given.
    """
    for option in context.command.params:
        source = context.get_parameter_source(option.name or "")
        if option.name in options and source is not None and source.name == "COMMANDLINE":
            raise ProblemError(why, where=option.opts[0], remedy=remedy)
