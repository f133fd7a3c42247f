"""Options that several commands share, and the progress display."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hydroopt.errors import ProblemError
from hydroopt.machine.bundled_files import bundled_files

if TYPE_CHECKING:
    from hydroopt.limits.reserves import Reserves
    from hydroopt.logs.smoothing import Smoothing
    from hydroopt.machine.machine import Machine
    from hydroopt.parameters.parameter_set import ParameterSet


def _machines(incomplete: str) -> list[str]:
    """Bundled machines whose names begin so, for the completion of a shell."""
    return [name for name in bundled_files() if name.startswith(incomplete)]


MachineName = Annotated[str, typer.Argument(
    metavar="MACHINE", autocompletion=_machines, help=(
        "A bundled machine's name, or a .toml, .urdf, .xml (MJCF) or .sdf file."))]
MachineOrFolder = Annotated[str, typer.Argument(metavar="MACHINE|DIR", help=(
    "A machine, or the directory that identify or calibrate wrote."))]
ParameterSetName = Annotated[str | None, typer.Option(
    "--set", help="Which of the machine file's sets of inertial parameters to use.")]
Force = Annotated[bool, typer.Option("--force", help=(
    "Accept a machine or an answer that is suspect: what is made of it says so, and the exit code is 0."))]
Quiet = Annotated[bool, typer.Option("--quiet", help="Print no progress and no summary.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]
Directory = Annotated[Path, typer.Option("-o", "--output", help="Directory that receives everything.")]
MapFile = Annotated[Path | None, typer.Option(
    "--map", help="TOML file that maps the columns of foreign logs to channels and units.")]
GainError = Annotated[float | None, typer.Option(help=(
    "Standard deviation of the relative error of each actuator's force readings, by areas and sensors' scales, e.g. "
    "0.02; by default the machine file's [faults] gain, or none."))]
Treat = Annotated[list[str] | None, typer.Option(
    help="How to treat a finding, KIND=ACTION, e.g. nan=drop, spike=interpolate, gap=keep; repeatable.")]

AsParquet = Annotated[bool, typer.Option("--parquet", help="Write Parquet instead of CSV.")]
TrainingLogs = Annotated[list[Path], typer.Argument(
    metavar="LOG...", help="Training logs, or directories of logs of one recording.")]
PoseTables = Annotated[list[Path], typer.Argument(metavar="POSES...", help="Pose tables (.csv, .parquet, .xlsx).")]
Validation = Annotated[list[Path] | None, typer.Option(
    "--validate", metavar="FILE...", help="Logs or pose tables for validation only.")]
Holdout = Annotated[float, typer.Option(
    min=0.0, max=0.9,
    help="Part of the data held out for validation: the end of every log; poses of every stage, evenly spread.")]
SinglePrecision = Annotated[bool, typer.Option("--float32", help="Single precision throughout the generated C.")]
Sizes = Annotated[bool, typer.Option("--sizes", help=(
    "State in README.md how much stack and flash the generated C takes, and how many instructions on a Cortex-M4F and "
    "M7."))]
LOSSES = ("squares", "huber", "student_t")
LossName = Annotated[str, typer.Option(help="squares, huber or student_t.")]
Seed = Annotated[int, typer.Option(help="Seed of all that is drawn at random.", min=0)]
Starts = Annotated[int, typer.Option(help="Number of initial guesses of the search.", min=1)]
Priors = Annotated[bool, typer.Option("--priors/--no-priors", help=(
    "Whether the machine file's confidences count as measurements."))]
PosesEach = Annotated[int, typer.Option("-n", "--poses", help="Poses of each stage at each fixture.", min=1)]
Noise = Annotated[bool, typer.Option(help="Whether readings have the sensor errors that the machine file states.")]
Processes = Annotated[int | None, typer.Option(help="Processes at a time; the number of cores if not given.", min=1)]
MotionFile = Annotated[Path | None, typer.Option("--motion", help=(
    "Log whose joint positions are followed, such as excite's trajectory.csv; a random motion if not given."))]
Fixed = Annotated[list[str] | None, typer.Option(metavar="NAME[=VALUE]", help=(
    "Hold a parameter at a value with unit, e.g. 'ball.y=0 m', or at its nominal one; repeatable."))]
Focus = Annotated[list[str] | None, typer.Option(help=(
    "Parameter that alone counts; for excite also a part, payload or friction; repeatable."))]
SetUp = Annotated[list[str] | None, typer.Option("--setup", help=(
    "Set-up of instruments whose pose is not known; repeatable; each stage is measured in all."))]
Minutes = Annotated[list[str] | None, typer.Option(metavar="NAME=MINUTES", help=(
    "What a reading takes, such as tape=3; 0 for one that needs no hand; repeatable."))]
Rate = Annotated[float | None, typer.Option(help=(
    "Samples per second [Hz]; the highest that the machine file states for a joint's sensor, or 50, if not given."))]
SmoothingText = Annotated[str, typer.Option("--smoothing", help=(
    "spline (weight from the stated noise), spline:cv (cross-validated), two-weights:SPEED:ACCELERATION (the thesis's "
    "filter: weights on their squares, s^2 and s^4), fourier:PERIOD:HARMONICS or "
    "butterworth:HZ."))]
Bandwidth = Annotated[float | None, typer.Option(
    help="Highest frequency of the motion [Hz], for spline; that of the machine file if not given.")]


Reserve = Annotated[list[str] | None, typer.Option("--reserve", metavar="PART|KIND=AMOUNT", help=(
    "What is kept unused: '15 %' of flow, pressure and tipping (10 % if not given), or one kind, such as "
    "'clearance=0.5 m' to ground and obstacles (0.3 m), 'between=0.2 m' between the machine's own parts (0.1 m), "
    "'tracking=1 %' of joints' ranges, of which plans keep three times (0.5 %), 'people=3 m' beyond the reach (2 m), "
    "'tipping=20 %' or 'certainty=99.9 %' under uncertain masses (99 %); repeatable."))]
EstimateFolder = Annotated[Path | None, typer.Option("--estimate", metavar="DIR", help=(
    "Directory that identify wrote from this machine file: pressures, valves and tipping keep reserves under what it "
    "leaves uncertain, instead of the file's confidences."))]


def one_of(text: str, choices: Sequence[str], noun: str) -> Any:
    """The choice that the option of this name states.

    Raises:
        ProblemError: there is no such choice.
    """
    if text not in choices:
        raise ProblemError(f"the {noun} '{text}' does not exist", where=f"--{noun}",
                           remedy=f"use {', '.join(choices[:-1])} or {choices[-1]}")
    return text


def reserves_of(machine: Machine, stated: Sequence[str]) -> Reserves:
    """The reserves that --reserve states.

    Raises:
        ProblemError: there is no such kind, a reserve leaves nothing, or the machine file does not limit what it is of.
        UnitError: an amount has no unit, or one of another kind.
    """
    from hydroopt.limits.reserves import Reserves

    kinds = {text.partition("=")[0].strip() for text in stated if "=" in text}
    if "clearance" in kinds and machine.ground is None and not machine.obstacles:
        raise ProblemError("the machine file states neither ground nor obstacles to keep clear of", where="--reserve",
                           remedy="state 'ground', the height of the ground in the base frame, or leave it out")
    if "tipping" in kinds and machine.footprint is None:
        raise ProblemError("the machine file states no footprint over whose edges it could tip", where="--reserve",
                           remedy="state 'footprint', or leave it out")
    return Reserves.stated(stated)


def refuse_given(options: Mapping[str, object], why: str, remedy: str) -> None:
    """Refuse options that would have no effect: those of these values by name that are not None.

    Raises:
        ProblemError: one of them was given.
    """
    for option, value in options.items():
        if value is not None:
            raise ProblemError(why, where=option, remedy=remedy)


def reliefs(machine: Machine) -> dict[str, tuple[float, float]]:
    """Ranges [Pa] of pressure channels by name: a chamber's pressure does not exceed the stated relief pressure."""
    return {chamber: (-math.inf, part.relief_pressure) for part in machine.hydraulic_actuators
            if part.relief_pressure is not None for chamber in part.chambers}


def treatment_of(stated: list[str] | None) -> dict[str, str]:
    """Actions by kind of finding, from KIND=ACTION texts.

    Raises:
        ProblemError: a text has another form.
    """
    return named_values(stated or (), "--treat", "nan=drop", "KIND=ACTION")


def named_values(stated: Sequence[str], option: str, example: str, form: str = "NAME=VALUE") -> dict[str, str]:
    """Values by name, from texts of such a form.

    Raises:
        ProblemError: a text has another form.
    """
    found = {}
    for text in stated:
        name, sign, value = (part.strip() for part in text.partition("="))
        if not sign:
            raise ProblemError(f"'{text}' is not {form}", where=option,
                               remedy=f"write, for instance, {option} {example}")
        found[name] = value
    return found


def minutes_of(stated: Sequence[str]) -> dict[str, float]:
    """Minutes that readings take, by name.

    Raises:
        ProblemError: a text has another form.
    """
    spent = {}
    for name, text in named_values(stated, "--minutes", "tape=3").items():
        try:
            spent[name] = float(text)
        except ValueError:
            raise ProblemError(f"'{text}' is not a number of minutes", where="--minutes",
                               remedy="write, for instance, --minutes tape=3") from None
    return spent


def smoothing_of(text: str, bandwidth: float | None, machine: Machine) -> Smoothing:
    """The smoothing that an option names.

    Raises:
        ProblemError: there is no such smoothing, or the bandwidth is not positive or has no effect.
    """
    from hydroopt.logs.smoothing import Butterworth, Fourier, SmoothingSpline, TwoWeights

    if bandwidth is not None and not 0 < bandwidth < math.inf:
        raise ProblemError(f"a bandwidth of {bandwidth:g} Hz is not positive and finite", where="--bandwidth",
                           remedy="give a positive frequency")
    kind, *numbers = text.split(":")
    if bandwidth is not None and kind in ("fourier", "butterworth", "two-weights"):
        raise ProblemError(f"the smoothing '{text}' takes no bandwidth", where="--bandwidth",
                           remedy="leave it out or choose --smoothing spline")
    try:
        if kind == "spline" and numbers in ([], ["cv"]):
            return SmoothingSpline(numbers == ["cv"], machine.bandwidth if bandwidth is None else bandwidth)
        if kind == "fourier" and len(numbers) == 2:
            return Fourier(float(numbers[0]), int(numbers[1]))
        if kind == "butterworth" and len(numbers) == 1:
            return Butterworth(float(numbers[0]))
        if kind == "two-weights" and len(numbers) == 2:
            return TwoWeights(float(numbers[0]), float(numbers[1]))
    except ValueError:
        pass
    raise ProblemError(f"the smoothing '{text}' does not exist", where="--smoothing",
                       remedy="use spline, spline:cv, two-weights:SPEED:ACCELERATION, fourier:PERIOD:HARMONICS or "
                              "butterworth:HZ")


def parameter_values(stated: Sequence[str], parameters: ParameterSet) -> dict[str, float]:
    """Values [SI] of parameters that --fix NAME=VALUE holds, or --fix NAME at its nominal value.

    Raises:
        ProblemError: there is no such parameter.
        UnitError: the value has no unit, or one of another kind.
    """
    from hydroopt.units import to_si

    values = {}
    for text in stated:
        name, found, value = (part.strip() for part in text.partition("="))
        k = parameters.index(name)
        values[name] = to_si(value, parameters.units[k], where=f"--fix {name}") if found else float(
            parameters.nominal[k])
    return values
