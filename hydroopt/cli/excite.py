"""`hydroopt excite`: the motion to drive for a dynamic identification."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hydroopt.cli.answers import print_answer
from hydroopt.cli.options import (
    AsJson,
    AsParquet,
    Directory,
    Focus,
    MachineName,
    MapFile,
    ParameterSetName,
    Priors,
    Processes,
    Quiet,
    Rate,
    Seed,
    Starts,
    progress,
    refuse_given,
)
from hydroopt.errors import ProblemError

if TYPE_CHECKING:
    from hydroopt.excitation.motion.basis import Basis
    from hydroopt.machine.machine import Machine


def excite(
    machine: MachineName,
    output: Directory,
    log: Annotated[list[Path] | None, typer.Option(
        metavar="LOG...",
        help="Log already measured, to which the motion is to add; repeatable.")] = None,
    map_file: MapFile = None,
    duration: Annotated[float, typer.Option(help="Duration of the random or designed motion [s].")] = 33.0,
    period: Annotated[float | None, typer.Option(
        help="Of the Fourier series [s]; else what entry and exit leave of the duration.")] = None,
    harmonics: Annotated[int | None, typer.Option(help="Of the Fourier series; 10 if not given.", min=1)] = None,
    blend: Annotated[float | None, typer.Option(
        help="Of the Fourier series' entry and of its exit [s]; 2 if not given.", min=0.1)] = None,
    pieces: Annotated[int | None, typer.Option(
        help="A spline of the fifth degree of so many pieces instead of the Fourier series.", min=1)] = None,
    rest: Annotated[list[str] | None, typer.Option(
        help="Joint that rests, JOINT=POSITION with unit, e.g. 'swing=0 deg'; repeatable.")] = None,
    rate: Rate = None,
    criterion: Annotated[str | None, typer.Option(help="D, A, E or condition; D if not given.")] = None,
    focus: Focus = None,
    priors: Priors = False,
    starts: Starts = 16,
    processes: Processes = None,
    seconds: Annotated[float | None, typer.Option(
        help="After which the best motion so far is taken; the result then depends on the computer's speed.",
        min=1.0)] = None,
    seed: Seed = 0,
    parquet: AsParquet = False,
    parameter_set: ParameterSetName = None,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Design the motion with the most information: DIR gets it, the accuracy to expect, and C code.

    Ctrl-C ends the search and keeps the best motion so far.

    Example: hydroopt excite cat215b -o out/drive
    """
    from hydroopt.codegen import parameter_source
    from hydroopt.codegen.folder import Code
    from hydroopt.codegen.routines import DesignedMotion
    from hydroopt.excitation.motion.design import excitation_problem
    from hydroopt.files import refuse_directory
    from hydroopt.logs.stream import open_log
    from hydroopt.report import excitation as report
    from hydroopt.results.json_file import FILES, Job
    from hydroopt.solving import solve

    began = time.perf_counter()
    if pieces is not None:
        refuse_given({"--period": period, "--harmonics": harmonics, "--blend": blend}, "a spline has none",
                     "leave it out, or --pieces")
    if not log:
        refuse_given({"--map": map_file}, "there is no log that it could describe", "leave it out, or give --log")
    refuse_directory(output, (FILES[Job.EXCITATION], "report.html", "trajectory.csv", "trajectory.parquet"))
    described, origin = parameter_source.read(machine, parameter_set=parameter_set)
    basis, resting = _basis(duration, pieces, period, harmonics or 10, blend or 2.0), _resting(described, rest or ())
    with progress(f"stating limits and information of {described.name}'s motion", quiet) as say:
        logs = [open_log(path, mapping=map_file) for path in log or ()]
        problem = excitation_problem(described, basis, criterion=criterion or "D", focus=focus or (), priors=priors,
                                     logs=logs, rate=rate, resting=resting)
        say("taking the first steps of each start")
        motion = solve(problem, starts=starts, seed=seed, seconds=seconds, processes=processes or os.cpu_count() or 1,
                       progress=lambda text, part=None: say(text, None if part is None else 0.8 * part))
        say("computing the expected accuracy, writing the report and the code", 0.8)
        code = Code(described, origin, routines=["excitation"],
                    designed_motion=DesignedMotion(motion.function, basis.duration))
        pages: dict[str, str | bytes | None] = {"report.html": report.render(motion)}
        pages |= {f"c/{name}": text for name, text in code.files_for(output / "c").items()}
        motion.save(output, pages=pages, wall_s=time.perf_counter() - began, parquet=parquet)
    print_answer(motion, output, quiet=quiet, as_json=as_json)


def _basis(duration: float, pieces: int | None, period: float | None, harmonics: int, blend: float) -> Basis:
    from hydroopt.excitation.motion.basis import Fourier, Spline

    if not 0 < duration < 1e5:
        raise ProblemError(f"a motion cannot take {duration:g} s", where="--duration", remedy="give some seconds")
    if pieces is not None:
        return Spline(duration, pieces)
    left = duration - 2 * blend
    period = left if period is None else period
    if not 0 < period <= left * (1 + 1e-9):
        raise ProblemError(f"a period of {period:g} s does not fit into {duration:g} s with an entry and an exit of "
                           f"{blend:g} s", where="--duration" if left <= 0 else "--period",
                           remedy="give a longer duration, or a shorter period or blend")
    return Fourier(period, harmonics, int(left / period * (1 + 1e-9)), blend)


def _resting(machine: Machine, stated: Sequence[str]) -> dict[str, float]:
    from hydroopt.units import to_si

    at = {}
    for text in stated:
        joint, found, value = (part.strip() for part in text.partition("="))
        if not found:
            raise ProblemError(f"'{text}' is not JOINT=POSITION", where="--rest",
                               remedy="write e.g. --rest 'swing=0 deg'")
        at[joint] = to_si(value, machine.channel_units.get(f"{joint}.q", "rad"), where=f"--rest {joint}")
    return at
