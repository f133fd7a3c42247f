"""`hydroopt compare`: which parameters changed between two sessions."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

from hydroopt.cli.answers import failure_saved, print_answer, refuse_refuted
from hydroopt.cli.options import (
    AsJson,
    Bandwidth,
    Directory,
    IntervalSeed,
    MachineName,
    MapFile,
    ParameterSetName,
    Quiet,
    SmoothingText,
    Treat,
    progress,
    session_of,
    smoothing_of,
)


def compare(
    machine: MachineName,
    output: Directory,
    before: Annotated[list[Path], typer.Option(metavar="LOG|DIR", help=(
        "Log of the first session, repeatable; or the directory that identify wrote from it."))],
    after: Annotated[list[Path], typer.Option(metavar="LOG|DIR", help=(
        "Log of the second session, repeatable; or such a directory."))],
    parts: Annotated[str | None, typer.Option(help=(
        "What may have changed: friction, offset, parts and parameters, separated by commas; by default friction and "
        "offsets."))] = None,
    level: Annotated[float, typer.Option(help="Probability of a false alarm.")] = 0.05,
    map_file: MapFile = None,
    treat: Treat = None,
    smoothing: SmoothingText = "spline",
    bandwidth: Bandwidth = None,
    seed: IntervalSeed = 0,
    parameter_set: ParameterSetName = None,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Test which parameters changed between two sessions: DIR gets comparison.json, report.html and a table."""
    from hydroopt.estimation.dynamic.change import detect_change
    from hydroopt.estimation.dynamic.two_session_answer import METHOD
    from hydroopt.machine.machine_file import load_machine
    from hydroopt.report.comparison import render_change
    from hydroopt.results.json_file import Job

    began = time.perf_counter()
    described = load_machine(machine, parameter_set=parameter_set)
    way = smoothing_of(smoothing, bandwidth, described)
    names = None if parts is None else [part.strip() for part in parts.split(",")]
    with progress(f"comparing two sessions of {described.name}", quiet):
        first, second = (session_of(described, paths, option, map_file, treat)
                         for paths, option in ((before, "--before"), (after, "--after")))
        with failure_saved(output, Job.CHANGE, described, METHOD):
            change = detect_change(described, first, second, parts=names, level=level, smoothing=way, seed=seed)
        change.save(output, pages={"report.html": render_change(change)}, wall_s=time.perf_counter() - began)
    print_answer(change, output, quiet=quiet, as_json=as_json)
    refuse_refuted(change, output)
