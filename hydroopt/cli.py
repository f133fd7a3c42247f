"""The command `hydroopt`: show, simulate, identify, calibrate, excite, codegen."""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from hydroopt import synthetic
from hydroopt.codegen import origin as codegen_origin
from hydroopt.codegen.folder import Code
from hydroopt.codegen.routines import ROUTINES
from hydroopt.description import load_machine
from hydroopt.errors import HydrooptError, LogError, ProblemError, SolverError
from hydroopt.estimation.appraisal import leavable
from hydroopt.estimation.calibration import METHODS as CALIBRATION_METHODS
from hydroopt.estimation.calibration import calibrate as solve_calibration
from hydroopt.estimation.closure import CalibrationProblem, calibration_problem
from hydroopt.estimation.experiment import reading
from hydroopt.estimation.problem import Loss, identification_problem
from hydroopt.estimation.solve import METHODS, Method, solve
from hydroopt.estimation.verdict import doubts
from hydroopt.excitation.poses import plan_poses
from hydroopt.files import write_files
from hydroopt.machine import Machine
from hydroopt.model.build import Model
from hydroopt.parts import Cylinder, Motor
from hydroopt.report import folder
from hydroopt.report.facts import machine_facts
from hydroopt.signals.conditioning import Butterworth, Fourier, Smoothing, SmoothingSpline, condition
from hydroopt.signals.log import Log, read_log
from hydroopt.signals.poses import Poses, joined, read_pose_files
from hydroopt.units import to_si

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, help=(
    "Calibrate hydraulically actuated manipulators: a machine file and logs in, a model with error bars out."))

MachineName = Annotated[str, typer.Argument(
    metavar="MACHINE", help="A bundled machine's name or a .toml or .urdf file.")]
ParameterSetName = Annotated[str | None, typer.Option("--set", help="Which of the file's sets of inertial parameters.")]
Quiet = Annotated[bool, typer.Option("--quiet", help="No progress and no summary.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]
Directory = Annotated[Path, typer.Option("-o", "--output", help="Directory that receives everything.")]
MapFile = Annotated[Path | None, typer.Option(
    "--map", help="TOML file that says which column is what in foreign logs.")]
Treat = Annotated[list[str] | None, typer.Option(
    help="What to do about a finding, KIND=ACTION, e.g. nan=drop, spike=interpolate, gap=keep; repeatable.")]


@contextmanager
def _progress(what: str, quiet: bool) -> Iterator[Callable[[str], None]]:
    """A spinner on a terminal's error stream while something takes its time; what is given says what goes on now."""
    with Console(stderr=True, quiet=quiet).status(what) as status:
        yield status.update


@app.command()
def show(machine: MachineName, parameter_set: ParameterSetName = None, as_json: AsJson = False) -> None:
    """Show a machine: links, actuators with their geometry, sensors, and which parameters a motion can reveal."""
    described = load_machine(machine, parameter_set=parameter_set)
    facts = machine_facts(described)
    if as_json:
        typer.echo(json.dumps(facts, indent=1))
        return
    console = Console()
    console.print(f"[bold]{described.name}[/bold] {escape(described.description)}")
    console.print(_table("Joints", facts["joints"]),
                  _table("Cylinders", [_cylinder_row(cylinder) for cylinder in facts["cylinders"]]),
                  _table("Sensors (standard deviation of a reading)", facts["sensors"]),
                  _table("Parameters", facts["parameters"]))
    seen = facts["identifiability"]
    console.print(f"Of {len(facts['parameters'])} parameters a motion without noise shows {seen['full']} alone and "
                  f"{seen['combination']} in combination ({seen['rank']} base parameters); {seen['none']} leave "
                  "no trace.")
    if lines := facts["calibration"]["lines"]:
        console.print("[bold]Kinematic calibration[/bold]")
        for line in lines:
            console.print(escape(line), soft_wrap=True)


def _cylinder_row(facts: dict[str, Any]) -> dict[str, Any]:
    """The same for a screen, in fewer columns."""
    return {"cylinder": facts["cylinder"], "joint": facts["joint"],
            "areas [cm²]": f"{facts['head_area_cm2']:.1f} / {facts['rod_area_cm2']:.1f}",
            "length [m]": f"{facts['length_min_m']:.3f} … {facts['length_max_m']:.3f}",
            "lever arm [m]": f"{facts['lever_arm_min_m']:.3f} … {facts['lever_arm_max_m']:.3f}"}


def _table(title: str, rows: Any) -> Table:
    table = Table(title=title, title_justify="left", header_style="bold")
    for key in rows[0] if rows else ():
        table.add_column(escape(key), no_wrap=True)
    for row in rows:
        table.add_row(*[f"{v:.6g}" if isinstance(v, float) else str(v) for v in row.values()])
    return table


@app.command()
def simulate(
    machine: MachineName,
    output: Directory,
    motion: Annotated[Path | None, typer.Option(
        help="Log whose joint positions are to be followed; else random.")] = None,
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
    with _progress("simulating", quiet):
        path = (_random(model, duration, rate, seed) if motion is None
                else _followed(described, read_log(motion, mapping=map_file)))
        psi = (synthetic.random_truth(model, seed if truth_seed is None else truth_seed) if truth == "random"
               else model.parameters.nominal)
        log = synthetic.simulate(model, path, psi, noise=noise, seed=seed, name=described.name)
    named = dict(zip(model.parameters.names, psi.tolist(), strict=True))
    write_files(output, {})  # the directory
    file = output / ("log.parquet" if parquet else "log.csv")
    log.write(file)
    write_files(output, {"truth.json": json.dumps(
        {"machine": described.name, "sha256": described.sha256, "seed": seed, "noise": noise, "parameters": named},
        indent=1)})
    if not quiet:
        typer.echo(f"{file}: {len(log.t)} samples, channels {', '.join(log.channels)}")


def _random(model: Model, duration: float | None, rate: float | None, seed: int) -> synthetic.Trajectory:
    sensors = [model.machine.sensor(f"{joint}.q") for joint in model.machine.joints]
    stated = max((sensor.rate for sensor in sensors if sensor and sensor.rate), default=50.0)
    return synthetic.random_trajectory(model, duration=33.28 if duration is None else duration,
                                       rate=stated if rate is None else rate, seed=seed)


def _followed(machine: Machine, log: Log) -> synthetic.Trajectory:
    positions = np.column_stack([reading(machine, log, f"{joint}.q") for joint in machine.joints])
    for k, joint in enumerate(machine.joints):
        lower, upper = machine.link(joint).joint.range
        beyond = np.flatnonzero((positions[:, k] < lower) | (positions[:, k] > upper))
        if beyond.size:
            raise LogError(f"{joint}.q leaves the joint's range at sample {log.sample[beyond[0]]}", where=log.path,
                           remedy="correct the motion or the joint's limits")
    smooth = condition(log.t, positions, log.segment, SmoothingSpline(bandwidth=machine.bandwidth), where=log.path)
    return synthetic.Trajectory(smooth.t, smooth.q, smooth.qd, smooth.qdd)


@app.command()
def identify(
    machine: MachineName,
    logs: Annotated[list[Path], typer.Argument(metavar="LOG...", help="Logs to learn from (.csv, .parquet, .mat).")],
    output: Directory,
    validate: Annotated[list[Path] | None, typer.Option(help="Log to judge the estimate by; repeatable.")] = None,
    holdout: Annotated[float, typer.Option(help="Part of the end of every log that is held out to judge by.",
                                           min=0.0, max=0.9)] = 0.0,
    map_file: MapFile = None,
    treat: Treat = None,
    method: Annotated[str, typer.Option(help=f"One of {', '.join(METHODS)}.")] = "sdp",
    loss: Annotated[str, typer.Option(help="squares, huber or student_t.")] = "squares",
    smoothing: Annotated[str, typer.Option(help=(
        "spline (weight from the stated noise), spline:cv (cross-validated), fourier:PERIOD:HARMONICS or "
        "butterworth:HZ."))] = "spline",
    bandwidth: Annotated[float | None, typer.Option(help="Highest frequency of the motion [Hz], for spline.")] = None,
    tolerance: Annotated[float, typer.Option(help="Singular value, relative to the largest, that counts as zero.",
                                             min=0.0, max=1.0)] = 1e-7,
    ridge: Annotated[float | None, typer.Option(help="Strength of ridge regression; else cross-validated.",
                                                min=0.0)] = None,
    reduced: Annotated[bool, typer.Option("--reduced", help="Leave out the inertia of barrels and rods.")] = False,
    seed: Annotated[int, typer.Option(help="Of the sampling of intervals.", min=0)] = 0,
    parameter_set: ParameterSetName = None,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Identify masses, inertias, friction and offsets: DIR gets estimate.json, report.html, the calibrated machine."""
    began = time.perf_counter()
    described = load_machine(machine, parameter_set=parameter_set)
    chosen = _method(method)
    if ridge is not None and chosen != "ridge":
        raise ProblemError(f"the method '{method}' takes no strength", where="--ridge",
                           remedy="leave it out or choose --method ridge")
    way, treatment, limits = _smoothing(smoothing, bandwidth, described), _treatment(treat), _reliefs(described)
    train = [read_log(path, mapping=map_file, treatment=treatment, limits=limits) for path in logs]
    held_out = [read_log(path, mapping=map_file, treatment=treatment, limits=limits) for path in validate or ()]
    if holdout:
        pairs = [log.split(1 - holdout) for log in train]
        train, held_out = [pair[0] for pair in pairs], held_out + [pair[1] for pair in pairs]
    with _progress(f"identifying {described.name}", quiet):
        problem = identification_problem(described, train, held_out, actuator_inertia=not reduced,
                                         smoothing=way)
        problem = problem.with_loss(_one_of(loss, "--loss"))
        try:
            estimate = solve(problem, chosen, tolerance=tolerance, ridge=ridge, seed=seed)
        except SolverError as error:
            folder.save_failure(problem, method, error, output)
            raise
        content = folder.save(estimate, output, wall_s=time.perf_counter() - began)
    if as_json:
        typer.echo(json.dumps(content, indent=1))
    elif not quiet:
        typer.echo(str(estimate))
        for doubt in doubts(estimate):
            typer.echo(f"  ! {doubt}")
        typer.echo(f"{output / 'report.html'}")


@app.command()
def calibrate(
    machine: MachineName,
    logs: Annotated[list[Path], typer.Argument(metavar="LOG...", help="Tables of poses (.csv, .parquet).")],
    output: Directory,
    validate: Annotated[list[Path] | None, typer.Option(help="Table to judge the geometry by; repeatable.")] = None,
    holdout_stage: Annotated[list[str] | None, typer.Option(
        help="Stage that is held out to judge by; repeatable.")] = None,
    map_file: MapFile = None,
    method: Annotated[str, typer.Option(help=f"One of {', '.join(CALIBRATION_METHODS)}.")] = "joint",
    loss: Annotated[str, typer.Option(help="squares, huber or student_t.")] = "squares",
    fix: Annotated[list[str] | None, typer.Option(
        help="Hold a parameter, NAME=VALUE with unit, e.g. 'ball.y=0 m'; repeatable.")] = None,
    starts: Annotated[int, typer.Option(help="From how many places to solve.", min=1)] = 1,
    no_priors: Annotated[bool, typer.Option("--no-priors", help=(
        "The file's confidences say what is unknown, but do not count as measurements."))] = False,
    without_suspects: Annotated[bool, typer.Option("--without-suspects", help=(
        "Solve again without the stages, stretches and poses that do not fit the others."))] = False,
    seed: Annotated[int, typer.Option(help="Of the starts and of the report's workspace.", min=0)] = 0,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Calibrate a machine's geometry from poses: DIR gets estimate.json, report.html, the calibrated machine."""
    began = time.perf_counter()
    described, chosen_loss = load_machine(machine), _one_of(loss, "--loss")
    with _progress("reading poses", quiet) as say:
        poses, held_out = _held_out(read_pose_files(logs, mapping=map_file), holdout_stage or (),
                                    read_pose_files(validate, mapping=map_file) if validate else None)
        problem = calibration_problem(described, poses, held_out, priors=not no_priors).with_loss(chosen_loss)
        problem = _fixed(problem, fix or ())
        what = f"calibrating {described.name}, {int(problem.free.sum())} parameters from "
        before = None
        try:
            say(f"{what}{len(poses)} poses")
            solved = solve_calibration(problem, method, starts=starts, seed=seed)
            if without_suspects and np.any(suspicious := leavable(solved)):
                before = solved
                say(f"{what}the {np.sum(~suspicious)} poses that fit")
                solved = solve_calibration(problem.without(suspicious), method, starts=starts, seed=seed)
        except SolverError as error:
            folder.save_failure(problem, method, error, output)
            raise
        say("writing the report")
        content = folder.save_calibration(solved, output, wall_s=time.perf_counter() - began, seed=seed, before=before)
    if as_json:
        typer.echo(json.dumps(content, indent=1))
    elif not quiet:
        typer.echo(str(solved))
        for doubt in content["doubts"]:
            typer.echo(f"  ! {doubt}")
        typer.echo(f"{output / 'report.html'}")


def _held_out(poses: Poses, stages: Sequence[str], extra: Poses | None) -> tuple[Poses, Poses | None]:
    """Poses to learn from, and those of some stages together with further ones to judge by."""
    known = list(dict.fromkeys(map(str, poses.stage)))
    for stage in stages:
        if stage not in known:
            raise ProblemError(f"no pose is of stage '{stage}'", where="--holdout-stage",
                               remedy=f"use one of {', '.join(known)}")
    aside = np.isin(poses.stage, list(stages))
    if np.all(aside):
        raise ProblemError("no pose is left to learn from", where="--holdout-stage", remedy="hold out fewer stages")
    parts = [*([poses.select(aside)] if stages else ()), *([extra] if extra else ())]
    return poses.select(~aside), joined(parts) if parts else None


def _fixed(problem: CalibrationProblem, stated: Sequence[str]) -> CalibrationProblem:
    values = {}
    for text in stated:
        name, found, value = (part.strip() for part in text.partition("="))
        if not found:
            raise ProblemError(f"'{text}' is not NAME=VALUE", where="--fix", remedy="write e.g. --fix 'ball.y=0 m'")
        values[name] = to_si(value, problem.parameters.units[problem.parameters.index(name)], where=f"--fix {name}")
    return problem.fixing(**values)


@app.command()
def excite(
    machine: MachineName,
    output: Directory,
    poses: Annotated[int, typer.Option(help="Poses to measure in each stage.", min=1)],
    focus: Annotated[list[str] | None, typer.Option(help="A parameter that matters most; repeatable.")] = None,
    seed: Annotated[int, typer.Option(help="Of the postures to choose from.", min=0)] = 0,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Plan the poses of a kinematic calibration: DIR gets sheet.txt, poses.csv and plan.json."""
    described = load_machine(machine)
    with _progress(f"choosing poses for {described.name}", quiet):
        plan = plan_poses(described, poses, focus=focus or (), seed=seed)
    content = {"machine": {"name": described.name, "sha256": described.sha256}, "poses": len(plan.q), "seed": seed,
               "expected": [{"name": name, "unit": unit, "std": float(std) if math.isfinite(std) else None}
                            for name, unit, std in zip(plan.names, plan.units, plan.std, strict=True)],
               "condition_number": plan.condition_number, "log_det": plan.log_det,
               "noise_amplification_index": plan.noise_amplification_index}
    write_files(output, {"sheet.txt": plan.sheet()})
    plan.write(output / "poses.csv")
    write_files(output, {"plan.json": json.dumps(content, indent=1, allow_nan=False)})
    if as_json:
        typer.echo(json.dumps(content, indent=1))
    elif not quiet:
        typer.echo(plan.sheet())


@app.command()
def codegen(
    machine: Annotated[str, typer.Argument(metavar="MACHINE|ESTIMATE_DIR", help=(
        "A machine, or the directory that identify or calibrate wrote."))],
    output: Directory,
    functions: Annotated[list[str] | None, typer.Option(
        help=f"A function to write; repeatable; all if not given: {', '.join(ROUTINES)}.")] = None,
    prefix: Annotated[str | None, typer.Option(help="What all names begin with; else the machine's name.")] = None,
    float32: Annotated[bool, typer.Option("--float32", help="Single precision throughout.")] = False,
    fold_geometry: Annotated[bool, typer.Option("--fold-geometry", help=(
        "Build the geometry into the code: fewer operations, but a calibration needs new code."))] = False,
    parameter_set: ParameterSetName = None,
    quiet: Quiet = False,
) -> None:
    """Write the model as C for a controller: DIR gets a folder that builds and tests itself."""
    described, origin = codegen_origin.read(machine, parameter_set=parameter_set)
    with _progress(f"writing C for {described.name}", quiet):
        code = Code(described, origin, routines=functions or (), name=prefix, single=float32,
                    fold_geometry=fold_geometry)
        files = code.write(output)
    if not quiet:
        typer.echo(f"{output}: {', '.join(files)}")


def _reliefs(machine: Machine) -> dict[str, tuple[float, float]]:
    """Relief pressures as the upper ends of what pressure channels can show."""
    chambers: list[tuple[Cylinder | Motor, tuple[str, str]]] = [
        *((cylinder, ("p_head", "p_rod")) for cylinder in machine.cylinders),
        *((motor, ("p_a", "p_b")) for motor in machine.motors)]
    return {f"{part.name}.{chamber}": (-math.inf, part.relief_pressure) for part, both in chambers
            if part.relief_pressure is not None for chamber in both}


def _treatment(stated: list[str] | None) -> dict[str, str]:
    pairs = {}
    for text in stated or ():
        kind, found, action = text.partition("=")
        if not found:
            raise ProblemError(f"'{text}' is not KIND=ACTION", where="--treat", remedy="write e.g. --treat nan=drop")
        pairs[kind] = action
    return pairs


def _method(text: str) -> Method:
    if text not in METHODS:
        raise ProblemError(f"'{text}' is no method", where="--method", remedy=f"use one of {', '.join(METHODS)}")
    return text


def _one_of(text: str, where: str) -> Loss:
    if text not in ("squares", "huber", "student_t"):
        raise ProblemError(f"'{text}' is no loss", where=where, remedy="use squares, huber or student_t")
    return text  # type: ignore[return-value]


def _smoothing(text: str, bandwidth: float | None, machine: Machine) -> Smoothing:
    if bandwidth is not None and not 0 < bandwidth < math.inf:
        raise ProblemError(f"{bandwidth:g} Hz is no frequency", where="--bandwidth", remedy="give a positive one")
    kind, *numbers = text.split(":")
    if bandwidth is not None and kind in ("fourier", "butterworth"):
        raise ProblemError(f"the smoothing '{text}' takes no bandwidth", where="--bandwidth",
                           remedy="leave it out or choose --smoothing spline")
    try:
        if kind == "spline" and numbers in ([], ["cv"]):
            return SmoothingSpline(numbers == ["cv"], machine.bandwidth if bandwidth is None else bandwidth)
        if kind == "fourier" and len(numbers) == 2:
            return Fourier(float(numbers[0]), int(numbers[1]))
        if kind == "butterworth" and len(numbers) == 1:
            return Butterworth(float(numbers[0]))
    except ValueError:
        pass
    raise ProblemError(f"'{text}' is no way to smooth", where="--smoothing",
                       remedy="use spline, spline:cv, fourier:PERIOD:HARMONICS or butterworth:HZ")


_USAGE_ERROR: type[Exception] = typer.BadParameter.__mro__[1]
"""What typer raises when arguments do not fit: click's UsageError, or the one typer brings along."""


def main() -> None:
    """Run the command; a user's mistake ends in one sentence and exit code 2, a failed solver in 3."""
    code: Any = 130
    arguments = sys.argv[1:]
    try:
        code = app(arguments or ["--help"], standalone_mode=False) or (0 if arguments else 2)
    except HydrooptError as error:
        code = error.exit_code
        typer.echo(f"hydroopt: {_visible(str(error))}", err=True)
    except _USAGE_ERROR as error:
        code = 2
        _explain(error)
    except (KeyboardInterrupt, typer.Abort):
        pass
    if code == 130:  # typer turns an interrupt into this exit code
        typer.echo("hydroopt: interrupted; no result was written", err=True)
    sys.exit(code)


def _explain(error: Any) -> None:
    """Print a wrong use of the command line as one sentence."""
    context = error.ctx
    command = context.command_path if context else "hydroopt"
    what = " ".join(error.format_message().split()).rstrip(".?").replace(". Did you mean", ", did you mean")
    place = command.partition(" ")[2]
    said = f"{place + ': ' if place else ''}{what[:1].lower()}{what[1:]}; see '{command} --help'."
    typer.echo(f"hydroopt: {_visible(said)}", err=True)


def _visible(text: str) -> str:
    """A sentence without what would act on a terminal: a quoted name may hold anything."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


if __name__ == "__main__":
    main()
