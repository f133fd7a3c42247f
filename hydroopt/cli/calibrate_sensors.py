"""`hydroopt calibrate-sensors`: IMUs, clocks and geometry from motion and postures at rest."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hydroopt.cli.run import ANSWER, Run, command


@command(*ANSWER, "map_file", "treat")
def calibrate_sensors(
    run: Run,
    logs: Annotated[list[Path] | None, typer.Argument(metavar="LOG...", help="Logs of motion.")] = None,
    poses: Annotated[list[Path] | None, typer.Option("--at-rest", metavar="FILE...", help=(
        "Tables of postures at rest; rows of one stage and pose are readings of one posture."))] = None,
    geometry: Annotated[bool, typer.Option("--geometry/--mounting", help=(
        "All numbers of the geometry that state a sigma are unknown, or only where IMUs sit."))] = True,
) -> None:
    """Calibrate IMUs, clocks and geometry by motion and postures: DIR gets the motion and the calibrated machine.

    Example: hydroopt calibrate-sensors excavator_imu motion.csv --at-rest rest.csv -o out/sensors
    """
    from hydroopt.estimation.motion.problem import sensor_problem
    from hydroopt.estimation.motion.sensor_calibration import METHOD
    from hydroopt.logs.poses import read_pose_files
    from hydroopt.results.json_file import Job
    from hydroopt.solving import solve

    problem = sensor_problem(run.machine, run.read(logs), [read_pose_files(poses)] if poses else (),
                             geometry=geometry)
    with (run.progress(f"fitting motion and sensors of {run.machine.name} to all readings") as say,
          run.failure_saved(Job.SENSORS, METHOD)):
        calibration = run.saved(solve(problem), say)
    run.show(calibration)
