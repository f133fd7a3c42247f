"""`hydroopt control`: which controller follows a motion best, and what the identified model buys."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Annotated, Any

import typer

from hydroopt.cli.options import AsJson, Directory, MapFile, ParameterSetName, Quiet, progress
from hydroopt.codegen import parameter_source as codegen_origin
from hydroopt.control.comparison import FEEDFORWARD, LQG, PI, Comparison, Setting, compare, rate_of
from hydroopt.control.model_variants import COMPLETE, Knowledge, nominal_of, reduced, truth
from hydroopt.control.tuning import SENSITIVITY
from hydroopt.errors import ProblemError
from hydroopt.logs.log import read_log
from hydroopt.machine.machine_file import bundled
from hydroopt.model.model import Model
from hydroopt.model.plant import Plant
from hydroopt.report import closed_loop_folder as folder
from hydroopt.simulation.reference_motion import reference_motion

KINDS = (PI, FEEDFORWARD, LQG)


def control(
    machine: Annotated[str, typer.Argument(metavar="MACHINE|ESTIMATE_DIR", help=(
        "A machine with its valves, or the directory that identify wrote."))],
    output: Directory,
    trajectory: Annotated[Path, typer.Option(help="Log whose joint positions are to be followed.")],
    map_file: MapFile = None,
    true: Annotated[str, typer.Option("--truth", help=(
        "What the simulated machine really is: 'nominal', 'random' within the file's confidences, or a truth.json that "
        "simulate wrote."))] = "random",
    rate: Annotated[float | None, typer.Option(help=(
        "Samples per second of the controller [Hz]; if not given, the highest that the file states for a joint's "
        "sensor, or 50."))] = None,
    controller: Annotated[list[str] | None, typer.Option(help=(
        f"Controller to try, {', '.join(KINDS)}; repeatable; all if not given."))] = None,
    sensitivity: Annotated[float, typer.Option(help=(
        "Largest sensitivity |1/(1 + L)| of a loop, to which the gains are tuned; 1.3 keeps a gain margin of 12.7 dB "
        "and a phase margin of 45 degrees."))] = SENSITIVITY,
    gain: Annotated[float, typer.Option(help="By what the tuned position gains are multiplied.")] = 1.0,
    seed: Annotated[int, typer.Option(help="Of a random truth and of the sensors' errors.", min=0)] = 0,
    noise: Annotated[bool, typer.Option(help="Whether sensors err as the file states.")] = True,
    parameter_set: ParameterSetName = None,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Close the loop in simulation: controllers with several models of a machine follow a motion on its true self.

    DIR gets the figures, the margins, a report, and the best feedforward as C.
    """
    began = time.perf_counter()
    kinds = tuple(controller or KINDS)
    for kind in kinds:
        if kind not in KINDS:
            raise ProblemError(f"'{kind}' is no controller", where="--controller", remedy=f"use {', '.join(KINDS)}")
    if not 1.05 <= sensitivity <= 4:
        raise ProblemError(f"gains cannot be tuned to a sensitivity of {sensitivity:g}", where="--sensitivity",
                           remedy="give a number from 1.05 to 4, such as 1.3")
    if not 0 < gain <= 1000:
        raise ProblemError(f"gains cannot be multiplied by {gain:g}", where="--gain", remedy="give a number such as 1")
    folder.refuse_directory(output)
    described, origin = codegen_origin.read(machine, parameter_set=parameter_set)
    model = Model(described)
    plant = Plant(model)
    _ = plant.supply  # a machine without a supply pressure is refused before anything takes time
    motion = reference_motion(described, read_log(trajectory, mapping=map_file))
    with progress(f"closing the loop on {described.name}", quiet) as say:
        complete = Knowledge(COMPLETE, origin.text, model, model.parameters.nominal)
        estimated = machine not in bundled() and Path(machine).is_dir()
        before = nominal_of(Path(machine) / "estimate.json", model) if estimated else None
        known = [*([before] if before else ()), *([reduced(complete)] if FEEDFORWARD in kinds else ()), complete]
        setting = Setting(plant, motion, *truth(true, plant, seed=seed), plant.parameters.nominal,
                          rate_of(plant, rate, motion), seed if noise else None, sensitivity, gain)
        comparison = compare(setting, known, kinds, say=say)
        say("writing the report and the code")
        content = folder.save(comparison, output, origin=origin, wall_s=time.perf_counter() - began,
                              asked={"trajectory": str(trajectory), "truth": true, "seed": seed, "noise": noise,
                                     "sensitivity": sensitivity, "gain": gain, "controllers": list(kinds)})
    if as_json:
        typer.echo(json.dumps(content, indent=1))
    elif not quiet:
        _tell(comparison, content, output)


def _tell(comparison: Comparison, content: dict[str, Any], output: Path) -> None:
    typer.echo(f"{content['machine']['name']}: {len(comparison.reference)} samples at {comparison.setting.rate:g} Hz, "
               f"truth {comparison.setting.true.text}")
    for outcome in comparison.outcomes:
        mark = " *" if outcome is comparison.winner else ""
        typer.echo(f"  {outcome.name}: " + (outcome.run.stopped or (
            f"tip {1e3 * outcome.tip_rms:.1f} mm RMS, {1e3 * outcome.tip.max():.1f} mm at most; "
            f"{outcome.run.pressure.max() / 1e5:.0f} bar at most, {outcome.run.energy / 1e3:.0f} kJ")) + mark)
    for doubt in content["doubts"]:
        typer.echo(f"  ! {doubt}")
    typer.echo(f"{output / 'report.html'}")
