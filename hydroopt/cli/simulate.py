"""`hydroopt simulate`: the log that a machine's sensors would record."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hydroopt.cli.options import AsParquet, MotionFile, Noise, Rate, one_of
from hydroopt.cli.run import Run, command
from hydroopt.cli.terminal import echo
from hydroopt.errors import ProblemError

if TYPE_CHECKING:
    from hydroopt.logs.log import Log
    from hydroopt.machine.machine import Machine
    from hydroopt.model.model import Model
    from hydroopt.model.plant import Plant
    from hydroopt.simulation.simulate import Trajectory
    from hydroopt.spatial.inertia import Array

DURATION = 33.28
"""Of a random motion [s]: 1664 samples at 50 Hz."""
HALVINGS = 6
"""How often the amplitude of a random motion is halved until supply and joint ranges allow it."""


@command("output", "map_file", "seed", "parameter_set", "force", "quiet")
def simulate(
    run: Run,
    motion: MotionFile = None,
    driven: Annotated[bool, typer.Option("--driven", help=(
        "Drive the valves, in open loop, by commands for that motion; the log contains commands and supply, too."))
        ] = False,
    commands: Annotated[Path | None, typer.Option(help="Log whose commands drive the valves.")] = None,
    tested: Annotated[bool, typer.Option("--valve-test", help=(
        "Drive the test of plan-valve-test; the log contains commands and supply, too."))] = False,
    poses: Annotated[Path | None, typer.Option("--postures", help=(
        "Postures at which the machine stands still, such as postures.csv of plan-poses; DIR gets poses.csv."))] = None,
    duration: Annotated[float | None, typer.Option(help=(
        f"Duration of the motion [s]; {DURATION} if not given."))] = None,
    rate: Rate = None,
    truth: Annotated[str, typer.Option(
        help="True parameters: 'nominal', or 'random' within the file's confidences.")] = "nominal",
    truth_seed: Annotated[int | None, typer.Option(help=(
        "Seed of the random truth alone, so that several logs share it."), min=0)] = None,
    noise: Noise = True,
    parquet: AsParquet = False,
) -> None:
    """Simulate the log, or the poses, that a machine's sensors would record: DIR gets log.csv and truth.json.

    A given motion may state the wrench at the tip (tip.fx to tip.mz), which then acts on the machine.

    Example: hydroopt simulate cat215b --truth random -o out/run
    """
    from hydroopt.logs.log_files import read_log
    from hydroopt.model.model import Model
    from hydroopt.model.plant import Plant
    from hydroopt.results.diagnostic import listed
    from hydroopt.simulation import drive_valves
    from hydroopt.simulation import simulate as simulation
    from hydroopt.simulation.reference_motion import reference_motion
    from hydroopt.support.files import write_files

    described, seed = run.machine, run.seed
    one_of(truth, ("nominal", "random"), "truth")
    if poses is not None:
        if driven or tested or motion is not None or commands is not None or duration is not None or rate is not None:
            raise ProblemError("poses are at rest", where="--postures", remedy="leave out --driven, "
                               "--valve-test, --motion, --commands, --duration and --rate")
        with run.progress("simulating"):
            said = _poses(run, poses, random=truth == "random", noise=noise, truth_seed=truth_seed, parquet=parquet)
        if not run.quiet:
            echo(said)
        return
    model = Model(described)
    if motion is not None and (duration is not None or rate is not None):
        raise ProblemError("a given motion has its own duration and rate", where="--motion",
                           remedy="leave out --duration and --rate, or --motion")
    if commands is not None and (driven or motion is not None or duration is not None or rate is not None):
        raise ProblemError("given commands determine the motion", where="--commands",
                           remedy="leave out --driven, --motion, --duration and --rate")
    if tested and (driven or motion is not None or commands is not None or duration is not None):
        raise ProblemError("a test of the valves has steps of its own", where="--valve-test",
                           remedy="leave out --driven, --motion, --commands and --duration")
    draw, random, smaller = seed if truth_seed is None else truth_seed, truth == "random", ""
    with run.progress("choosing motion and truth") as say:
        psi = simulation.random_truth(model, draw) if random else model.parameters.nominal
        named = dict(zip(model.parameters.names, psi.tolist(), strict=True))
        if driven or tested or commands is not None:
            plant = Plant(model)
            theta = drive_valves.random_numbers(plant, draw) if random else plant.parameters.nominal
            named |= zip(plant.parameters.names, theta.tolist(), strict=True)
        if tested:
            say("driving the valves", 0.2)
            log = _tested(plant, psi, theta, rate, noise=noise, seed=seed)
        elif driven or commands is not None:
            if commands is not None:
                tries = [partial(_commands, plant, read_log(commands, mapping=run.map_file))]
            else:
                path = (_standing(described, _random(model, duration, rate, seed)) if motion is None
                        else reference_motion(described, read_log(motion, mapping=run.map_file)))
                sizes = [0.5**k for k in range(1 if motion is not None else HALVINGS + 1)]
                tries = [partial(_driving, plant, path, psi, theta, size) for size in sizes]
            say("driving the valves", 0.2)
            log, smaller = _first_possible(tries, lambda given: drive_valves.drive(
                plant, *given, psi=psi, theta=theta, noise=noise, seed=seed, name=described.name))
        else:
            path = (_random(model, duration, rate, seed) if motion is None
                    else reference_motion(described, read_log(motion, mapping=run.map_file)))
            say("simulating", 0.4)
            log = simulation.simulate(model, path, psi, noise=noise, seed=seed, name=described.name)
        say("writing", 0.8)
        name = "log.parquet" if parquet else "log.csv"
        write_files(run.output, {name: log.encoded(parquet=parquet), "truth.json": json.dumps(
            {"machine": described.name, "sha256": described.sha256, "seed": seed, "noise": noise, "parameters": named},
            indent=1)})
    if not run.quiet:
        echo(f"{run.output / name}: {len(log.t)} samples, channels {', '.join(log.channels)}")
        exact = [channel for channel in log.channels if described.sensor(channel) is None]
        if noise and exact:
            echo(f"Without errors, since the machine file states no accuracy in [[sensors]]: {listed(exact, 8)}")
        if smaller:
            echo(smaller)


def _tested(plant: Plant, psi: Array, theta: Array, rate: float | None, *, noise: bool, seed: int) -> Log:
    """The log of a test of the valves."""
    from hydroopt.control.valve_test import driven_test, valve_test
    from hydroopt.simulation.simulate import sampling_rate

    return driven_test(valve_test(plant), psi, theta, rate=sampling_rate(plant.machine) if rate is None else rate,
                       noise=noise, seed=seed)


def _poses(run: Run, file: Path, *, random: bool, noise: bool, truth_seed: int | None, parquet: bool) -> str:
    """Simulate and write a table of poses, with the truth; returns what to print."""
    from hydroopt.logs.poses import read_poses
    from hydroopt.model.closed_chain import KinematicModel
    from hydroopt.simulation.pose_table import simulate_poses
    from hydroopt.support.files import write_files

    machine = run.machine
    found = simulate_poses(KinematicModel(machine), read_poses(file, mapping=run.map_file), random=random, noise=noise,
                           seed=run.seed, truth_seed=truth_seed)
    name = "poses.parquet" if parquet else "poses.csv"
    write_files(run.output, {name: found.poses.encoded(parquet=parquet), "truth.json": json.dumps(
        {"machine": machine.name, "sha256": machine.sha256, "seed": run.seed, "noise": noise,
         "parameters": found.truth}, indent=1)})
    return f"{run.output / name}: {len(found.poses)} poses, channels {', '.join(found.poses.channels)}"


def _random(model: Model, duration: float | None, rate: float | None, seed: int) -> Trajectory:
    from hydroopt.simulation.simulate import random_trajectory, sampling_rate

    return random_trajectory(model, duration=DURATION if duration is None else duration,
                             rate=sampling_rate(model.machine) if rate is None else rate, seed=seed)


def _standing(machine: Machine, motion: Trajectory) -> Trajectory:
    """The motion with the base at rest in its first place."""
    from dataclasses import replace

    base = [machine.joints.index(joint) for joint in machine.base_joints]
    q, qd, qdd = motion.q.copy(), motion.qd.copy(), motion.qdd.copy()
    q[:, base], qd[:, base], qdd[:, base] = q[0, base], 0.0, 0.0
    return replace(motion, q=q, qd=qd, qdd=qdd)


def _driving(plant: Plant, motion: Trajectory, psi: Array, theta: Array, size: float) -> tuple[Array, Array, Array]:
    """Times, commands and first posture for a motion whose amplitude about its mean is multiplied by `size`.

    The commands are computed with the true parameters, as those of an operator who watches the machine.
    """
    import numpy as np

    from hydroopt.simulation.drive_valves import commands_for
    from hydroopt.simulation.simulate import Trajectory

    middle = np.mean(motion.q, axis=0)
    part = Trajectory(motion.t, middle + size * (motion.q - middle), size * motion.qd, size * motion.qdd,
                      motion.wrench)
    return motion.t, commands_for(plant, part, psi, theta), part.q[0]


def _first_possible(tries: Sequence[Callable[[], tuple[Array, Array, Array]]],
                    drive: Callable[[tuple[Array, Array, Array]], Log]) -> tuple[Log, str]:
    """The log of the first commands that supply and joint ranges allow, and a sentence where these are not the first.

    Raises:
        ProblemError: they allow none.
    """
    *most, last = tries
    smaller = ""
    for k, each in enumerate(most):
        try:
            return drive(each()), smaller
        except ProblemError as refused:
            smaller = f"amplitude {0.5 ** (k + 1):.3g} of the random motion's, since of a larger one {refused.what}"
    return drive(last()), smaller


def _commands(plant: Plant, log: Log) -> tuple[Array, Array, Array]:
    """Times, commands and first posture of a log; mid-range for joints whose positions it does not contain."""
    import numpy as np

    from hydroopt.logs.readings import reading

    machine = plant.machine
    u = np.column_stack([reading(machine, log, channel) for channel in plant.inputs])
    begin = [reading(machine, log, f"{joint}.q")[0] if f"{joint}.q" in log.channels
             else middle for joint, middle in zip(machine.joints, machine.ranges.mean(axis=1), strict=True)]
    return log.t, u, np.array(begin)
