"""`hydroopt check`: whether logs can be used, what is suspicious, and what they would identify."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hydroopt.cli.answers import print_answer, refuse_refuted
from hydroopt.cli.options import (
    AsJson,
    Bandwidth,
    EstimateFolder,
    MachineName,
    MapFile,
    ParameterSetName,
    Quiet,
    Reserve,
    SmoothingText,
    TrainingLogs,
    Treat,
    logs_read,
    progress,
    refuse_given,
    reserves_of,
    smoothing_of,
)
from hydroopt.cli.terminal import echo
from hydroopt.errors import SolverError

if TYPE_CHECKING:
    from hydroopt.checks.motion import MotionCheck
    from hydroopt.checks.postures import PostureCheck
    from hydroopt.estimation.dynamic.log_check import LogCheck
    from hydroopt.logs.log import Log
    from hydroopt.machine.machine import Machine


def check(
    machine: MachineName,
    logs: TrainingLogs,
    output: Annotated[Path | None, typer.Option("-o", "--output", help=(
        "Directory that receives everything: check.json and a table of the parameters."))] = None,
    map_file: MapFile = None,
    treat: Treat = None,
    smoothing: SmoothingText = "spline",
    bandwidth: Bandwidth = None,
    reserve: Reserve = None,
    estimate: EstimateFolder = None,
    parameter_set: ParameterSetName = None,
    quiet: Quiet = False,
    as_json: AsJson = False,
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
    from hydroopt.excitation.motion.known import identified
    from hydroopt.logs.poses import is_pose_table, read_poses
    from hydroopt.machine.machine_file import load_machine

    began = time.perf_counter()
    described = load_machine(machine, parameter_set=parameter_set)
    reserves = reserves_of(described, reserve or ())
    found: LogCheck | MotionCheck | PostureCheck
    with progress(f"checking {described.name}", quiet) as say:
        say("reading logs", 0.0)
        poses = all(is_pose_table(path) for path in logs)
        read = [] if poses else logs_read(logs, described, map_file, treat)
        say("smoothing and weighting", 0.2)
        if poses:
            refuse_given({"--estimate": estimate, "--treat": treat, "--bandwidth": bandwidth},
                         "these are poses, at rest", "leave it out, or give logs or motions")
            found = check_postures(described, [read_poses(path, mapping=map_file) for path in logs], reserves=reserves)
        elif not _have_forces(described, read):
            known = None if estimate is None else identified(described, estimate)
            found = check_motion(described, read, reserves=reserves,
                                 known=known)
        else:
            refuse_given({"--reserve": reserve, "--estimate": estimate}, "these logs have forces: they are checked for "
                         "an identification", "leave it out, or give motions without forces")
            given = [("--map", map_file), *(("--treat", each) for each in treat or ()), ("--bandwidth", bandwidth),
                     ("--smoothing", smoothing if smoothing != "spline" else None), ("--set", parameter_set)]
            found = replace(check_logs(described, read, smoothing=smoothing_of(smoothing, bandwidth, described)),
                            options=tuple((option, str(value)) for option, value in given if value is not None))
        say("searching for faults", 0.6)
    _answered(found, logs, output, began, quiet=quiet, as_json=as_json)


def _answered(found: LogCheck | MotionCheck | PostureCheck, logs: Sequence[Path], output: Path | None, began: float, *,
              quiet: bool, as_json: bool) -> None:
    """Save and print what was found.

    Raises:
        SolverError: a log contradicts the machine file, or a motion or pose breaks a limit.
    """
    from hydroopt.checks.motion import MotionCheck
    from hydroopt.checks.postures import PostureCheck

    content = found.content(wall_s=time.perf_counter() - began)
    if output is not None:
        found.save(output, wall_s=content["wall_s"])
    if as_json:
        echo(json.dumps(content, indent=1))
    else:
        print_answer(found, output or Path(), quiet=quiet, as_json=False)
    where = output or Path(", ".join(str(path) for path in logs))
    refuse_refuted(found, where)
    if isinstance(found, MotionCheck) and (broken := list(dict.fromkeys(
            each.use.name for each in found.table if each.broken))):
        raise SolverError(f"the motion breaks {', '.join(broken)}", where=str(where),
                          remedy="drive it slower or over less range, or correct the limits in the machine file")
    if isinstance(found, PostureCheck) and (wrong := [each.pose for each in found.poses if each.broken]):
        raise SolverError(f"limits are broken in pose {', '.join(wrong)}", where=str(where),
                          remedy="leave these poses out, or correct the limits in the machine file")


def _have_forces(machine: Machine, logs: Sequence[Log]) -> bool:
    """Whether any log has a channel of an actuator's force, torque or pressure."""
    of_forces = {channel for each in machine.actuators for channel in each.effort_factors}
    return any(channel in of_forces for log in logs for channel in log.channels)
