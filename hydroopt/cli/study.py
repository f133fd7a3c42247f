"""`hydroopt study`: one computation many times over, side by side, kept cell by cell."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from hydroopt.cli.identify import method_of
from hydroopt.cli.options import (
    AsJson,
    Directory,
    MachineName,
    MapFile,
    ParameterSetName,
    Quiet,
    Treat,
    parameter_values,
    progress,
    refuse_idle,
    reliefs,
    treatment_of,
)
from hydroopt.errors import ProblemError, StoppedError
from hydroopt.estimation.kinematic.problem import calibration_problem
from hydroopt.logs.log import read_log
from hydroopt.logs.poses import read_pose_files
from hydroopt.machine.machine_file import load_machine
from hydroopt.report import study as report
from hydroopt.simulation.reference_motion import reference_motion
from hydroopt.study import bootstrap, montecarlo, multistart
from hydroopt.study.run import run
from hydroopt.study.study import Study
from hydroopt.study.table import Table

OWN = {"montecarlo": {"motion", "map_file", "duration", "rate"},
       "sweep": {"motion", "map_file", "duration", "rate", "vary"},
       "bootstrap": {"logs", "map_file", "treat"},
       "multistart": {"logs", "map_file", "fix"}}
"""Kinds of studies, with the options that not all of them have."""
SUMMARIES: dict[str, Callable[[Study, Table], dict[str, Any]]] = {
    "montecarlo": montecarlo.summary, "sweep": montecarlo.summary, "bootstrap": bootstrap.summary,
    "multistart": multistart.summary}


def study(
    context: typer.Context,
    kind: Annotated[str, typer.Argument(metavar="KIND", help=f"One of {', '.join(OWN)}.")],
    machine: MachineName,
    output: Directory,
    logs: Annotated[list[Path] | None, typer.Argument(
        metavar="[LOG...]", help="Logs of a bootstrap, or tables of poses of a multistart.")] = None,
    cells: Annotated[int, typer.Option(help="How many; of a sweep at each point of its grid.", min=1)] = 100,
    seed: Annotated[int, typer.Option(help="Of the study, from which every cell has its own.", min=0)] = 0,
    method: Annotated[str | None, typer.Option(
        help="As of identify, sdp if not given; for multistart as of calibrate.")] = None,
    motion: Annotated[Path | None, typer.Option(
        help="Log whose joint positions all cells follow, such as excite's trajectory.csv; else random ones.")] = None,
    duration: Annotated[float | None, typer.Option(help="Of random motions [s]; 33.28 if not given.")] = None,
    rate: Annotated[float | None, typer.Option(help=(
        "Samples per second of random motions [Hz]; if not given, the highest that the file states for a joint's "
        "sensor, or 50."))] = None,
    vary: Annotated[list[str] | None, typer.Option(help=(
        "What a sweep varies, NAME=VALUE,VALUE,... of "
        f"{', '.join(f'{name} ({what})' for name, what in montecarlo.VARIED.items())}; several make a product."
    ))] = None,
    map_file: MapFile = None,
    treat: Treat = None,
    fix: Annotated[list[str] | None, typer.Option(
        help="Hold a parameter of the geometry, NAME=VALUE with unit, e.g. 'ball.y=0 m'; repeatable.")] = None,
    workers: Annotated[int | None, typer.Option(help="Processes; as many as there are cores if not given.",
                                                min=1)] = None,
    scheduler: Annotated[str | None, typer.Option(
        help="Address of a Dask scheduler whose workers shall compute, e.g. tcp://host:8786.")] = None,
    parameter_set: ParameterSetName = None,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Monte Carlo, sweep, bootstrap or multistart: DIR gets every cell, results.csv, summary.json and report.html.

    The same command again goes on where it ended, whatever ended it.
    """
    if kind not in OWN:
        raise ProblemError(f"'{kind}' is no kind of study", where="study", remedy=f"use one of {', '.join(OWN)}")
    refuse_idle(context, set().union(*OWN.values()) - OWN[kind], f"a study of the kind {kind} has no use for it",
                "leave it out")
    if motion is None:
        if kind in ("montecarlo", "sweep"):
            refuse_idle(context, {"map_file"}, "there is no motion that it could explain", "leave it out, or --motion")
    else:
        refuse_idle(context, {"duration", "rate"}, "a given motion has its own", "leave it out, or --motion")
    if scheduler is not None:
        refuse_idle(context, {"workers"}, "the scheduler has its workers", "leave it out, or --scheduler")
    described = load_machine(machine, parameter_set=parameter_set)
    with progress(f"preparing {described.name}", quiet) as say:
        if kind == "bootstrap":
            limits, treatment = reliefs(described), treatment_of(treat)
            read = [read_log(path, mapping=map_file, treatment=treatment, limits=limits) for path in _some(logs)]
            prepared = bootstrap.bootstrap(described, read, cells=cells, seed=seed, method=method_of(method or "sdp"))
        elif kind == "multistart":
            poses = read_pose_files(_some(logs), mapping=map_file)
            problem = calibration_problem(described, poses)
            held = problem.fixing(**parameter_values(fix or (), problem.parameters)).fixed
            prepared = multistart.multistart(described, poses, cells=cells, seed=seed, method=method or "joint",
                                             fixed=held)
        else:
            if kind == "sweep" and not vary:
                raise ProblemError("nothing is varied", where="--vary", remedy="give e.g. --vary accuracy=0.5,1,2")
            log = read_log(motion, mapping=map_file) if motion else None
            prepared = montecarlo.montecarlo(
                described, cells=cells, seed=seed, method=method_of(method or "sdp"),
                motion=reference_motion(described, log) if log else None, motion_sha256=log.sha256 if log else "",
                vary=_varied(vary or ()), duration=montecarlo.DURATION if duration is None else duration, rate=rate)
        try:
            table = run(prepared, output, scheduler=scheduler, workers=workers or os.cpu_count() or 1, say=say)
        except KeyboardInterrupt:
            done = len(list((output / "cells").glob("*.json")))
            raise StoppedError(f"interrupted after {done} of {len(prepared.cells)} cells, which are kept",
                               where=str(output), remedy="the same command goes on from there") from None
        say("writing the report")
        content = report.save(prepared, table, SUMMARIES[kind](prepared, table), output)
    if as_json:
        typer.echo(json.dumps(content, indent=1))
    elif not quiet:
        _tell(content, output)


def _some(logs: Sequence[Path] | None) -> Sequence[Path]:
    if not logs:
        raise ProblemError("there is nothing to learn from", where="LOG", remedy="name one file or more")
    return logs


def _varied(stated: Sequence[str]) -> dict[str, list[float]]:
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
        grid[name] = numbers
    return grid


def _tell(content: dict[str, Any], output: Path) -> None:
    typer.echo(f"{content['machine']['name']}: {content['study']}, {content['cells']} cells, "
               f"{content['failed']} failed")
    for point in content.get("points", ()):
        values = ", ".join(f"{key} {value:g}" for key, value in point["values"].items())
        typer.echo(f"  {values or 'given motion'}: {_percent(point['coverage'])} of the 95 % intervals hold the truth")
        for name, rms in point["prediction"].items():
            if rms["median"] is not None:
                typer.echo(f"    unseen forces of {name}: RMS {rms['median']:.3g} σ in the median, "
                           f"{rms['q95']:.3g} σ at 95 %")
    if content["study"] == "bootstrap":
        ratios = sorted(row["scatter_over_stated"] for row in content["base_parameters"]
                        if row["scatter_over_stated"] is not None)
        if ratios:
            typer.echo(f"  scatter over stated σ of base parameters: {ratios[len(ratios) // 2]:.3g} in the median, "
                       f"{ratios[0]:.3g} to {ratios[-1]:.3g}")
    for optimum in content.get("optima", ())[:5]:
        typer.echo(f"  {optimum['starts']} starts lead to squared errors of {optimum['cost']:.6g}, "
                   f"{optimum['farthest_std']:.3g} σ from the best")
    typer.echo(f"{output / 'report.html'}")


def _percent(part: float | None) -> str:
    return "none" if part is None else f"{100 * part:.1f} %"
