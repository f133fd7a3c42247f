"""`hydroopt what-next`: the next measurement, by its expected gain per minute."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

from hydroopt.cli.answers import continued, print_answer
from hydroopt.cli.options import (
    AsJson,
    Directory,
    MachineName,
    MotionFile,
    Quiet,
    Reserve,
    Seed,
    progress,
    reserves_of,
)


def what_next(
    machine: MachineName,
    output: Directory,
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
    minutes: Annotated[list[str] | None, typer.Option(metavar="NAME=MINUTES", help=(
        "What a reading takes, such as tape=3; 0 for one that needs no hand; repeatable."))] = None,
    without: Annotated[list[str] | None, typer.Option(metavar="NAME", help=(
        "Measurement that cannot be taken; repeatable."))] = None,
    base_tilt: Annotated[str, typer.Option(help=(
        "Standard deviation by which the base may be off the roll and pitch of the machine file."))] = "0 deg",
    budget: Annotated[float | None, typer.Option(help="Minutes that may be spent.", min=0.0)] = None,
    reserve: Reserve = None,
    least: Annotated[str, typer.Option(help="Gain per minute below which to stop.")] = "0.1 %",
    seed: Seed = 0,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Choose the next measurement by its gain per minute for a stated accuracy: DIR gets sheet.txt.

    Example: hydroopt what-next cat215b --force-std '1 %' -o out/next
    """
    from hydroopt.errors import ProblemError
    from hydroopt.excitation.selection.what_next import plan_next
    from hydroopt.excitation.selection.what_next_problem import what_next_problem
    from hydroopt.logs.log_files import read_log
    from hydroopt.machine.machine_file import load_machine
    from hydroopt.report.what_next import render
    from hydroopt.simulation.reference_motion import reference_motion
    from hydroopt.units import to_si

    began = time.perf_counter()
    described = load_machine(machine)
    targets = {name: to_si(text, unit, where=option) for name, text, unit, option in (
        ("tip", tip_std, "m", "--tip-std"), ("force", force_std, "1", "--force-std"),
        ("load", load_std, "kg", "--load-std")) if text is not None}
    targets |= {name: to_si(text, "kg", where="--mass-std") for name, text in _named(mass_std or (), "--mass-std",
                                                                                   "'boom.m=20 kg'")}
    if not targets:
        raise ProblemError("no accuracy is asked for", where="what-next",
                           remedy="give --tip-std, --force-std, --load-std or --mass-std")
    spent = {}
    for name, text in _named(minutes or (), "--minutes", "tape=3"):
        try:
            spent[name] = float(text)
        except ValueError:
            raise ProblemError(f"'{text}' is not a number of minutes", where="--minutes",
                               remedy="write, for instance, --minutes tape=3") from None
    with progress(f"choosing measurements of {described.name}", quiet) as say:
        problem = what_next_problem(
            machine, answers or (), targets=targets,
            task=None if motion is None else reference_motion(described, read_log(motion)),
            motions=[reference_motion(described, read_log(each)) for each in trajectory or ()], minutes=spent,
            without=without or (), base_tilt=to_si(base_tilt, "rad", where="--base-tilt"), seed=seed,
            reserves=reserves_of(described, reserve or ()))
        plan = plan_next(problem, minutes=float("inf") if budget is None else budget,
                         least=to_si(least, "1", where="--least"), progress=say)
    plan = continued(plan, output)
    plan.save(output, pages={"report.html": render(plan)}, wall_s=time.perf_counter() - began)
    print_answer(plan, output, plan.sheet(), quiet=quiet, as_json=as_json)


def _named(texts: list[str] | tuple[()], option: str, example: str) -> list[tuple[str, str]]:
    """Name and value of NAME=VALUE texts."""
    from hydroopt.errors import ProblemError

    found = []
    for text in texts:
        name, sign, value = (part.strip() for part in text.partition("="))
        if not sign:
            raise ProblemError(f"'{text}' is not NAME=VALUE", where=option,
                               remedy=f"write, for instance, {option} {example}")
        found.append((name, value))
    return found
