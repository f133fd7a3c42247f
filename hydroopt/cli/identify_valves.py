"""`hydroopt identify --hydraulics`: valves, oil and friction from commands, motion and pressures."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from pathlib import Path

import typer

from hydroopt.cli.options import progress, reliefs
from hydroopt.errors import SolverError
from hydroopt.estimation.hydraulic.estimate import identify_hydraulics
from hydroopt.estimation.hydraulic.problem import hydraulic_problem
from hydroopt.logs.log import read_log
from hydroopt.machine.machine import Machine
from hydroopt.report import valves

OTHERS = ("method", "loss", "distance", "smoothing", "bandwidth", "motion", "instruments", "correlated", "tolerance",
          "ridge", "friction", "reduced", "seed")
"""Options of `identify` that mean nothing here."""


def identify_valves(machine: Machine, logs: Sequence[Path], output: Path, validate: Sequence[Path],
                        holdout: float, *, map_file: Path | None, treatment: dict[str, str], bodies: bool, quiet: bool,
                        as_json: bool) -> None:
    """Identify valves, oil and friction: DIR gets estimate.json, report.html, free runs and the calibrated machine."""
    began, limits = time.perf_counter(), reliefs(machine)
    train = [read_log(path, mapping=map_file, treatment=treatment, limits=limits) for path in logs]
    held_out = [read_log(path, mapping=map_file, treatment=treatment, limits=limits) for path in validate]
    if holdout:
        pairs = [log.split(1 - holdout) for log in train]
        train, held_out = [pair[0] for pair in pairs], held_out + [pair[1] for pair in pairs]
    problem = hydraulic_problem(machine, train, held_out, bodies=bodies)
    with progress(f"identifying the valves of {machine.name}", quiet):
        try:
            estimate = identify_hydraulics(problem)
            content = valves.save(estimate, output, wall_s=time.perf_counter() - began)
        except SolverError as error:
            valves.save_failure(problem, error, output)
            raise
    if as_json:
        typer.echo(json.dumps(content, indent=1))
    elif not quiet:
        typer.echo(str(estimate))
        for doubt in estimate.doubts:
            typer.echo(f"  ! {doubt}")
        typer.echo(f"{output / 'report.html'}")
