"""`hydroopt calibrate-sensors`: IMUs, clocks and geometry from motion and postures at rest."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

from hydroopt.cli.answers import continued, failure_saved, print_answer, refuse_refuted
from hydroopt.cli.options import (
    AsJson,
    Directory,
    MachineName,
    MapFile,
    Quiet,
    Treat,
    logs_read,
    progress,
)


def calibrate_sensors(
    machine: MachineName,
    output: Directory,
    logs: Annotated[list[Path] | None, typer.Argument(metavar="LOG...", help="Logs of motion.")] = None,
    poses: Annotated[list[Path] | None, typer.Option("--at-rest", metavar="FILE...", help=(
        "Tables of postures at rest; rows of one stage and pose are readings of one posture."))] = None,
    geometry: Annotated[bool, typer.Option("--geometry/--mounting", help=(
        "All numbers of the geometry that state a sigma are unknown, or only where IMUs sit."))] = True,
    map_file: MapFile = None,
    treat: Treat = None,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Calibrate IMUs, clocks and geometry by motion and postures: DIR gets the motion and the calibrated machine.

    Example: hydroopt calibrate-sensors excavator_imu motion.csv --at-rest rest.csv -o out/sensors
    """
    from hydroopt.estimation.motion.problem import sensor_problem
    from hydroopt.estimation.motion.sensor_calibration import METHOD
    from hydroopt.logs.poses import read_pose_files
    from hydroopt.machine.machine_file import load_machine
    from hydroopt.report import sensors
    from hydroopt.results.json_file import Job
    from hydroopt.solving import solve

    began, described = time.perf_counter(), load_machine(machine)
    recorded = logs_read(logs or [], described, map_file, treat)
    problem = sensor_problem(described, recorded, [read_pose_files(poses)] if poses else (), geometry=geometry)
    with (progress(f"fitting motion and sensors of {described.name} to all readings", quiet) as say,
          failure_saved(output, Job.SENSORS, described, METHOD)):
        calibration = continued(solve(problem), output)
        say("writing the report", 0.7)
        calibration.save(output, pages={"report.html": sensors.render(calibration)},
                         wall_s=time.perf_counter() - began)
    print_answer(calibration, output, quiet=quiet, as_json=as_json)
    refuse_refuted(calibration, output)
