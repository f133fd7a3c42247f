"""`hydroopt identify-payload`: mass and centre of mass of a load that one session carries and another does not."""

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
    GainError,
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


def identify_payload(
    machine: MachineName,
    output: Directory,
    unloaded: Annotated[list[Path], typer.Option(metavar="LOG|DIR", help=(
        "Log without the load, repeatable; or the directory that identify wrote from it."))],
    loaded: Annotated[list[Path], typer.Option(metavar="LOG|DIR", help=(
        "Log with the load, repeatable; or such a directory."))],
    link: Annotated[str | None, typer.Option(help="Link that carries the load; by default the last one.")] = None,
    friction_changes: Annotated[bool, typer.Option("--friction-changes", help=(
        "Friction may differ with the load, as it does in gears."))] = False,
    gain_error: GainError = None,
    map_file: MapFile = None,
    treat: Treat = None,
    smoothing: SmoothingText = "spline",
    bandwidth: Bandwidth = None,
    seed: Seed = 0,
    parameter_set: ParameterSetName = None,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Identify a carried load from logs with and without it: DIR gets payload.json, report.html and a table.

    Example: hydroopt identify-payload patu655 --unloaded empty.csv --loaded full.csv -o out/load
    """
    from hydroopt.estimation.dynamic.payload import METHOD, payload
    from hydroopt.machine.machine_file import load_machine
    from hydroopt.report.sessions import render_payload
    from hydroopt.results.json_file import Job

    began = time.perf_counter()
    described = load_machine(machine, parameter_set=parameter_set)
    way = smoothing_of(smoothing, bandwidth, described)
    with progress(f"identifying the load of {described.name}", quiet) as say:
        first, second = (session_of(described, paths, option, map_file, treat)
                         for paths, option in ((unloaded, "--unloaded"), (loaded, "--loaded")))
        with failure_saved(output, Job.PAYLOAD, described, METHOD):
            load = payload(described, first, second, link=link, friction_changes=friction_changes, gain=gain_error,
                           smoothing=way, seed=seed, progress=say)
        load.save(output, pages={"report.html": render_payload(load)}, wall_s=time.perf_counter() - began)
    print_answer(load, output, quiet=quiet, as_json=as_json)
    refuse_refuted(load, output)
