"""`hydroopt control`: which controller follows a motion best, and what the identified model buys."""

from __future__ import annotations

import time
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Annotated

import typer

from hydroopt.cli.answers import continued, print_answer
from hydroopt.cli.options import (
    AsJson,
    Directory,
    MachineOrFolder,
    MapFile,
    Noise,
    ParameterSetName,
    Quiet,
    Rate,
    Seed,
    progress,
)
from hydroopt.errors import ProblemError, visible
from hydroopt.input_file import is_directory

KINDS = ("pi", "feedforward", "lqg")
UNASKED = KINDS[:2]
"""What is tried where nothing is asked for: LQG is 1.2 times as far off as the feedforward on some machines, 3 times on
others."""


def control(
    machine: MachineOrFolder,
    output: Directory,
    motion: Annotated[Path, typer.Option(help=(
        "Log whose joint positions are followed, such as excite's trajectory.csv."))],
    map_file: MapFile = None,
    true: Annotated[str, typer.Option("--truth", help=(
        "True parameters: 'nominal', or 'random' within the file's confidences; or a truth.json that simulate wrote."
        ))] = "random",
    rate: Rate = None,
    controller: Annotated[list[str] | None, typer.Option(help=(
        f"Controller to try, {', '.join(KINDS)}; repeatable; {' and '.join(UNASKED)} if not given."))] = None,
    sensitivity: Annotated[float, typer.Option(help=(
        "Largest sensitivity |1/(1 + L)| of a loop, to which the gains are tuned; 1.6 keeps a gain margin of 8.5 dB, "
        "1.3 of 12.7 dB. Every value keeps a phase margin of 45 degrees."))] = 1.6,
    gain: Annotated[float, typer.Option(help="By what the tuned position gains are multiplied.")] = 1.0,
    drawn: Annotated[int, typer.Option("--draws", min=0, max=1000, help=(
        "Machines to draw from the file's confidences as well; each is identified from a test of its valves and "
        "follows the motion. Some 20 s each."))] = 0,
    seed: Seed = 0,
    noise: Noise = True,
    parameter_set: ParameterSetName = None,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Close the loop in simulation: controllers with several models of a machine follow a motion on its true self.

    DIR gets the figures, the margins, a report, and the best feedforward as C.

    Example: hydroopt control patu655_lift --motion log.csv -o out/control
    """
    try:
        import_module("matplotlib")  # of python-control: reads the settings in the working directory
    except (OSError, ValueError) as error:
        raise ProblemError(f"matplotlib cannot read its settings ({visible(str(error))})", where="matplotlibrc",
                           remedy="correct it or remove it from this directory") from None

    from hydroopt.checks.plausibility import misread_error
    from hydroopt.codegen import parameter_source
    from hydroopt.codegen.folder import Code
    from hydroopt.codegen.parameter_source import Origin
    from hydroopt.control.comparison import FEEDFORWARD, compare
    from hydroopt.control.draws import draws
    from hydroopt.control.model_variants import COMPLETE, ModelVariant, nominal_of, reduced, truth
    from hydroopt.control.setting import Setting, rate_of
    from hydroopt.files import refuse_places
    from hydroopt.logs.log_files import read_log
    from hydroopt.machine.machine_file import bundled
    from hydroopt.model.model import Model
    from hydroopt.model.plant import Plant
    from hydroopt.report import closed_loop as report
    from hydroopt.simulation.reference_motion import reference_motion

    began = time.perf_counter()
    kinds = tuple(controller or UNASKED)
    for kind in kinds:
        if kind not in KINDS:
            raise ProblemError(f"'{kind}' is not a controller", where="--controller", remedy=f"use {', '.join(KINDS)}")
    if not 1.05 <= sensitivity <= 4:
        raise ProblemError(f"gains cannot be tuned to a sensitivity of {sensitivity:g}", where="--sensitivity",
                           remedy="give a number from 1.05 to 4, such as 1.3")
    if not 0 < gain <= 1000:
        raise ProblemError(f"gains cannot be multiplied by {gain:g}", where="--gain", remedy="give a number such as 1")
    refuse_places(output, ("control.json", "report.html", "tracking.csv", "margins.csv", "runs.csv"))
    described, origin = parameter_source.read(machine, parameter_set=parameter_set)
    model = Model(described)
    plant = Plant(model)
    _ = plant.supply  # a machine without a supply pressure is refused before anything takes time
    log = read_log(motion, mapping=map_file)
    if misread := misread_error(model, log):
        raise misread
    path = reference_motion(described, log)
    with progress(f"closing the loop on {described.name}", quiet) as say:
        complete = ModelVariant(COMPLETE, origin.text, model, model.parameters.nominal)
        estimated = machine not in bundled() and is_directory(machine)
        before = nominal_of(Path(machine), model) if estimated else None
        variants = [*([before] if before else ()), *([reduced(complete)] if FEEDFORWARD in kinds else ()), complete]
        setting = Setting(plant, path, *truth(true, plant, seed=seed), plant.parameters.nominal,
                          rate_of(plant, rate, path), seed if noise else None, sensitivity, gain)
        share = 0.95 / (1 + drawn)
        found = compare(setting, variants, kinds,
                        progress=lambda text, part=None: say(text, None if part is None else share * part))
        machines = draws(setting, drawn, progress=lambda text, part=None: say(
            text, None if part is None else share + (0.95 - share) * part))
        comparison = replace(found, draws=machines, source=origin.text, options={
            "motion": str(motion), "truth": true, "seed": seed, "noise": noise, "sensitivity": sensitivity,
            "gain": gain, "controllers": list(kinds)})
        comparison = continued(comparison, output)
        say("writing the report and the code", 0.95)
        pages: dict[str, str | bytes | None] = {"report.html": report.render(comparison)}
        best = comparison.feedforward
        if best is not None:
            code = Code(described, Origin(f"{best.variant.text} ({best.variant.name})", origin.sha256),
                        routines=["valve_feedforward"], psi=comparison.psi_of(best.variant))
            pages |= {f"c/{name}": text for name, text in code.files_for(output / "c").items()}
        comparison.save(output, pages=pages, wall_s=time.perf_counter() - began)
    print_answer(comparison, output, quiet=quiet, as_json=as_json)
