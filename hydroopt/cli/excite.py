"""`hydroopt excite`: the motion to drive for a dynamic identification."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hydroopt.cli.options import (
    AsParquet,
    EstimateFolder,
    Focus,
    Priors,
    Processes,
    Rate,
    Starts,
    named_values,
    refuse_given,
)
from hydroopt.cli.run import ANSWER, Run, command
from hydroopt.errors import ProblemError

if TYPE_CHECKING:
    from hydroopt.excitation.motion.basis import Basis
    from hydroopt.machine.machine import Machine

HARMONICS, BLEND = 10, 2.0
"""Of the Fourier series, and time [s] of its entry and exit, where nothing is given and the machine is fast enough."""
PERIODS = 2.5
"""Periods of a slow machine's bandwidth that entry and exit take: in 2 smoothing takes twice as much from them."""


@command(*ANSWER, "map_file", "parameter_set", "reserve", "seed")
def excite(
    run: Run,
    log: Annotated[list[Path] | None, typer.Option(
        metavar="LOG...",
        help="Log already measured, to which the motion is to add; repeatable.")] = None,
    duration: Annotated[float, typer.Option(help="Duration of the motion [s].")] = 33.0,
    period: Annotated[float | None, typer.Option(
        help="Of the Fourier series [s]; else what entry and exit leave of the duration.")] = None,
    harmonics: Annotated[int | None, typer.Option(
        help="Of the Fourier series; if not given 10, or as many as stay below half of the machine's bandwidth.",
        min=1)] = None,
    blend: Annotated[float | None, typer.Option(
        help="Of the Fourier series' entry and of its exit [s]; if not given 2, or 2.5 periods of a slow machine.",
        min=0.1)] = None,
    pieces: Annotated[int | None, typer.Option(
        help="A spline of the fifth degree of so many pieces instead of the Fourier series.", min=1)] = None,
    rest: Annotated[list[str] | None, typer.Option(
        help="Joint that rests, JOINT=POSITION with unit, e.g. 'swing=0 deg'; repeatable.")] = None,
    estimate: EstimateFolder = None,
    speed: Annotated[str, typer.Option(help=(
        "Part of the designed speed at which trajectory and C code drive the same path, e.g. '30 %'."))] = "100 %",
    start: Annotated[list[str] | None, typer.Option(metavar="JOINT=POSITION", help=(
        "Where the machine stands, e.g. 'boom=-20 deg', from which an approach to the motion is planned; other joints "
        "stand as the motion starts; repeatable."))] = None,
    rate: Rate = None,
    criterion: Annotated[str | None, typer.Option(help="D, A, E or condition; D if not given.")] = None,
    focus: Focus = None,
    priors: Priors = False,
    starts: Starts = 16,
    processes: Processes = None,
    search_seconds: Annotated[float | None, typer.Option(
        help="Time limit of the search [s]; the best motion so far then depends on the computer's speed.",
        min=1.0)] = None,
    parquet: AsParquet = False,
) -> None:
    """Design the motion with the most information: DIR gets it, the accuracy to expect, and C code.

    Ctrl-C ends the search and keeps the best motion so far.

    Example: hydroopt excite cat215b -o out/drive
    """
    import numpy as np

    from hydroopt.codegen import parameter_source
    from hydroopt.codegen.folder import Code
    from hydroopt.codegen.routines import DesignedMotion
    from hydroopt.excitation.motion.approach import start_of
    from hydroopt.excitation.motion.design import excitation_problem
    from hydroopt.excitation.motion.excitation import refuse_pace
    from hydroopt.excitation.motion.expected_accuracy import identified
    from hydroopt.logs.log_files import read_log
    from hydroopt.report.excitation import render_sheet
    from hydroopt.results.json_file import FILES, Job
    from hydroopt.solving import solve
    from hydroopt.support.files import refuse_places
    from hydroopt.units import to_si

    if pieces is not None:
        refuse_given({"--period": period, "--harmonics": harmonics, "--blend": blend}, "a spline has none",
                     "leave it out, or --pieces")
    if not log:
        refuse_given({"--map": run.map_file}, "there is no log that it could describe", "leave it out, or give --log")
    refuse_places(run.output, (FILES[Job.EXCITATION], "report.html", "sheet.html", "trajectory.csv",
                               "trajectory.parquet", "approach.csv", "approach.parquet"))
    described, origin = parameter_source.read(run.named, parameter_set=run.parameter_set)
    run.trusted(described)
    basis = _basis(duration, pieces, period, harmonics, blend, described.bandwidth)
    resting = _positions(described, rest or (), "--rest")
    pace, standing = to_si(speed, "1", where="--speed"), _positions(described, start or (), "--start")
    refuse_pace(pace)
    start_of(described, standing, np.zeros(len(described.joints)))  # refused before the search
    with run.progress(f"stating limits and information of {described.name}'s motion") as say:
        logs = [read_log(path, mapping=run.map_file) for path in log or ()]
        problem = excitation_problem(described, basis, criterion=criterion or "D", focus=focus or (), priors=priors,
                                     logs=logs, rate=rate, resting=resting, reserves=run.reserves,
                                     known=None if estimate is None else identified(described, estimate))
        say("taking the first steps of each start")
        motion = solve(problem, starts=starts, seed=run.seed, search_seconds=search_seconds,
                       processes=processes or os.cpu_count() or 1,
                       progress=lambda text, part=None: say(text, None if part is None else 0.8 * part))
        motion = motion.at_pace(pace)
        if start:
            say("planning the approach", 0.8)
            motion = motion.approached_from(standing)
        say("computing the expected accuracy, writing the code", 0.8)
        code = Code(described, origin, routines=["excitation"],
                    designed_motion=DesignedMotion(motion.function, motion.problem.basis.duration))
        written = {f"c/{name}": text for name, text in code.files_for(run.output / "c").items()}
        motion = run.saved(motion, say, {"sheet.html": render_sheet(motion), **written}, parquet=parquet)
    run.show(motion)


def _basis(duration: float, pieces: int | None, period: float | None, harmonics: int | None, blend: float | None,
           bandwidth: float | None) -> Basis:
    """The functions of time; what is not given stays well below the bandwidth [Hz], which smoothing would take away."""
    from hydroopt.excitation.motion.basis import Fourier, Spline

    if not 0 < duration < 1e5:
        raise ProblemError(f"a motion cannot take {duration:g} s", where="--duration", remedy="give some seconds")
    if pieces is not None:
        return Spline(duration, pieces)
    if blend is None:
        blend = BLEND if bandwidth is None else max(BLEND, min(PERIODS / bandwidth, duration / 4))
    left = duration - 2 * blend
    period = left if period is None else period
    if not 0 < period <= left * (1 + 1e-9):
        raise ProblemError(f"a period of {period:g} s does not fit into {duration:g} s with an entry and an exit of "
                           f"{blend:g} s", where="--duration" if left <= 0 else "--period",
                           remedy="give a longer duration, or a shorter period or blend")
    if harmonics is None:
        harmonics = HARMONICS if bandwidth is None else min(HARMONICS, max(int(bandwidth / 2 * period), 1))
    return Fourier(period, harmonics, int(left / period * (1 + 1e-9)), blend)


def _positions(machine: Machine, stated: Sequence[str], option: str) -> dict[str, float]:
    """Positions [rad, m] by joint, from JOINT=POSITION texts."""
    from hydroopt.units import to_si

    return {joint: to_si(value, machine.channel_units.get(f"{joint}.q", "rad"), where=f"{option} {joint}")
            for joint, value in named_values(
                stated, option, "'swing=0 deg'", "JOINT=POSITION").items()}
