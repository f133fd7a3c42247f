"""What can be read in a pose, how many minutes it takes, and what it says about the geometry, as whitened rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import ProblemError
from hydroopt.estimation.kinematic.accuracy import machine_end
from hydroopt.estimation.kinematic.observability import linearise
from hydroopt.estimation.kinematic.problem import CalibrationProblem
from hydroopt.excitation.criteria import FAINT
from hydroopt.excitation.selection.pose_problem import Postures
from hydroopt.model.closed_chain import KinematicModel
from hydroopt.spatial.inertia import Array

DRIVE = 2.0
"""Minutes to drive to a posture and come to rest."""
MINUTES = {"instrument": 0.5, "tape": 1.0, "datum": 0.5, "imu": 0.0, "transducer": 0.0}
"""To sight a target, to hold a tape, to set a target down on a datum; none of sensors that are mounted."""
SET_UP = {"instrument": 15.0, "datum": 5.0, "tape": 2.0, "imu": 15.0, "transducer": 0.0, "calibrator": 60.0}
"""Minutes before the first reading: to set up an instrument or a tracker, to lay out a datum, to fetch a tape, to mount
an IMU, to attach a calibrator."""
WORKSPACE = 500
"""Postures that stand for the workspace."""


@dataclass(frozen=True)
class Reading:
    """One reading of a pose.

    Attributes:
        name: of its measurement: ``station.prism``, ``tape``, ``boom_cylinder.length``, ``tip``.
        channels: of the pose table.
        minutes: that it takes; 0 for what reads by itself.
        kind: what it is taken with, a key of `SET_UP`.
    """

    name: str
    channels: tuple[str, ...]
    minutes: float
    kind: str

    @property
    def owner(self) -> str:
        """The instrument, tape, datum, IMU or cylinder that it belongs to."""
        return self.name.partition(".")[0]

    @property
    def by_hand(self) -> bool:
        """Whether somebody must take it."""
        return self.minutes > 0

    def __str__(self) -> str:
        return f"{self.name} ({self.minutes:g} min)"


def readings(model: KinematicModel, channels: Sequence[str]) -> tuple[Reading, ...]:
    """What the machine file lets one read in a pose, of the channels that have a sensor; joints' own sensors are no
    reading: they read in every pose."""
    machine = model.machine
    found = []
    for name in (f"{cylinder.name}.length" for cylinder in machine.cylinders):
        sensor = machine.sensor(name)
        rated = sensor is not None and sensor.rate is not None
        found.append(Reading(name, (name,), MINUTES["tape"], "transducer" if rated else "tape"))
    if machine.tracker:
        found.append(Reading("tip", tuple(f"tip.{axis}" for axis in "xyz"), MINUTES["instrument"], "instrument"))
    found += [Reading(each.name, each.channels, MINUTES[each.tool], each.tool) for each in model.measurements]
    return tuple(each for each in found if set(each.channels) <= set(channels))


class PostureReadings:
    """R kinds of readings in N candidate postures, and what they say about the f free parameters of a calibration.

    Attributes:
        postures: the N postures, `readings` what is read.
        calibration: the problem of all readings in all postures.
        there: (N, R) which reading a posture offers.
        free: (f,) places of the free parameters; `scale` (f,) makes them comparable.
        prior: (f, f) information on them before anything is read.
    """

    def __init__(self, postures: Postures, readings: Sequence[Reading]) -> None:
        self.postures, self.readings = postures, tuple(readings)
        self.calibration = postures.calibration
        present, channels = self.calibration.layout.present, self.calibration.model.channels
        self._rows = [np.array([channels.index(channel) for channel in each.channels if channel in channels], dtype=int)
                      for each in readings]
        self._known: dict[tuple[int, bytes], Array] = {}
        self.there = np.array([present[:, each].any(axis=1) for each in self._rows]).reshape(-1, len(present)).T
        self.free = np.flatnonzero(self.calibration.free)
        self.scale = self.calibration.parameters.scale[self.free]
        self.prior = np.diag(self.calibration.known[self.free] ** 2 + FAINT / self.scale**2)

    @property
    def names(self) -> tuple[str, ...]:
        """Of the free parameters."""
        return tuple(self.calibration.parameters.names[k] for k in self.free)

    def rows_of(self, places: NDArray[np.intp], read: NDArray[np.bool_]) -> Array:
        """Whitened Jacobian (K, u, f) of postures (K,) in which some readings (K, R) are taken, each computed once."""
        keys = [(k, each.tobytes()) for k, each in zip(places.tolist(), read, strict=True)]
        missing = {each: row for each, row in zip(keys, read, strict=True) if each not in self._known}
        for kind in {each for _, each in missing}:
            some = np.array(sorted(k for k, each in missing if each == kind))
            part = self.reading(some, np.array([missing[int(k), kind] for k in some]))
            rows = linearise(part, part.parameters.nominal, self.postures.q[some]).jacobian[:, :, self.free]
            self._known.update(((int(k), kind), each) for k, each in zip(some, rows, strict=True))
        found = [self._known[each] for each in keys]
        made = np.zeros((len(found), max(map(len, found), default=0), len(self.free)))
        for row, each in zip(made, found, strict=True):
            row[: len(each)] = each
        return made

    def information(self, read: NDArray[np.bool_]) -> Array:
        """(f, f) of some readings (N, R), with what is known before."""
        places = np.flatnonzero(read.any(axis=1))
        rows = self.rows_of(places, read[places]).reshape(-1, len(self.free))
        return np.asarray(self.prior + rows.T @ rows)

    def reading(self, places: NDArray[np.intp], read: NDArray[np.bool_]) -> CalibrationProblem:
        """The problem of postures (K,) in which some readings (K, R) are taken, beside what belongs to none."""
        problem = self.calibration.without(~np.isin(np.arange(len(self.there)), places))
        layout = problem.layout
        present = layout.present.copy()
        for r, rows in enumerate(self._rows):
            present[:, rows] &= read[:, r, None]
        return replace(problem, layout=replace(layout, present=present))


def refuse_minutes(minutes: Mapping[str, float]) -> None:
    """Refuse minutes, by what takes them, that are no durations.

    Raises:
        ProblemError: which.
    """
    for name, spent in minutes.items():
        if not (np.isfinite(spent) and spent >= 0):
            raise ProblemError(f"{spent:g} min is not a duration", where=f"minutes of '{name}'",
                               remedy="give a number from 0 on")


def tip_rows(calibration: CalibrationProblem) -> Array:
    """Rows (s, P) whose squares sum up to the mean square displacement of the tip [m²] by parameters."""
    model = calibration.model
    low, high = model.ranges.T
    q = np.random.default_rng(0).uniform(low, high, (WORKSPACE, len(low)))
    _, function = machine_end(model)
    by_g = model.over(function, model.parameters.nominal, q)[1] / np.sqrt(WORKSPACE)
    rows = np.linalg.qr(by_g.reshape(by_g.shape[0] * by_g.shape[1], by_g.shape[2]), mode="r")
    return np.asarray(np.pad(rows, ((0, 0), (0, len(calibration.parameters) - by_g.shape[2]))))
