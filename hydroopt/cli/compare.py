"""`hydroopt compare`: what has changed between two sessions, or what load the second one carries."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from hydroopt.cli.options import (
    AsJson,
    Bandwidth,
    Directory,
    MachineName,
    MapFile,
    ParameterSetName,
    Quiet,
    SmoothingText,
    Treat,
    progress,
    refuse_idle,
    reliefs,
    smoothing_of,
    treatment_of,
)
from hydroopt.errors import ProblemError, SolverError
from hydroopt.estimation.dynamic.change import Change, detect_change
from hydroopt.estimation.dynamic.payload import Payload
from hydroopt.estimation.dynamic.payload import payload as weigh_load
from hydroopt.logs.log import Log, read_log
from hydroopt.machine.machine_file import load_machine
from hydroopt.report import comparison

OF_A_CHANGE, OF_A_LOAD = ("parts", "level"), ("link", "friction_changes", "gain")
"""Options that only one of the two uses has."""


def compare(
    context: typer.Context,
    machine: MachineName,
    output: Directory,
    before: Annotated[list[Path], typer.Option(metavar="LOG|DIR", help=(
        "Log of the first session (without the load), repeatable; or the directory that identify made of it."))],
    after: Annotated[list[Path], typer.Option(metavar="LOG|DIR", help=(
        "Log of the second session (with the load), repeatable; or such a directory."))],
    parts: Annotated[str | None, typer.Option(help=(
        "What may have changed: friction, offset, parts and parameters, with commas in between; else friction and "
        "offsets."))] = None,
    level: Annotated[float, typer.Option(help="Probability of a false alarm.")] = 0.05,
    payload: Annotated[bool, typer.Option("--payload", help="The second session carries a load: which?")] = False,
    link: Annotated[str | None, typer.Option(help="Link that carries the load; else the last one.")] = None,
    friction_changes: Annotated[bool, typer.Option("--friction-changes", help=(
        "Friction may differ with the load, as it does in gears."))] = False,
    gain: Annotated[float, typer.Option(help=(
        "Part by which each actuator's force readings may all be off, as a standard deviation, e.g. 0.05."))] = 0.0,
    map_file: MapFile = None,
    treat: Treat = None,
    smoothing: SmoothingText = "spline",
    bandwidth: Bandwidth = None,
    seed: Annotated[int, typer.Option(help="Of the sampling of intervals.", min=0)] = 0,
    parameter_set: ParameterSetName = None,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Compare two sessions: what has changed, or which load is carried. DIR gets comparison.json, report.html, a table.
    """
    began = time.perf_counter()
    refuse_idle(context, OF_A_CHANGE if payload else OF_A_LOAD,
           "a load is no change of parameters" if payload else "no load is asked for",
           "leave it out, or --payload" if payload else "leave it out, or add --payload")
    described = load_machine(machine, parameter_set=parameter_set)
    way, treatment, limits = smoothing_of(smoothing, bandwidth, described), treatment_of(treat), reliefs(described)

    def given(paths: Sequence[Path], option: str) -> list[Log] | Path:
        if not any(path.is_dir() for path in paths):
            return [read_log(path, mapping=map_file, treatment=treatment, limits=limits) for path in paths]
        if len(paths) > 1:
            raise ProblemError("a directory stands for a whole session", where=option,
                               remedy="give one directory, or logs only")
        return paths[0]

    with progress(f"comparing two sessions of {described.name}", quiet):
        first, second = given(before, "--before"), given(after, "--after")
        result: Change | Payload
        try:
            if payload:
                result = weigh_load(described, first, second, link=link, friction_changes=friction_changes, gain=gain,
                                    smoothing=way, seed=seed)
            else:
                asked = None if parts is None else [part.strip() for part in parts.split(",")]
                result = detect_change(described, first, second, parts=asked, level=level, smoothing=way, seed=seed)
        except SolverError as error:
            comparison.save_failure(described, error, output)
            raise
        content = comparison.save(result, output, wall_s=time.perf_counter() - began)
    if as_json:
        typer.echo(json.dumps(content, indent=1))
    elif not quiet:
        typer.echo(str(result))
        typer.echo(f"{output / 'report.html'}")
