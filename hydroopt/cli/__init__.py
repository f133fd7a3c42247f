"""The command `hydroopt`, and how its subcommands end."""

from __future__ import annotations

import sys
from typing import Any

import typer

from hydroopt.cli.calibrate import calibrate
from hydroopt.cli.codegen import codegen
from hydroopt.cli.compare import compare
from hydroopt.cli.control import control
from hydroopt.cli.excite import excite
from hydroopt.cli.identify import identify
from hydroopt.cli.identify_valves import identify_valves
from hydroopt.cli.plan_poses import plan_poses
from hydroopt.cli.show import show
from hydroopt.cli.simulate import simulate
from hydroopt.cli.study import study
from hydroopt.errors import HydrooptError

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, help=(
    "Calibrate hydraulically actuated manipulators: a machine file and logs in, a model with error bars out."))
for command in (show, simulate, identify, identify_valves, compare, calibrate, plan_poses, excite, control, study,
                codegen):
    app.command()(command)

_USAGE_ERROR: type[Exception] = typer.BadParameter.__mro__[1]
"""What typer raises when arguments do not fit: click's UsageError, or the one typer brings along."""


def main() -> None:
    """Run the command; a user's mistake ends in one sentence and exit code 2, a failed solver in 3."""
    code: Any = 130
    arguments = sys.argv[1:]
    try:
        code = app(arguments or ["--help"], standalone_mode=False) or (0 if arguments else 2)
    except HydrooptError as error:
        typer.echo(f"hydroopt: {_visible(str(error))}", err=True)
        sys.exit(error.exit_code)
    except _USAGE_ERROR as error:
        code = 2
        _explain(error)
    except (KeyboardInterrupt, typer.Abort):
        pass
    if code == 130:  # typer turns an interrupt into this exit code
        typer.echo("hydroopt: interrupted; no result was written", err=True)
    sys.exit(code)


def _explain(error: Any) -> None:
    """Print a wrong use of the command line as one sentence."""
    context = error.ctx
    command = context.command_path if context else "hydroopt"
    what = " ".join(error.format_message().split()).rstrip(".?").replace(". Did you mean", ", did you mean")
    place = command.partition(" ")[2]
    said = f"{place + ': ' if place else ''}{what[:1].lower()}{what[1:]}; see '{command} --help'."
    typer.echo(f"hydroopt: {_visible(said)}", err=True)


def _visible(text: str) -> str:
    """A sentence without what would act on a terminal: a quoted name may hold anything."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)
