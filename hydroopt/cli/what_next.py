"""`hydroopt what-next`: the next measurement, by its expected gain per minute."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hydroopt.cli.options import Minutes, MotionFile, minutes_of, named_values
from hydroopt.cli.run import ANSWER, Run, command


@command(*ANSWER, "reserve", "seed")
def what_next(
    run: Run,
    answers: Annotated[list[Path] | None, typer.Argument(metavar="[ANSWER]...", help=(
        "Directories that identify and calibrate wrote for this machine so far."))] = None,
    tip_std: Annotated[str | None, typer.Option(help=(
        "Standard deviation of the tip to reach, with unit, such as '10 mm'."))] = None,
    force_std: Annotated[str | None, typer.Option(help=(
        "Standard deviation of forces to reach, as a part of their range, such as '1 %'."))] = None,
    load_std: Annotated[str | None, typer.Option(help=(
        "Standard deviation of a weighed load to reach, such as '10 kg'."))] = None,
    mass_std: Annotated[list[str] | None, typer.Option(metavar="NAME=MASS", help=(
        "Standard deviation of a mass to reach, such as 'boom.m=20 kg'; repeatable."))] = None,
    motion: MotionFile = None,
    trajectory: Annotated[list[Path] | None, typer.Option(help=(
        "Motion that could be driven to identify, such as excite's trajectory.csv; repeatable; random ones if not "
        "given."))] = None,
    minutes: Minutes = None,
    without: Annotated[list[str] | None, typer.Option(metavar="NAME", help=(
        "Measurement that cannot be taken; repeatable."))] = None,
    base_tilt: Annotated[str, typer.Option(help=(
        "Standard deviation by which the base may be off the roll and pitch of the machine file."))] = "0 deg",
    budget: Annotated[float | None, typer.Option(help="Minutes that may be spent.", min=0.0)] = None,
    least: Annotated[str, typer.Option(help="Gain per minute below which to stop.")] = "0.1 %",
) -> None:
    """Choose the next measurement by its gain per minute for a stated accuracy: DIR gets sheet.txt.

    Example: hydroopt what-next cat215b --force-std '1 %' -o out/next
    """
    from hydroopt.errors import ProblemError
    from hydroopt.excitation.selection.what_next import plan_next
    from hydroopt.excitation.selection.what_next_problem import what_next_problem
    from hydroopt.logs.log_files import read_log
    from hydroopt.simulation.reference_motion import reference_motion
    from hydroopt.units import to_si

    targets = {name: to_si(text, unit, where=option) for name, text, unit, option in (
        ("tip", tip_std, "m", "--tip-std"), ("force", force_std, "1", "--force-std"),
        ("load", load_std, "kg", "--load-std")) if text is not None}
    targets |= {name: to_si(text, "kg", where="--mass-std") for name, text in named_values(
        mass_std or (), "--mass-std", "'boom.m=20 kg'").items()}
    if not targets:
        raise ProblemError("no accuracy is asked for", where="what-next",
                           remedy="give --tip-std, --force-std, --load-std or --mass-std")
    with run.progress(f"choosing measurements of {run.machine.name}") as say:
        problem = what_next_problem(
            run.named, answers or (), targets=targets,
            task=None if motion is None else reference_motion(run.machine, read_log(motion)),
            motions=[reference_motion(run.machine, read_log(each)) for each in trajectory or ()],
            minutes=minutes_of(minutes or ()), without=without or (),
            base_tilt=to_si(base_tilt, "rad", where="--base-tilt"), seed=run.seed, reserves=run.reserves)
        plan = run.saved(plan_next(problem, minutes=float("inf") if budget is None else budget,
                                   least=to_si(least, "1", where="--least"), progress=say), say)
    run.show(plan, plan.sheet())
