"""`hydroopt plan-poses`: the poses to measure for a kinematic calibration."""

from __future__ import annotations

from typing import Annotated

import typer

from hydroopt.cli.options import Focus, PosesEach, Priors, SetUp
from hydroopt.cli.run import ANSWER, Run, command


@command(*ANSWER, "fix", "reserve", "seed")
def plan_poses(
    run: Run,
    poses: PosesEach,
    stage: Annotated[list[str] | None, typer.Option(help="Stage to measure; repeatable; all if not given.")] = None,
    criterion: Annotated[str | None, typer.Option(
        help="D, A, E or condition; D if not given, or A of the focus.")] = None,
    focus: Focus = None,
    priors: Priors = False,
    setup: SetUp = None,
    candidates: Annotated[int, typer.Option(
        help="Random postures of each stage and fixture to choose from.", min=1)] = 2000,
) -> None:
    """Plan the poses of a kinematic calibration: DIR gets sheet.txt to measure by, poses.csv to fill in, plan.json.

    Example: hydroopt plan-poses cat215b -n 40 -o out/plan
    """
    from hydroopt.excitation.selection.exchange import fedorov_exchange
    from hydroopt.excitation.selection.pose_problem import pose_problem

    with run.progress(f"choosing poses for {run.machine.name}") as say:
        problem = pose_problem(run.machine, poses, stages=stage or None, criterion=criterion, focus=focus or (),
                               priors=priors, setups=setup or ("",), reserves=run.reserves)
        if run.fix:
            problem = problem.fixing(**run.fixed(problem.parameters))
        plan = run.saved(fedorov_exchange(problem, candidates=candidates, seed=run.seed, progress=say), say)
    run.show(plan, plan.sheet())
