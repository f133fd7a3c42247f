"""`hydroopt identify-payload`: mass and centre of mass of a load that one session carries and another does not."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hydroopt.cli.options import GainError
from hydroopt.cli.run import ANSWER, LOGS, SMOOTHING, Run, command


@command(*ANSWER, *LOGS, *SMOOTHING, "seed")
def identify_payload(
    run: Run,
    unloaded: Annotated[list[Path], typer.Option(metavar="LOG|DIR", help=(
        "Log without the load, repeatable; or the directory that identify wrote from it."))],
    loaded: Annotated[list[Path], typer.Option(metavar="LOG|DIR", help=(
        "Log with the load, repeatable; or such a directory."))],
    link: Annotated[str | None, typer.Option(help="Link that carries the load; by default the last one.")] = None,
    friction_changes: Annotated[bool, typer.Option("--friction-changes", help=(
        "Friction may differ with the load, as it does in gears."))] = False,
    gain_error: GainError = None,
) -> None:
    """Identify a carried load from logs with and without it: DIR gets payload.json, report.html and a table.

    Example: hydroopt identify-payload patu655 --unloaded empty.csv --loaded full.csv -o out/load
    """
    from hydroopt.estimation.dynamic.payload import METHOD, payload
    from hydroopt.results.json_file import Job

    smoothing = run.smoothing
    with run.progress(f"identifying the load of {run.machine.name}") as say:
        first, second = run.session(unloaded, "--unloaded"), run.session(loaded, "--loaded")
        with run.failure_saved(Job.PAYLOAD, METHOD):
            load = payload(run.machine, first, second, link=link, friction_changes=friction_changes, gain=gain_error,
                           smoothing=smoothing, seed=run.seed, progress=say)
        load = run.saved(load, say)
    run.show(load)
