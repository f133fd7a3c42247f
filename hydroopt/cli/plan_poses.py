"""`hydroopt plan-poses`: the poses to measure for a kinematic calibration."""

from __future__ import annotations

import time
from typing import Annotated

import typer

from hydroopt.cli.answers import continued, print_answer
from hydroopt.cli.options import (
    AsJson,
    Directory,
    Fixed,
    Focus,
    MachineName,
    PosesEach,
    Priors,
    Quiet,
    Reserve,
    Seed,
    SetUp,
    parameter_values,
    progress,
    reserves_of,
)


def plan_poses(
    machine: MachineName,
    output: Directory,
    poses: PosesEach,
    stage: Annotated[list[str] | None, typer.Option(help="Stage to measure; repeatable; all if not given.")] = None,
    criterion: Annotated[str | None, typer.Option(
        help="D, A, E or condition; D if not given, or A of the focus.")] = None,
    focus: Focus = None,
    priors: Priors = False,
    fix: Fixed = None,
    setup: SetUp = None,
    reserve: Reserve = None,
    candidates: Annotated[int, typer.Option(
        help="Random postures of each stage and fixture to choose from.", min=1)] = 2000,
    seed: Seed = 0,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Plan the poses of a kinematic calibration: DIR gets sheet.txt to measure by, poses.csv to fill in, plan.json.

    Example: hydroopt plan-poses cat215b -n 40 -o out/plan
    """
    from hydroopt.excitation.selection.exchange import fedorov_exchange
    from hydroopt.excitation.selection.pose_problem import pose_problem
    from hydroopt.machine.machine_file import load_machine
    from hydroopt.report.pose_plan import render

    began = time.perf_counter()
    described = load_machine(machine)
    with progress(f"choosing poses for {described.name}", quiet) as say:
        problem = pose_problem(described, poses, stages=stage or None, criterion=criterion, focus=focus or (),
                               priors=priors, setups=setup or ("",),
                               reserves=reserves_of(described, reserve or ()))
        if fix:
            problem = problem.fixing(**parameter_values(fix, problem.parameters))
        plan = continued(fedorov_exchange(problem, candidates=candidates, seed=seed, progress=say), output)
    plan.save(output, pages={"report.html": render(plan)}, wall_s=time.perf_counter() - began)
    print_answer(plan, output, plan.sheet(), quiet=quiet, as_json=as_json)
