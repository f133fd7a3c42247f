"""`hydroopt control`: which controller follows a motion best, and what the identified model buys."""

from __future__ import annotations

import os
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Annotated

import typer

from hydroopt.cli.options import MachineOrFolder, Noise, Rate, one_of
from hydroopt.cli.run import ANSWER, Run, command
from hydroopt.errors import ProblemError, visible

KINDS = ("pi", "feedforward", "lqg")
UNASKED = KINDS[:2]
"""What is tried where nothing is asked for: LQG is 1.2 times as far off as the feedforward on some machines, 3 times on
others."""


@command(*ANSWER, "map_file", "parameter_set", "seed", machine=MachineOrFolder)
def control(
    run: Run,
    motion: Annotated[Path, typer.Option(help=(
        "Log whose joint positions are followed, such as excite's trajectory.csv."))],
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
    noise: Noise = True,
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
    from hydroopt.control.setting import COMPLETE, ModelVariant, Setting, nominal_of, rate_of, reduced, truth
    from hydroopt.logs.log_files import read_log
    from hydroopt.machine.machine_file import bundled
    from hydroopt.model.model import Model
    from hydroopt.model.plant import Plant
    from hydroopt.simulation.reference_motion import reference_motion
    from hydroopt.support.files import refuse_places

    kinds = tuple(controller or UNASKED)
    for kind in kinds:
        one_of(kind, KINDS, "controller")
    if not 1.05 <= sensitivity <= 4:
        raise ProblemError(f"gains cannot be tuned to a sensitivity of {sensitivity:g}", where="--sensitivity",
                           remedy="give a number from 1.05 to 4, such as 1.3")
    if not 0 < gain <= 1000:
        raise ProblemError(f"gains cannot be multiplied by {gain:g}", where="--gain", remedy="give a number such as 1")
    refuse_places(run.output, ("control.json", "report.html", "tracking.csv", "margins.csv", "runs.csv"))
    described, origin = parameter_source.read(run.named, parameter_set=run.parameter_set)
    run.trusted(described)
    model = Model(described)
    plant = Plant(model)
    _ = plant.supply  # a machine without a supply pressure is refused before anything takes time
    log = read_log(motion, mapping=run.map_file)
    if misread := misread_error(model, log):
        raise misread
    path = reference_motion(described, log)
    with run.progress(f"closing the loop on {described.name}") as say:
        complete = ModelVariant(COMPLETE, origin.text, model, model.parameters.nominal)
        estimated = run.named not in bundled() and os.path.isdir(run.named)
        before = nominal_of(Path(run.named), model) if estimated else None
        variants = [*([before] if before else ()), *([reduced(complete)] if FEEDFORWARD in kinds else ()), complete]
        setting = Setting(plant, path, *truth(true, plant, seed=run.seed), plant.parameters.nominal,
                          rate_of(plant, rate, path), run.seed if noise else None, sensitivity, gain)
        found = compare(setting, variants, kinds,
                        progress=lambda text, part=None: say(text, None if part is None else 0.95 * part))
        comparison = replace(found, source=origin.text, options={
            "motion": str(motion), "truth": true, "seed": run.seed, "noise": noise, "sensitivity": sensitivity,
            "gain": gain, "controllers": list(kinds)})
        say("writing the code", 0.95)
        written: dict[str, str | bytes | None] = {}
        best = comparison.feedforward
        if best is not None:
            code = Code(described, Origin(f"{best.variant.text} ({best.variant.name})", origin.sha256),
                        routines=["valve_feedforward"], psi=comparison.psi_of(best.variant))
            written = {f"c/{name}": text for name, text in code.files_for(run.output / "c").items()}
        comparison = run.saved(comparison, say, written)
    run.show(comparison)
