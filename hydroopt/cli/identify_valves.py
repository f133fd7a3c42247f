"""`hydroopt identify-valves`: valves, oil and friction from commands, motion and pressures."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Annotated

import typer

from hydroopt.cli.options import (
    AsJson,
    Directory,
    MachineName,
    MapFile,
    ParameterSetName,
    Quiet,
    Treat,
    progress,
    reliefs,
    treatment_of,
)
from hydroopt.errors import SolverError


def identify_valves(
    machine: MachineName,
    logs: Annotated[list[Path], typer.Argument(metavar="LOG...", help="Training logs (.csv, .parquet, .mat).")],
    output: Directory,
    validate: Annotated[list[Path] | None, typer.Option(help="Validation log; repeatable.")] = None,
    holdout: Annotated[float, typer.Option(help="Part of the end of every log that is held out for validation.",
                                           min=0.0, max=0.9)] = 0.0,
    map_file: MapFile = None,
    treat: Treat = None,
    bodies: Annotated[bool, typer.Option("--bodies", help=(
        "Masses and inertias, too, as far as the forces identify them."))] = False,
    parameter_set: ParameterSetName = None,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Identify valves, oil and friction: DIR gets estimate.json, report.html, free runs and the calibrated machine."""
    from hydroopt.estimation.hydraulic.estimate import METHOD
    from hydroopt.estimation.hydraulic.problem import hydraulic_problem
    from hydroopt.logs.log import read_log
    from hydroopt.machine.machine_file import load_machine
    from hydroopt.report import valves
    from hydroopt.results import json_file
    from hydroopt.solving import solve

    began, described = time.perf_counter(), load_machine(machine, parameter_set=parameter_set)
    treatment, limits = treatment_of(treat), reliefs(described)
    train = [read_log(path, mapping=map_file, treatment=treatment, limits=limits) for path in logs]
    held_out = [read_log(path, mapping=map_file, treatment=treatment, limits=limits) for path in validate or ()]
    if holdout:
        pairs = [log.split(1 - holdout) for log in train]
        train, held_out = [pair[0] for pair in pairs], held_out + [pair[1] for pair in pairs]
    problem = hydraulic_problem(described, train, held_out, bodies=bodies)
    with progress(f"identifying the valves of {described.name}", quiet):
        try:
            estimate = solve(problem)
            estimate.save(output, pages={"report.html": valves.render(estimate)}, wall_s=time.perf_counter() - began)
        except SolverError as error:
            json_file.write_failure(output, json_file.Job.HYDRAULICS, json_file.MachineId.of(described), METHOD,
                                    problem.inputs, error)
            raise
    if as_json:
        typer.echo(json.dumps(json_file.read(output), indent=1))
    elif not quiet:
        typer.echo(str(estimate))
        for diagnostic in estimate.diagnostics:
            typer.echo(f"  ! {diagnostic}")
        typer.echo(f"{output / 'report.html'}")
