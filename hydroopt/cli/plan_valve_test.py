"""`hydroopt plan-valve-test`: the steps from which valves are identified."""

from __future__ import annotations

from typing import Annotated

import typer

from hydroopt.cli.run import Run, command
from hydroopt.cli.terminal import echo


@command("output", "force", "quiet")
def plan_valve_test(
    run: Run,
    per_actuator: Annotated[float, typer.Option(help="Duration of the test of each actuator [s].")] = 10.0,
) -> None:
    """Plan a test of the valves: DIR gets sheet.txt to drive by, and steps.csv for a controller.

    Bodies and valves are identified from its log. `simulate --valve-test` gives one.

    Example: hydroopt plan-valve-test cat215b -o out/test
    """
    from hydroopt.control.valve_test import valve_test
    from hydroopt.model.plant import Plant
    from hydroopt.support.files import write_files

    test = valve_test(Plant(run.machine), seconds=per_actuator)
    sheet = test.sheet()
    write_files(run.output, {"sheet.txt": sheet, "steps.csv": test.table()})
    if not run.quiet:
        echo(sheet)
