"""`hydroopt measure-up`: the fewest readings by hand that determine where the tip is."""

from __future__ import annotations

import time
from typing import Annotated

import typer

from hydroopt.cli.answers import continued, print_answer
from hydroopt.cli.options import (
    AsJson,
    Directory,
    Fixed,
    MachineName,
    Quiet,
    Reserve,
    Seed,
    SetUp,
    parameter_values,
    progress,
    reserves_of,
)


def measure_up(
    machine: MachineName,
    output: Directory,
    tip_std: Annotated[str, typer.Option(help="Standard deviation of the tip to reach, with unit, such as '10 mm'.")],
    minutes: Annotated[list[str] | None, typer.Option(metavar="NAME=MINUTES", help=(
        "What a reading takes, such as tape=3; 0 for one that needs no hand; repeatable."))] = None,
    setup: SetUp = None,
    reserve: Reserve = None,
    fix: Fixed = None,
    seed: Seed = 0,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Plan the fewest readings by tape, level, datum and total station for a stated accuracy of the tip: sheet.txt.

    DIR also gets poses.csv to fill in for `calibrate`.

    Example: hydroopt measure-up excavator.toml --tip-std '10 mm' -o out/sheet
    """
    from hydroopt.errors import ProblemError
    from hydroopt.excitation.selection.measure_up import fewest_readings, measure_up_problem
    from hydroopt.machine.machine_file import load_machine
    from hydroopt.report.pose_plan import render
    from hydroopt.units import to_si

    began = time.perf_counter()
    described = load_machine(machine)
    spent = {}
    for text in minutes or ():
        name, _, value = text.partition("=")
        try:
            spent[name] = float(value)
        except ValueError:
            raise ProblemError(f"'{text}' is not NAME=MINUTES", where="--minutes",
                               remedy="write, for instance, --minutes tape=3") from None
    with progress(f"planning a measure-up of {described.name}", quiet) as say:
        problem = measure_up_problem(described, to_si(tip_std, "m", where="--tip-std"), minutes=spent,
                                     setups=setup or ("",), reserves=reserves_of(described, reserve or ()))
        if fix:
            problem = problem.fixing(**parameter_values(fix, problem.poses.parameters))
        plan = continued(fewest_readings(problem, seed=seed, progress=say), output)
    plan.save(output, pages={"report.html": render(plan)}, wall_s=time.perf_counter() - began)
    print_answer(plan, output, plan.sheet(), quiet=quiet, as_json=as_json)
