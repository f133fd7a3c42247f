"""`hydroopt measure-up`: the fewest readings by hand that determine where the tip is."""

from __future__ import annotations

from typing import Annotated

import typer

from hydroopt.cli.options import Minutes, SetUp, minutes_of
from hydroopt.cli.run import ANSWER, Run, command


@command(*ANSWER, "fix", "reserve", "seed")
def measure_up(
    run: Run,
    tip_std: Annotated[str, typer.Option(help="Standard deviation of the tip to reach, with unit, such as '10 mm'.")],
    minutes: Minutes = None,
    setup: SetUp = None,
) -> None:
    """Plan the fewest readings by tape, level, datum and total station for a stated accuracy of the tip: sheet.txt.

    DIR also gets poses.csv to fill in for `calibrate`.

    Example: hydroopt measure-up excavator.toml --tip-std '10 mm' -o out/sheet
    """
    from hydroopt.excitation.selection.measure_up import fewest_readings, measure_up_problem
    from hydroopt.units import to_si

    spent = minutes_of(minutes or ())
    with run.progress(f"planning a measure-up of {run.machine.name}") as say:
        problem = measure_up_problem(run.machine, to_si(tip_std, "m", where="--tip-std"), minutes=spent,
                                     setups=setup or ("",), reserves=run.reserves)
        if run.fix:
            problem = problem.fixing(**run.fixed(problem.poses.parameters))
        plan = run.saved(fewest_readings(problem, seed=run.seed, progress=say), say)
    run.show(plan, plan.sheet())
