"""How well a motion will determine IMUs and joints' positions: standard deviations depend on the motion alone."""

from __future__ import annotations

from collections.abc import Sequence

from hydroopt.estimation.motion.problem import sensor_problem
from hydroopt.estimation.motion.sensor_calibration import SensorCalibration, calibrate_sensors
from hydroopt.logs.poses import Poses
from hydroopt.machine.machine import Machine
from hydroopt.model.model import recent_model
from hydroopt.simulation.simulate import Trajectory, random_trajectory, simulate

DURATION, RATE = 20.0, 50.0
"""Length [s] and sampling rate [Hz] of the random motion by which a machine is judged."""
NAME = "expected"
"""Of the log that is expected."""


def expected_calibration(machine: Machine, motion: Trajectory | None = None,
                         poses: Sequence[Poses] = ()) -> SensorCalibration:
    """The calibration that a motion without noise would give: its standard deviations are those to expect.

    Args:
        machine: with IMUs.
        motion: to be driven; by default a random one of `DURATION`.
        poses: tables of postures at rest to be read as well.

    >>> from hydroopt.machine.machine_file import load_machine
    >>> made = expected_calibration(load_machine("excavator_imu"))
    >>> made.parameters["boom_imu.x"].std < 0.01 < made.parameters["boom_imu.x"].prior_std
    True
    """
    model = recent_model(machine)
    driven = random_trajectory(model, duration=DURATION, rate=RATE, seed=0) if motion is None else motion
    log = simulate(model, driven, noise=False, name=NAME)
    return calibrate_sensors(sensor_problem(machine, [log], poses, geometry=False))
