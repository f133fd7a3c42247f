"""`hydroopt study`: a computation repeated in parallel, kept cell by cell."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hydroopt.cli import Group
from hydroopt.cli.command import Command, refuse
from hydroopt.cli.options import MotionFile, Processes, Rate, TrainingLogs, one_of, refuse_given
from hydroopt.cli.run import ANSWER, Run, command
from hydroopt.cli.terminal import echo
from hydroopt.errors import ProblemError, StoppedError

if TYPE_CHECKING:
    from hydroopt.machine.machine import Machine
    from hydroopt.simulation.simulate import Trajectory
    from hydroopt.study.study import Study
    from hydroopt.study.table import Table

MethodName = Annotated[str, typer.Option(help="Method of estimation: see hydroopt identify.")]
Duration = Annotated[float | None, typer.Option(help=(
    "Duration of the motion [s]; 33.28 if not given."))]
Cells = Annotated[int, typer.Option(help="Number of cells.", min=1)]
Scheduler = Annotated[str | None, typer.Option(
    help="Address of a Dask scheduler whose workers compute, e.g. tcp://host:8786; tls://host:8786 uses the "
    "certificates of Dask's configuration.")]

app = typer.Typer(cls=Group, add_completion=False, rich_markup_mode=None)


@app.callback()
def study() -> None:
    """Monte Carlo or bootstrap: DIR gets every cell, results.csv, summary.json and report.html.

    The same command resumes an interrupted study.

    Example: hydroopt study montecarlo cat215b --cells 50 -o out/study
    """


@app.command(cls=Command)
@command(*ANSWER, "map_file", "parameter_set", "seed")
def montecarlo(
    run: Run,
    cells: Annotated[int, typer.Option(help="Number of cells; at each point of the grid.", min=1)] = 100,
    vary: Annotated[list[str] | None, typer.Option(help=(
        "What varies, NAME=VALUE,VALUE,...: accuracy (factor on the errors of all sensors), duration [s] or rate [Hz] "
        "of random motions; several make a grid."))] = None,
    method: MethodName = "sdp",
    motion: MotionFile = None,
    duration: Duration = None,
    rate: Rate = None,
    processes: Processes = None,
    scheduler: Scheduler = None,
) -> None:
    """Identify random machines from simulated logs: coverage of intervals, bias, scatter, unseen forces."""
    grid = _grid(vary or ())
    if motion is not None:
        refuse_given({"--duration": duration, "--rate": rate}, "a given motion has its own duration and rate",
                     "leave it out, or --motion")
    else:
        refuse_given({"--map": run.map_file}, "there is no log whose columns it could map",
                     "leave it out, or give --motion")

    def prepare(described: Machine) -> tuple[Study, Summary]:
        from hydroopt.estimation.dynamic.identify import METHODS
        from hydroopt.logs.log_files import read_log
        from hydroopt.simulation.reference_motion import reference_motion
        from hydroopt.study import montecarlo as study

        path: Trajectory | None = None
        sha256 = ""
        if motion is not None:
            log = read_log(motion, mapping=run.map_file)
            path, sha256 = reference_motion(described, log), log.sha256
        return study.montecarlo(described, cells=cells, seed=run.seed, method=one_of(method, METHODS, "method"),
                                motion=path, motion_sha256=sha256, vary=grid, rate=rate,
                                duration=study.DURATION if duration is None else duration), study.summary

    _run(run, prepare, processes, scheduler)


@app.command(cls=Command)
@command(*ANSWER, "map_file", "parameter_set", "seed", "treat")
def bootstrap(
    run: Run,
    logs: TrainingLogs,
    cells: Cells = 100,
    method: MethodName = "sdp",
    processes: Processes = None,
    scheduler: Scheduler = None,
) -> None:
    """Identify from resampled blocks of logs: scatter of the estimates beside their stated σ."""
    def prepare(described: Machine) -> tuple[Study, Summary]:
        from hydroopt.estimation.dynamic.identify import METHODS
        from hydroopt.study import bootstrap as study

        read = run.read(logs)
        return study.bootstrap(described, read, cells=cells, seed=run.seed,
                               method=one_of(method, METHODS, "method")), study.summary

    _run(run, prepare, processes, scheduler)


Summary = Callable[["Study", "Table"], dict[str, Any]]
"""What a kind of study makes of its table."""


def _run(run: Run, prepare: Callable[[Machine], tuple[Study, Summary]], processes: int | None,
         scheduler: str | None) -> None:
    """Prepare a study, run the cells that are missing, and write the report."""
    from hydroopt.report import study as report
    from hydroopt.study.run import run as run_cells

    if scheduler is not None:
        refuse_given({"--processes": processes}, "the scheduler has its own workers", "leave it out, or --scheduler")
    output = run.output
    with run.progress(f"preparing {run.machine.name}") as say:
        prepared, summary = prepare(run.machine)
        try:
            table = run_cells(prepared, output, scheduler=scheduler, workers=processes or os.cpu_count() or 1, say=say)
        except KeyboardInterrupt:
            done = len(list((output / "cells").glob("*.json")))
            raise StoppedError(f"interrupted after {done} of {len(prepared.cells)} cells, which are kept",
                               where=str(output), remedy="run the same command again to resume") from None
        say("writing the report")
        content = report.save(prepared, table, summary(prepared, table), output)
    if run.as_json:
        echo(json.dumps(content, indent=1))
    elif not run.quiet:
        _print(content, output)


def _grid(stated: Sequence[str]) -> dict[str, list[float]]:
    """Values by name, from NAME=VALUE,VALUE,... texts.

    Raises:
        ProblemError: a text has another form, or a name stands twice.
    """
    grid: dict[str, list[float]] = {}
    for text in stated:
        name, found, values = (part.strip() for part in text.partition("="))
        try:
            numbers = [float(value) for value in values.split(",")] if found else []
        except ValueError:
            numbers = []
        if not numbers or name in grid:
            raise ProblemError(f"'{text}' is not NAME=VALUE,VALUE,... with numbers and a name of its own",
                               where="--vary", remedy="write e.g. --vary accuracy=0.5,1,2")
        for number in numbers:
            refuse(name, number, f"--vary {name}")
        grid[name] = numbers
    return grid


def _print(content: dict[str, Any], output: Path) -> None:
    echo(f"{content['machine']['name']}: {content['study']}, {content['cells']} cells, "
               f"{content['failed']} failed")
    for point in content.get("points", ()):
        values = ", ".join(f"{key} {value:g}" for key, value in point["values"].items())
        echo(f"  {values or 'given motion'}: {_percent(point['coverage'])} of the 95 % intervals contain the "
                   "true value")
        for name, rms in point["prediction"].items():
            if rms["median"] is not None:
                echo(f"    unseen forces of {name}: RMS {rms['median']:.3g} σ in the median, "
                           f"{rms['q95']:.3g} σ at 95 %")
    if content["study"] == "bootstrap":
        ratios = sorted(row["scatter_over_stated"] for row in content["base_parameters"]
                        if row["scatter_over_stated"] is not None)
        if ratios:
            echo(f"  scatter over stated σ of base parameters: {ratios[len(ratios) // 2]:.3g} in the median, "
                       f"{ratios[0]:.3g} to {ratios[-1]:.3g}")
    echo(f"{output / 'report.html'}")


def _percent(part: float | None) -> str:
    return "none" if part is None else f"{100 * part:.1f} %"
