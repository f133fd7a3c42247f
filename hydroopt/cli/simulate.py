"""`hydroopt simulate`: the log that a machine's sensors would record."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from hydroopt.cli.options import Directory, MachineName, MapFile, ParameterSetName, Quiet, progress
from hydroopt.errors import ProblemError
from hydroopt.files import write_files
from hydroopt.logs.log import Log, read_log
from hydroopt.logs.readings import reading
from hydroopt.machine.machine_file import load_machine
from hydroopt.model.model import Model
from hydroopt.model.plant import Plant
from hydroopt.simulation import drive_valves
from hydroopt.simulation import simulate as synthetic
from hydroopt.simulation.reference_motion import reference_motion
from hydroopt.spatial.inertia import Array

HALVED = 6
"""How often a random motion is halved until the supply can drive it and it keeps within its range."""
Given = tuple[Array, Array, Array]
"""Times, commands and the posture to begin with."""


def simulate(
    machine: MachineName,
    output: Directory,
    motion: Annotated[Path | None, typer.Option(
        help="Log whose joint positions are to be followed; else random.")] = None,
    driven: Annotated[bool, typer.Option("--driven", help=(
        "Drive the valves, open loop, by commands for that motion; the log holds commands, supply and what they do."
        ))] = False,
    commands: Annotated[Path | None, typer.Option(help="Log whose commands drive the valves.")] = None,
    map_file: MapFile = None,
    duration: Annotated[float | None, typer.Option(help="Of a random motion [s]; 33.28 if not given.")] = None,
    rate: Annotated[float | None, typer.Option(help=(
        "Samples per second of a random motion [Hz]; if not given, the highest that the file states for a joint's "
        "sensor, or 50."))] = None,
    seed: Annotated[int, typer.Option(help="Of the random motion, the random truth and the noise.", min=0)] = 0,
    truth: Annotated[str, typer.Option(help="'nominal', or 'random' within the file's confidences.")] = "nominal",
    truth_seed: Annotated[int | None, typer.Option(help="Of the random truth alone, to share it by logs.",
                                                   min=0)] = None,
    noise: Annotated[bool, typer.Option(help="Whether sensors err as the file states.")] = True,
    parquet: Annotated[bool, typer.Option("--parquet", help="Write Parquet instead of CSV.")] = False,
    parameter_set: ParameterSetName = None,
    quiet: Quiet = False,
) -> None:
    """Simulate a log of a machine as its sensors would record it: DIR/log.csv and DIR/truth.json."""
    described = load_machine(machine, parameter_set=parameter_set)
    model = Model(described)
    if motion is not None and (duration is not None or rate is not None):
        raise ProblemError("a given motion has its own duration and rate", where="--motion",
                           remedy="leave out --duration and --rate, or --motion")
    if truth not in ("nominal", "random"):
        raise ProblemError(f"'{truth}' is no truth", where="--truth", remedy="use nominal or random")
    if commands is not None and (driven or motion is not None or duration is not None or rate is not None):
        raise ProblemError("given commands make a motion of their own", where="--commands",
                           remedy="leave out --driven, --motion, --duration and --rate")
    draw, random = seed if truth_seed is None else truth_seed, truth == "random"
    with progress("simulating", quiet):
        psi = synthetic.random_truth(model, draw) if random else model.parameters.nominal
        named = dict(zip(model.parameters.names, psi.tolist(), strict=True))
        if driven or commands is not None:
            plant = Plant(model)
            theta = drive_valves.random_numbers(plant, draw) if random else plant.parameters.nominal
            named |= zip(plant.parameters.names, theta.tolist(), strict=True)
            if commands is not None:
                tries = [lambda: _commands(plant, read_log(commands, mapping=map_file))]
            else:
                path = (_random(model, duration, rate, seed) if motion is None
                        else reference_motion(described, read_log(motion, mapping=map_file)))
                sizes = 0.5 ** np.arange(1 if motion is not None else HALVED + 1)
                tries = [partial(_driving, plant, path, psi, theta, float(size)) for size in sizes]
            log = _first_possible(tries, lambda given: drive_valves.drive(
                plant, *given, psi=psi, theta=theta, noise=noise, seed=seed, name=described.name))
        else:
            path = (_random(model, duration, rate, seed) if motion is None
                    else reference_motion(described, read_log(motion, mapping=map_file)))
            log = synthetic.simulate(model, path, psi, noise=noise, seed=seed, name=described.name)
    write_files(output, {})  # the directory
    file = output / ("log.parquet" if parquet else "log.csv")
    log.write(file)
    write_files(output, {"truth.json": json.dumps(
        {"machine": described.name, "sha256": described.sha256, "seed": seed, "noise": noise, "parameters": named},
        indent=1)})
    if not quiet:
        typer.echo(f"{file}: {len(log.t)} samples, channels {', '.join(log.channels)}")


def _random(model: Model, duration: float | None, rate: float | None, seed: int) -> synthetic.Trajectory:
    return synthetic.random_trajectory(model, duration=33.28 if duration is None else duration,
                                       rate=synthetic.sampling_rate(model.machine) if rate is None else rate, seed=seed)


def _driving(plant: Plant, motion: synthetic.Trajectory, psi: Array, theta: Array,
             size: float) -> Given:
    """Times, commands for a part of a motion about its middle, and the posture to begin with.

    The commands are those of an operator who sees what the machine does: its true numbers tell them.
    """
    middle = np.mean(motion.q, axis=0)
    part = synthetic.Trajectory(motion.t, middle + size * (motion.q - middle), size * motion.qd, size * motion.qdd)
    return motion.t, drive_valves.commands_for(plant, part, psi, theta), part.q[0]


def _first_possible(tries: Sequence[Callable[[], Given]], drive: Callable[[Given], Log]) -> Log:
    """The log of the first commands that supply and ranges allow.

    Raises:
        ProblemError: none of them do.
    """
    *most, last = tries
    for each in most:
        with suppress(ProblemError):
            return drive(each())
    return drive(last())


def _commands(plant: Plant, log: Log) -> Given:
    """Times and commands of a log, and the posture that it begins with; the middle of the ranges where it says none."""
    machine = plant.machine
    u = np.column_stack([reading(machine, log, channel) for channel in plant.inputs])
    begin = [reading(machine, log, f"{joint}.q")[0] if f"{joint}.q" in log.channels
             else np.mean(machine.link(joint).joint.range) for joint in machine.joints]
    return log.t, u, np.array(begin)
