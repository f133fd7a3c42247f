"""`hydroopt check`: whether logs can be used, what is suspicious, and what they would identify."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Annotated

import typer

from hydroopt.cli.answers import print_answer, refuse_refuted
from hydroopt.cli.options import (
    AsJson,
    Bandwidth,
    MachineName,
    MapFile,
    ParameterSetName,
    Quiet,
    SmoothingText,
    TrainingLogs,
    Treat,
    progress,
    reading,
    smoothing_of,
)
from hydroopt.cli.terminal import echo


def check(
    machine: MachineName,
    logs: TrainingLogs,
    output: Annotated[Path | None, typer.Option("-o", "--output", help=(
        "Directory that receives everything: check.json and a table of the parameters."))] = None,
    map_file: MapFile = None,
    treat: Treat = None,
    smoothing: SmoothingText = "spline",
    bandwidth: Bandwidth = None,
    parameter_set: ParameterSetName = None,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Check logs before identifying: can they be used, what is suspicious, and what would they determine.

    Ends with exit code 3 if a log contradicts the machine file as it is read.

    Example: hydroopt check cat215b out/run/log.csv
    """
    from hydroopt.estimation.dynamic.log_check import check_logs
    from hydroopt.logs.stream import open_log
    from hydroopt.machine.machine_file import load_machine

    began = time.perf_counter()
    described = load_machine(machine, parameter_set=parameter_set)
    with progress(f"checking {described.name}", quiet) as say:
        say("reading logs", 0.0)
        read = reading(open_log, described, map_file, treat)(logs)
        say("smoothing and weighting", 0.2)
        found = check_logs(described, read, smoothing=smoothing_of(smoothing, bandwidth, described))
        say("searching for faults", 0.6)
        content = found.content(wall_s=time.perf_counter() - began)
        if output is not None:
            found.save(output, wall_s=content["wall_s"])
    if as_json:
        echo(json.dumps(content, indent=1))
    else:
        print_answer(found, output or Path(), quiet=quiet, as_json=False)
    refuse_refuted(found, output or Path(", ".join(str(path) for path in logs)))
