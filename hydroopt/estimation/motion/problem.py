"""From logs, tables of poses and a machine file to the fit of its motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hydroopt.errors import LogError
from hydroopt.estimation.motion.first_guess import first_guess
from hydroopt.estimation.motion.motion_fit import Common, FittedPaths, MotionFit, Stretch, solve
from hydroopt.estimation.motion.observations import Observations, motion_channels, observations
from hydroopt.estimation.motion.paths import Postures, Spline
from hydroopt.logs.log import Log
from hydroopt.logs.poses import Poses
from hydroopt.machine.machine import Machine
from hydroopt.model.sensor_readings import SensorReadings
from hydroopt.spatial.inertia import Array

FASTEST = 5.0
"""Frequency [Hz] up to which a machine's motion is resolved whose file states no bandwidth."""
KNOTS = 4.0
"""Knots per period of the fastest motion."""
SHORTEST = 12
"""Samples of a stretch that is fitted."""


def fit_motion(machine: Machine, logs: Sequence[Log], poses: Sequence[Poses] = (), *,
               geometry: bool = True) -> FittedPaths:
    """Fit the motion of logs and the postures of poses at rest, and what their sensors have in common.

    Args:
        machine: the machine file; numbers of its geometry with a stated `sigma` are unknown, within that.
        logs: motion, by any sensors.
        poses: postures at rest, by any sensors.
        geometry: whether all of the geometry is unknown; otherwise only where IMUs sit, and their biases.

    Raises:
        LogError: no channel tells the motion of a joint.
        SolverError: the fit does not converge.
    """
    free = {number.name for number in machine.geometry_numbers} if geometry else machine.imu_numbers
    tables = [_as_log(table) for table in poses]
    readings: dict[tuple[str, ...], SensorReadings] = {}
    for log in (*logs, *tables):
        channels = motion_channels(machine, log)
        if not channels:
            raise LogError("no channel tells the motion of a joint", where=log.path or log.name,
                           remedy="record angles, lengths of cylinders or IMUs that the machine file states")
        if channels not in readings:
            readings[channels] = SensorReadings(machine, channels, free)
    common = _geometry(readings)
    stretches = []
    for log in logs:
        data = observations(machine, log)
        common |= _biases(machine, data)
        for number in np.unique(log.segment):
            part = data.thinned(log.segment == number)
            if len(part.t) >= SHORTEST:
                stretches.append(_spline(machine, readings[data.channels], part))
    for table, log in zip(poses, tables, strict=True):
        data = observations(machine, log)
        common |= _biases(machine, data)
        stretches.append(_postures(machine, readings[data.channels], data, _numbered(table)))
    ranges = np.array([machine.link(joint).joint.range for joint in machine.joints])
    fastest = machine.bandwidth or FASTEST
    span = np.ptp(ranges, axis=1)
    numbers = tuple(common.values())
    start = MotionFit(readings, tuple(stretches), numbers, np.array([each.prior for each in numbers]),
                      (0.1 * span * (2 * np.pi * fastest / 4) ** 3) ** 2 / (2 * fastest), ranges.mean(axis=1), span)
    return solve(start, machine.name)


def _as_log(table: Poses) -> Log:
    """Rows of a table of poses as a log whose time counts the rows."""
    return Log(table.name, np.arange(float(len(table.row))), table.channels, units=table.units)


def _geometry(readings: dict[tuple[str, ...], SensorReadings]) -> dict[str, Common]:
    found: dict[str, Common] = {}
    for made in readings.values():
        for number, sigma in zip(made.numbers, made.sigma, strict=True):
            found[number.name] = Common(number.name, number.unit, number.value, float(sigma))
    return found


def _biases(machine: Machine, data: Observations) -> dict[str, Common]:
    return {name: Common(name, machine.channel_units[channel], 0.0, float(sigma))
            for channel, sigma in zip(data.channels, data.biased, strict=True)
            if sigma and (name := f"{data.name}: {channel}")}


def _spline(machine: Machine, made: SensorReadings, data: Observations) -> Stretch:
    g = np.array([number.value for number in made.numbers])
    times, guess = first_guess(machine, made, data, g)
    fastest = machine.bandwidth or FASTEST
    spacing = 1 / (KNOTS * fastest)
    return Stretch(Spline.over(data.t, spacing, times, guess), (data,), float(data.t.mean()))


def _numbered(table: Poses) -> Array:
    """The number of the posture that each row of a table was read in: rows of one stage and pose are of one."""
    labels = [f"{stage}/{pose}" for stage, pose in zip(table.stage, table.pose, strict=True)]
    _, number = np.unique(labels, return_inverse=True)
    return np.asarray(number, dtype=float)


def _postures(machine: Machine, made: SensorReadings, data: Observations, number: Array) -> Stretch:
    g = np.array([each.value for each in made.numbers])
    found = [first_guess(machine, made, replace(data.thinned(number == k), t=np.zeros(np.sum(number == k))), g)[1][0]
             for k in range(int(number.max()) + 1)]
    return Stretch(Postures(np.array(found)), (replace(data, t=number),))
