"""`hydroopt calibrate`: geometry from poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated

import typer

from hydroopt.cli.options import LOSSES, Holdout, LossName, PoseTables, Priors, Starts, Validation, one_of
from hydroopt.cli.run import ANSWER, Run, command
from hydroopt.errors import ProblemError

if TYPE_CHECKING:
    from hydroopt.logs.poses import Poses


@command(*ANSWER, "map_file", "fix", "seed")
def calibrate(
    run: Run,
    tables: PoseTables,
    validate: Validation = None,
    holdout_stage: Annotated[list[str] | None, typer.Option(
        help="Stage that is held out for validation; repeatable.")] = None,
    holdout: Holdout = 0.0,
    method: Annotated[str, typer.Option(help="Method of estimation: joint or hierarchical.")] = "joint",
    loss: LossName = "squares",
    compliance: Annotated[str | None, typer.Option(help=(
        "Joints that give way under gravity, separated by commas, or none, instead of the file's; 'auto': those whose "
        "compliance predicts held-out poses better."))] = None,
    starts: Starts = 1,
    priors: Priors = True,
    leave_out: Annotated[bool, typer.Option("--without-suspects", help=(
        "Solve again without the stages, stretches and poses that contradict the others."))] = False,
) -> None:
    """Calibrate a machine's geometry from poses: DIR gets estimate.json, report.html, the calibrated machine.

    Example: hydroopt calibrate cat215b poses.csv --holdout 0.25 -o out/geometry
    """
    import numpy as np

    from hydroopt.estimation.kinematic.calibration import calibrate as solve_calibration
    from hydroopt.estimation.kinematic.calibration import inputs_of, without_suspects
    from hydroopt.estimation.kinematic.compliance_choice import choose_compliance, compliant
    from hydroopt.estimation.kinematic.problem import calibration_problem
    from hydroopt.logs.poses import read_pose_files
    from hydroopt.results.json_file import Job

    described, chosen_loss = run.machine, one_of(loss, LOSSES, "loss")
    with run.progress("reading poses") as say:
        poses, held_out = _held_out(read_pose_files(tables, mapping=run.map_file), holdout_stage or (), holdout,
                                    read_pose_files(validate, mapping=run.map_file) if validate else None)
        choice = None
        if compliance is not None:
            words = [word.strip() for word in compliance.split(",")]
            chosen = words[0] if len(words) == 1 and words[0] not in described.tree_joints else ""
            if chosen == "auto":
                say("choosing compliant joints by held-out poses", 0.01)
                choice = choose_compliance(described, poses)
            joints = choice.joints if choice else [] if chosen == "none" else words
            described = compliant(described, poses, joints)
        problem = calibration_problem(described, poses, held_out, priors=priors).with_loss(chosen_loss)
        problem = problem.fixing(**run.fixed(problem.parameters))
        what = f"calibrating {described.name}, {int(problem.free.sum())} parameters from "
        with run.failure_saved(Job.CALIBRATION, method, lambda: inputs_of(problem)):
            say(f"{what}{len(poses)} poses", 0.05)
            solved = solve_calibration(problem, method, starts=starts, seed=run.seed)
            if leave_out and np.any(solved.suspicious):
                say(f"{what}the {np.sum(~solved.suspicious)} poses that agree", 0.45)
                solved = without_suspects(solved, starts=starts)
        solved = run.saved(replace(solved, compliance_choice=choice), say)
    run.show(solved, str(solved) if choice is None else f"{choice}\n{solved}")


def _held_out(poses: Poses, stages: Sequence[str], part: float, extra: Poses | None) -> tuple[Poses, Poses | None]:
    """Training poses, and those of some stages and a part of the others together with further ones for validation."""
    import numpy as np

    from hydroopt.logs.poses import joined

    known = list(dict.fromkeys(map(str, poses.stage)))
    for stage in stages:
        if stage not in known:
            raise ProblemError(f"no pose is of stage '{stage}'", where="--holdout-stage",
                               remedy=f"use one of {', '.join(known)}")
    aside = np.isin(poses.stage, list(stages))
    for stage in set(known) - set(stages):
        own = np.flatnonzero(poses.stage == stage)
        aside[own] = np.diff(np.floor(part * np.arange(len(own) + 1))) > 0
    if np.all(aside):
        raise ProblemError("no training pose is left", where="--holdout-stage", remedy="hold out fewer stages")
    parts = [*([poses.select(aside)] if np.any(aside) else ()), *([extra] if extra else ())]
    return poses.select(~aside), joined(parts) if parts else None
