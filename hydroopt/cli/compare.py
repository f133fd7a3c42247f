"""`hydroopt compare`: which parameters changed between two sessions, or over several in time order."""

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
    MachineName,
    MapFile,
    ParameterSetName,
    Quiet,
    Seed,
    SmoothingText,
    Treat,
    progress,
    session_of,
    smoothing_of,
)
from hydroopt.errors import ProblemError


def compare(
    machine: MachineName,
    sessions: Annotated[list[Path], typer.Argument(metavar="LOG|DIR...", help=(
        "Sessions in time order: a log each, or the directory that identify wrote from the logs of a session."))],
    output: Directory,
    parts: Annotated[str | None, typer.Option(help=(
        "What may have changed: friction, offset, parts and parameters, separated by commas; by default friction and "
        "offsets."))] = None,
    level: Annotated[float, typer.Option(help="Probability of a false alarm.")] = 0.05,
    map_file: MapFile = None,
    treat: Treat = None,
    smoothing: SmoothingText = "spline",
    bandwidth: Bandwidth = None,
    seed: Seed = 0,
    parameter_set: ParameterSetName = None,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Test which parameters changed over sessions, and at which: DIR gets comparison.json, report.html and tables.

    Example: hydroopt compare cat215b monday.csv friday.csv -o out/change
    """
    from hydroopt.estimation.dynamic import session_comparison
    from hydroopt.machine.machine_file import load_machine
    from hydroopt.report.sessions import render_comparison
    from hydroopt.results.json_file import Job

    began = time.perf_counter()
    if len(sessions) < 2:
        raise ProblemError("one session has nothing to be compared with", where="compare",
                           remedy="give two or more logs or directories in time order")
    described = load_machine(machine, parameter_set=parameter_set)
    way = smoothing_of(smoothing, bandwidth, described)
    names = None if parts is None else [part.strip() for part in parts.split(",")]
    with progress(f"comparing {len(sessions)} sessions of {described.name}", quiet) as say:
        read = [session_of(described, [path], "compare", map_file, treat) for path in sessions]
        with failure_saved(output, Job.CHANGE, described, session_comparison.METHOD):
            answer = session_comparison.compare(described, read, parts=names, level=level, smoothing=way, seed=seed,
                                                progress=say)
        answer.save(output, pages={"report.html": render_comparison(answer)}, wall_s=time.perf_counter() - began)
    beside = [finding.text for finding in answer.findings[1:]] or [f"By a {answer.method}, false alarms at {level:g}."]
    print_answer(answer, output, "\n".join(beside), quiet=quiet, as_json=as_json)
    refuse_refuted(answer, output)
