"""`hydroopt check`: whether logs can be used, what is suspicious, and what they would identify."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hydroopt.cli.options import EstimateFolder, TrainingLogs, refuse_given
from hydroopt.cli.run import LOGS, SMOOTHING, Run, command, print_answer, refuse_suspect
from hydroopt.cli.terminal import echo
from hydroopt.errors import SolverError

if TYPE_CHECKING:
    from hydroopt.checks.motion import MotionCheck
    from hydroopt.checks.postures import PostureCheck
    from hydroopt.estimation.dynamic.log_check import LogCheck
    from hydroopt.logs.log import Log
    from hydroopt.machine.machine import Machine


@command(*LOGS, *SMOOTHING, "reserve", "force", "quiet", "as_json")
def check(
    run: Run,
    logs: TrainingLogs,
    output: Annotated[Path | None, typer.Option("-o", "--output", help=(
        "Directory that receives everything: check.json and a table of the parameters."))] = None,
    estimate: EstimateFolder = None,
) -> None:
    """Check logs before identifying, or motions before driving: what they determine, and which limits they break.

    A log without forces is a motion: every limit that it uses or breaks is listed with time, place and amount. Of a
    table of poses, such as a plan's postures.csv, those that break a limit or use a reserve are named. Ends with exit
    code 3 if a log contradicts the machine file as it is read, or a motion or a pose breaks a limit.

    Example: hydroopt check cat215b out/run/log.csv
    """
    from hydroopt.checks.motion import check_motion
    from hydroopt.checks.postures import check_postures
    from hydroopt.estimation.dynamic.log_check import check_logs
    from hydroopt.excitation.motion.expected_accuracy import identified
    from hydroopt.logs.poses import is_pose_table, read_poses

    described, reserves = run.machine, run.reserves
    found: LogCheck | MotionCheck | PostureCheck
    with run.progress(f"checking {described.name}") as say:
        say("reading logs", 0.0)
        poses = all(is_pose_table(path) for path in logs)
        read = [] if poses else run.read(logs)
        say("smoothing and weighting", 0.2)
        if poses:
            refuse_given({"--estimate": estimate, "--treat": run.treat, "--bandwidth": run.bandwidth},
                         "these are poses, at rest", "leave it out, or give logs or motions")
            found = check_postures(described, [read_poses(path, mapping=run.map_file) for path in logs],
                                   reserves=reserves)
        elif not _have_forces(described, read):
            known = None if estimate is None else identified(described, estimate)
            found = check_motion(described, read, reserves=reserves, known=known)
        else:
            refuse_given({"--reserve": run.reserve, "--estimate": estimate},
                         "these logs have forces: they are checked for an identification",
                         "leave it out, or give motions without forces")
            given = [("--map", run.map_file), *(("--treat", each) for each in run.treat or ()),
                     ("--bandwidth", run.bandwidth), ("--set", run.parameter_set),
                     ("--smoothing", run.smoothing_text if run.smoothing_text != "spline" else None)]
            found = replace(check_logs(described, read, smoothing=run.smoothing),
                            options=tuple((option, str(value)) for option, value in given if value is not None))
        say("searching for faults", 0.6)
    _answered(run, found, logs, output)


def _answered(run: Run, found: LogCheck | MotionCheck | PostureCheck, logs: Sequence[Path],
              output: Path | None) -> None:
    """Save and print what was found.

    Raises:
        SolverError: a log contradicts the machine file, or a motion or pose breaks a limit.
    """
    from hydroopt.checks.motion import MotionCheck
    from hydroopt.checks.postures import PostureCheck

    content = found.content(wall_s=time.perf_counter() - run.began)
    if output is not None:
        found.save(output, wall_s=content["wall_s"])
    if run.as_json:
        echo(json.dumps(content, indent=1))
    elif not run.quiet:
        print_answer(found)
    where = str(output or ", ".join(map(str, logs)))
    if found.refuted:
        refuse_suspect(found, where)
    if isinstance(found, MotionCheck) and (broken := list(dict.fromkeys(
            each.use.name for each in found.table if each.broken))):
        raise SolverError(f"the motion breaks {', '.join(broken)}", where=where,
                          remedy="drive it slower or over less range, or correct the limits in the machine file")
    if isinstance(found, PostureCheck) and (wrong := [each.pose for each in found.poses if each.broken]):
        raise SolverError(f"limits are broken in pose {', '.join(wrong)}", where=where,
                          remedy="leave these poses out, or correct the limits in the machine file")


def _have_forces(machine: Machine, logs: Sequence[Log]) -> bool:
    """Whether any log has a channel of an actuator's force, torque or pressure."""
    of_forces = {channel for each in machine.actuators for channel in each.effort_factors}
    return any(channel in of_forces for log in logs for channel in log.channels)
