"""Where the angles and fixtures of poses come from: labels and readings of a pose table as positions in arrays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from hydroopt.errors import ProblemError
from hydroopt.logs.poses import Poses
from hydroopt.machine.calibration_chain import Fixture, Stage
from hydroopt.machine.machine import Machine
from hydroopt.machine.sensors import ACCELEROMETER, GYROSCOPE
from hydroopt.model.closed_chain import KinematicModel
from hydroopt.parameters.parameter_set import ParameterKind, ParameterSet
from hydroopt.spatial.inertia import Array

COMPONENTS = (".rx", ".ry", ".rz", ".qw", ".qx", ".qy", ".qz")
"""Ends of the channels of an orientation: rotation vector [rad], then quaternion."""
NOT_ONE = 1e-2
"""How far the length of a quaternion may be from one by its rounding."""


def turns(poses: Poses) -> dict[str, Array]:
    """All orientations of a table as channels of rotation vectors (N,) [rad]; NaN where nothing was read.

    Raises:
        ProblemError: a quaternion is incomplete or not of length one, a rotation vector is incomplete or longer than
            one turn, or both are stated; the sentence names the row.
    """
    found: dict[str, Array] = {}
    names = dict.fromkeys(name[:-3] for name in poses.channels if name.endswith(COMPONENTS))
    for name in names:
        vector, quaternion = (
            np.stack([poses.channels.get(name + end, np.full(len(poses), np.nan)) for end in ends], axis=1)
            for ends in (COMPONENTS[:3], COMPONENTS[3:]))
        for values, ends in ((vector, COMPONENTS[:3]), (quaternion, COMPONENTS[3:])):
            there = np.isfinite(values)
            for row in np.flatnonzero(there.any(axis=1) & ~there.all(axis=1)):
                lost = name + ends[int(np.argmin(there[row]))]
                raise ProblemError(f"'{lost}' is not stated, but other components of this orientation are",
                                   where=_row(poses, row), remedy="state all components, or none")
        both = np.isfinite(vector[:, 0]) & np.isfinite(quaternion[:, 0])
        if np.any(both):
            raise ProblemError(f"the orientation '{name}' is stated as a rotation vector and as a quaternion",
                               where=_row(poses, np.argmax(both)), remedy="state one of them")
        size = np.linalg.norm(quaternion, axis=1)
        for row in np.flatnonzero(np.abs(size - 1) > NOT_ONE):
            raise ProblemError(f"the quaternion '{name}.qw' to '.qz' has the length {size[row]:.4g}, not 1",
                               where=_row(poses, row), remedy="normalise it, and check that its columns are in the "
                               "order of their headers")
        for row in np.flatnonzero(np.linalg.norm(vector, axis=1) > 2 * np.pi):
            raise ProblemError(f"the rotation vector '{name}.rx' to '.rz' is longer than one turn",
                               where=_row(poses, row), remedy="check its unit")
        values = np.where(np.isfinite(quaternion[:, :1]), _vectors(quaternion), vector)
        found |= {name + end: values[:, k] for k, end in enumerate(COMPONENTS[:3])}
    return found


def _vectors(quaternion: Array) -> Array:
    """Rotation vectors (N, 3) [rad] of quaternions (N, 4), scalar first; the shorter way round, NaN where none is."""
    found, there = np.full((len(quaternion), 3), np.nan), np.isfinite(quaternion).all(axis=1)
    found[there] = Rotation.from_quat(quaternion[there], scalar_first=True).as_rotvec()
    return found


def _row(poses: Poses, row: Any) -> str:
    return f"{poses.file[row] or poses.name}, data row {poses.row[row]}"


POSTURES = 5
"""Random positions of the unread joints at which their readings are looked at."""
SMALLEST = 1e-6
"""Part of the largest singular value from which on a direction counts as determined."""


def determined(model: KinematicModel, reading: Array, unread: NDArray[np.bool_],
               present: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which poses (N,) determine all their unread joints, by the nominal geometry, from rows other than the loop's.

    A fixture that holds the tip tells the machine's geometry: which joints it is to tell instead, a stage states.

    Args:
        model: geometry.
        reading: (N, n) joints as read [rad, m].
        unread: (N, n) those that are sought.
        present: (N, m) which rows are read.
    """
    found = np.ones(len(reading), dtype=bool)
    low, high = model.ranges.T
    rng = np.random.default_rng(0)
    for rows, joints in {(each.tobytes(), other.tobytes()): (each, other)
                         for each, other in zip(present, unread, strict=True) if np.any(other)}.values():
        same = np.flatnonzero(np.all(present == rows, axis=1) & np.all(unread == joints, axis=1))
        q = np.where(joints, rng.uniform(low, high, (POSTURES, len(low))), np.nan_to_num(reading[same[0]]))
        by_q = model.over(model.observed_by_angles, model.parameters.nominal, q,
                          np.zeros((POSTURES, model.place_size)))[1]
        part = by_q[:, model.loop_rows:][:, rows[model.loop_rows:]][:, :, joints]
        ranks = np.linalg.matrix_rank(part, rtol=SMALLEST) if part.shape[1] else np.zeros(1)
        found[same] = ranks.max() == np.sum(joints)
    return found


TRIED, ROUNDING = 3, 1e-9
"""Random geometries and postures at which readings are looked at, and the derivative by a joint that counts as none."""
EXACT = 1e-6
"""Standard deviation [m] of a distance between fixtures that states none."""
SCALES = {"x": ("m", 0.1), "y": ("m", 0.1), "z": ("m", 0.1), "rx": ("rad", 0.1), "ry": ("rad", 0.1), "rz": ("rad", 0.1)}
"""Units and scales of where an instrument stands whose pose is not known: position and rotation vector."""


@dataclass(frozen=True, eq=False)
class PoseLayout:
    """Where the angles and fixtures of N poses come from, for n joints, m rows and P parameters.

    q = reading + error where `sensed`, a variable of the pose where `moving`, and for the others (and added to it) the
    linear function of the parameters whose triplets are `locked`: flat position in (N, n), parameter, factor.

    Attributes:
        reading: (N, n) angles as read [rad, m], zero where `sensed` (N, n) is False.
        moving: (N, n) which joints move without being read.
        locked: triplets of joints at rest.
        place: (N, k) parameters that are the place of the fixture, of the tapes' end and of instruments; −1 without.
        given: (N, k) readings that rows take as an input, in the same positions; zero elsewhere.
        held: (N,) which poses hold the tip in a fixture.
        target: (N, m) readings of the rows, where they are `present` (N, m).
    """

    reading: Array
    sensed: NDArray[np.bool_]
    moving: NDArray[np.bool_]
    locked: tuple[NDArray[np.intp], NDArray[np.intp], Array]
    place: NDArray[np.intp]
    given: Array
    held: NDArray[np.bool_]
    target: Array
    present: NDArray[np.bool_]

    @property
    def fixture(self) -> NDArray[np.intp]:
        """(N, 3) parameters that are the position of the fixture; −1 without one."""
        return self.place[:, :3]

    @property
    def expected(self) -> Array:
        """(N,) squared errors in standard deviations that are usual for each pose."""
        return np.asarray(np.maximum(self.present.sum(axis=1), 1.0))


@dataclass(frozen=True, eq=False)
class FixtureDistances:
    """Known distances between fixtures: names, parameters (k, 2, 3), lengths (k,), standard deviations (k,) [m]."""

    names: tuple[str, ...]
    ends: NDArray[np.intp]
    length: Array
    sigma: Array


@dataclass
class _PoseParameter:
    """A parameter that the poses add; without a scale it is exact, without a sigma it has no prior."""

    name: str
    kind: ParameterKind
    unit: str
    nominal: float
    sigma: float | None
    scale: float | None


class LayoutBuilder:
    """Builds parameters and layout of the poses of one table.

    Raises:
        ProblemError: poses and machine do not fit together; the sentence names the row.
    """

    def __init__(self, machine: Machine, model: KinematicModel, poses: Poses) -> None:
        self.machine, self.model, self.poses = machine, model, poses
        self.where = f"poses of {poses.name}"
        count, n = len(poses), len(model.joints)
        self.reading = np.zeros((count, n))
        for k, joint in enumerate(model.joints):
            self.reading[:, k] = poses.channels.get(f"{joint}.q", np.full(count, np.nan))
        self.sensed = np.isfinite(self.reading)
        self.moving = np.zeros((count, n), dtype=bool)
        self.extra: list[_PoseParameter] = []
        self.names: dict[str, int] = {}
        self.triplets: list[tuple[int, int, float]] = []
        self.place = np.full((count, model.place_size), -1)
        self.given = np.zeros((count, model.place_size))
        self.held = np.zeros(count, dtype=bool)
        self.depends = depends(model)
        self._channels()
        self._fixtures()
        self._tapes()
        self._setups()
        self._biases()
        self._joints()
        self._guess_moving_fixtures()

    def _channels(self) -> None:
        known = self.machine.channel_units
        for name in self.poses.channels:
            if name not in known:
                raise ProblemError(f"the machine has no channel '{name}'", where=self.where,
                                   remedy=f"rename it to one of {', '.join(known)}, or leave it out")
            if self.poses.units[name] != known[name]:
                raise ProblemError(f"'{name}' is given in a unit of the kind '{self.poses.units[name]}'",
                                   where=self.where, remedy=f"give it in '{known[name]}' or a unit of that kind")
        count, rows = len(self.poses), self.model.channels
        self.target, self.present = np.zeros((count, len(rows))), np.zeros((count, len(rows)), dtype=bool)
        read = {**self.poses.channels, **turns(self.poses)}
        parts = {part.name for part in self.machine.measuring}
        followers = {f"{joint}.q" for joint in self.machine.dependent_joints}
        for name, values in read.items():
            measured = name.partition(".")[0] in parts or name.endswith(COMPONENTS[:3]) or name in followers
            if measured and name not in rows and not name.endswith((*COMPONENTS[3:], *GYROSCOPE)) and np.any(
                    np.isfinite(values)):
                raise self._no_accuracy(name)
        for i, name in enumerate(rows):
            if name in read:
                self.present[:, i] = np.isfinite(read[name])
                value = np.where(self.present[:, i], read[name], 0.0)
                if i in self.model.readings:
                    self.given[:, self.model.readings[i]] = value
                else:
                    self.target[:, i] = value

    def _fixtures(self) -> None:
        known = [fixture.name for fixture in self.machine.fixtures]
        labels = self.poses.fixture
        if not np.any(labels != "") and len(known) == 1 and not np.any(self.present):
            labels = np.full(len(labels), known[0])
        for row in np.flatnonzero(labels != ""):
            fixture = self._fixture(str(labels[row]), row)
            stands = self._stands(fixture, str(self.poses.stage[row]))
            self.place[row, : len(stands)] = stands
            self.present[row, list(fixture.closes)], self.held[row] = True, True

    def _tapes(self) -> None:
        """Tapes end at the fixture that the row's `tape` names, else at the one that holds the tip, else at the only
        one."""
        columns = [i for i, name in enumerate(self.model.channels) if name.endswith(".distance")]
        for row in np.flatnonzero(self.present[:, columns].any(axis=1)) if self.model.taped else ():
            names = [str(self.poses.tape[row]), str(self.poses.fixture[row]),
                     *(fixture.name for fixture in self.machine.fixtures if len(self.machine.fixtures) == 1)]
            end = next(filter(None, names), "")
            if not end:
                raise ProblemError("a tape is read that does not say at which fixture it ends", where=self._row(row),
                                   remedy="name the fixture in the column 'tape'")
            stands = self._stands(self._fixture(end, row), str(self.poses.stage[row]))
            self.place[row, self.model.inputs["tape"]] = stands[:3]

    def _setups(self) -> None:
        """Where instruments stand whose pose the machine file does not state: elsewhere in each set-up."""
        for name, columns in self.model.instruments.items():
            for row in np.flatnonzero(self.present[:, columns].any(axis=1)):
                owner = ".".join(filter(None, (name, str(self.poses.setup[row]))))
                if f"{owner}.x" not in self.names:
                    for axis, (unit, scale) in SCALES.items():
                        kind = ParameterKind.POSITION if unit == "m" else ParameterKind.ORIENTATION
                        self._add(f"{owner}.{axis}", kind, unit, 0.0, None, scale)
                first = self.names[f"{owner}.x"]
                self.place[row, self.model.inputs[f"{name}.pose"]] = range(first, first + 6)

    def _biases(self) -> None:
        """Biases of accelerometers that are read, constant over all poses."""
        for imu in self.machine.imus:
            if imu.accelerometer is None:
                continue
            columns = [self.model.channels.index(f"{imu.name}.{axis}") for axis in ACCELEROMETER]
            if (rows := np.flatnonzero(self.present[:, columns].any(axis=1))).size:
                bias = imu.accelerometer.bias
                self.place[rows, self.model.inputs[f"{imu.name}.bias"]] = [
                    self._add(f"{imu.name}.bias_{axis}", ParameterKind.BIAS, "m/s^2", 0.0, bias, bias)
                    for axis in "xyz"]

    def _no_accuracy(self, name: str) -> ProblemError:
        return ProblemError(f"the accuracy of '{name}' is not stated", where=self.where,
                            remedy=f"state a sensor with the channel '{name}' in the machine file")

    def _fixture(self, name: str, row: Any) -> Fixture:
        known = {fixture.name: fixture for fixture in self.machine.fixtures}
        if name not in known:
            raise ProblemError(f"there is no fixture '{name}'", where=self._row(row),
                               remedy=f"use {', '.join(known) or 'a machine file that states it'}")
        return known[name]

    def _stands(self, fixture: Fixture, stage: str) -> list[int]:
        """Parameters that are a fixture's place in a stage."""
        owner = f"{fixture.name}.{stage}" if fixture.moves and stage else fixture.name
        numbers = self.machine.fixture_numbers(fixture)
        if f"{owner}.x" not in self.names:
            for number in numbers:
                note = self.machine.notes.get(number.path)
                angle = number.kind is ParameterKind.ORIENTATION
                sigma = None if note is None else note.spread(*(fixture.orientation if angle else fixture.position))
                scale = 1e-3 if fixture.moves and not angle else sigma
                self._add(f"{owner}.{number.name.rpartition('.')[2]}", number.kind, number.unit, number.value,
                          None if fixture.moves else sigma, scale)
        return [self.names[f"{owner}.{number.name.rpartition('.')[2]}"] for number in numbers]

    def _add(self, name: str, kind: ParameterKind, unit: str, value: float, sigma: float | None,
             scale: float | None) -> int:
        self.names[name] = len(self.model.parameters) + len(self.extra)
        self.extra.append(_PoseParameter(name, kind, unit, value, sigma, scale))
        return self.names[name]

    def _joints(self) -> None:
        stages = {stage.name: stage for stage in self.machine.stages}
        order = list(dict.fromkeys(str(stage) for stage in self.poses.stage))
        n = len(self.model.joints)
        determined = self._determined(stages)
        locked_since: dict[str, int] = {}
        drifts: dict[str, list[int]] = {}
        for name in order:
            rows = np.flatnonzero(self.poses.stage == name)
            stage = stages.get(name)
            progress = np.linspace(0.0, 1.0, len(rows))
            for k, joint in enumerate(self.model.joints):
                unread = rows[~self.sensed[rows, k]]
                held = stage is not None and joint in stage.locked
                if (stage is not None and joint in stage.moves) or (joint in self.machine.base_joints and not held):
                    locked_since.pop(joint, None)
                    self.moving[unread, k] = True
                    continue
                if not unread.size or not self._matters(k, unread):
                    self.reading[unread, k] = 0.0
                    continue
                if not held and np.all(determined[unread]):
                    locked_since.pop(joint, None)
                    self.moving[unread, k] = True
                    continue
                if stage is None or joint not in stage.locked:
                    row = unread[np.argmin(determined[unread])]
                    if stage is None and stages:
                        raise ProblemError(f"the machine has no stage '{name}', and '{joint}.q' is not read there",
                                           where=self._row(row),
                                           remedy=f"name the stage, one of {', '.join(stages)}, or record '{joint}.q'")
                    raise ProblemError(
                        f"the joint '{joint}' is neither sensed, nor locked or moving in stage '{name}'",
                        where=self._row(row), remedy=f"record '{joint}.q' or a length that determines it, or state "
                                                          f"in the machine file's stage '{name}' what the joint does")
                if joint not in locked_since:
                    note = self.machine.notes.get(f"{name}.locked.{joint}")
                    sigma = None if note is None else note.spread(stage.locked[joint])
                    locked_since[joint] = self._add(f"{joint}.locked.{name}", ParameterKind.LOCKED_ANGLE, "rad",
                                               stage.locked[joint], sigma, sigma or np.radians(10.0))
                    drifts[joint] = []
                self.reading[unread, k] = 0.0
                self.triplets += [(int(row) * n + k, locked_since[joint], 1.0) for row in unread]
                self.triplets += [(int(row) * n + k, drift, 1.0) for row in unread for drift in drifts[joint]]
                if stage.drift > 0:
                    drift = self._add(f"{joint}.drift.{name}", ParameterKind.DRIFT, "rad", 0.0, stage.drift,
                                      stage.drift)
                    self.triplets += [(int(row) * n + k, drift, float(progress[i]))
                                      for i, row in enumerate(rows) if not self.sensed[row, k]]
                    drifts[joint].append(drift)

    def _determined(self, stages: Mapping[str, Stage]) -> NDArray[np.bool_]:
        """(N,) which poses determine all joints that are neither read nor locked."""
        locked = [[stage is not None and joint in stage.locked for joint in self.model.joints]
                  for stage in map(stages.get, map(str, self.poses.stage))]
        matters = (self.present[:, :, None] & self.depends).any(axis=1)
        return determined(self.model, self.reading, ~self.sensed & ~np.array(locked) & matters, self.present)

    def _matters(self, k: int, rows: NDArray[np.intp]) -> bool:
        """Whether anything observed in these rows depends on a joint."""
        return bool(np.any(self.present[rows][:, self.depends[:, k]]))

    def _row(self, row: Any) -> str:
        return f"{self.poses.file[row] or self.poses.name}, data row {self.poses.row[row]}"

    def _guess_moving_fixtures(self) -> None:
        """Where all joints are sensed, the mean of the nominal tips is the initial guess of a fixture's position."""
        geometry = self.model.parameters
        tips = self.model.over(self.model.tip, geometry.nominal, np.nan_to_num(self.reading))[0][:, :, 0]
        chain = self.depends[: self.model.loop_rows].any(axis=0)
        complete = np.all(self.sensed[:, chain], axis=1)
        fixture = np.where(self.held[:, None], self.place[:, :3], -1)
        for column in np.unique(fixture[fixture >= 0]):
            axis = int(np.flatnonzero((fixture == column).any(axis=0))[0])
            own = self.extra[column - len(geometry)]
            rows = complete & (fixture[:, axis] == column)
            if own.sigma is None and own.scale and np.any(rows):
                own.nominal = float(tips[rows, axis].mean())

    def parameter_set(self) -> ParameterSet:
        """Geometry, then what the poses add."""
        own, extra = self.model.parameters, self.extra
        information = [*np.diag(own.information), *(1 / e.sigma**2 if e.sigma else 0.0 for e in extra)]
        free = np.full(len(extra), np.inf)
        return ParameterSet(
            (*own.names, *(e.name for e in extra)), (*own.kinds, *(e.kind for e in extra)),
            (*own.units, *(e.unit for e in extra)),
            np.array([*own.nominal, *(e.nominal for e in extra)]), np.concatenate([own.lower, -free]),
            np.concatenate([own.upper, free]), np.array([*own.scale, *(e.scale or 1.0 for e in extra)]),
            np.diag(information))

    def exact(self) -> dict[str, float]:
        """Fixtures whose position the machine file states without a confidence, and what no pose measures of targets
        and of what poses are measured with."""
        parts = {*(part.name for part in self.machine.targets), *(part.name for part in self.machine.measuring)}
        own, pattern = self.model.parameters, self.model.observed_jacobians.sparsity_out(1)
        seen = np.asarray(self.present.any(axis=0))
        idle = {name: own.nominal[k] for k, name in enumerate(own.names) if name.partition(".")[0] in parts
                and not any(seen[row] for row in pattern.get_triplet()[0][pattern.colind(k) : pattern.colind(k + 1)])}
        return {e.name: e.nominal for e in self.extra if e.scale is None} | idle

    def layout(self) -> PoseLayout:
        """Where the angles and fixtures come from."""
        rows, columns, factors = (np.array(x) for x in zip(*self.triplets, strict=True)) if self.triplets else (
            np.zeros(0, int), np.zeros(0, int), np.zeros(0))
        reading = np.where(self.sensed, self.reading, 0.0)
        return PoseLayout(reading, self.sensed, self.moving, (rows, columns, factors), self.place, self.given,
                          self.held, self.target, self.present)

    def angle_sigma(self) -> Array:
        """(n,) standard deviation of each joint's readings [rad, m]."""
        sensors = [self.machine.sensor(f"{joint}.q") for joint in self.model.joints]
        return np.array([0.0 if sensor is None else sensor.std for sensor in sensors])

    def row_sigma(self) -> Array:
        """(N, m): play of the fixture for the gap, accuracy of the sensor for what is read."""
        sigma = np.zeros_like(self.target)
        plays = {fixture.name: (fixture.play, fixture.tilt) for fixture in self.machine.fixtures}
        first = next(iter(plays.values()), (0.0, 0.0))
        rows = self.model.loop_rows
        sigma[:, :rows] = np.repeat([plays.get(str(label), first) for label in self.poses.fixture], 3, axis=1)[:, :rows]
        for i, name in enumerate(self.model.channels[rows:], rows):
            if np.any(self.present[:, i]):
                sensor = self.machine.sensor(name)
                if sensor is None or sensor.std == 0:
                    raise self._no_accuracy(name)
                sigma[:, i] = sensor.std
        return sigma

    def distances(self) -> FixtureDistances:
        """Those between fixtures that the poses visit; a fixture that moves takes its distance along."""
        names, ends, lengths, sigmas = [], [], [], []
        stages = ["", *(f".{stage}" for stage in dict.fromkeys(map(str, self.poses.stage)))]
        for distance in self.machine.distances:
            if distance.length is None:
                continue
            note = self.machine.notes.get(f"{distance.name}.length")
            for stage in stages:
                owners = [f"{name}{stage}" for name in distance.between]
                if all(f"{owner}.x" in self.names for owner in owners):
                    ends.append([[self.names[f"{owner}.{axis}"] for axis in "xyz"] for owner in owners])
                    names.append(distance.name)
                    lengths.append(distance.length)
                    sigmas.append((note and note.spread(distance.length)) or EXACT)
        return FixtureDistances(tuple(names), np.array(ends, dtype=int).reshape(-1, 2, 3), np.array(lengths),
                                np.array(sigmas))


def depends(model: KinematicModel) -> NDArray[np.bool_]:
    """(m, n) which readings depend on which joints at geometries that the stated confidences allow: those of an
    inclinometer do not depend on a joint about the vertical."""
    pattern = model.observed_jacobians.sparsity_out(2)
    stated = np.zeros(pattern.shape, dtype=bool)
    stated[tuple(np.array(pattern.get_triplet(), dtype=int))] = True
    rng, (low, high) = np.random.default_rng(0), model.ranges.T
    geometry = model.parameters.nominal + model.parameters.scale * rng.standard_normal((TRIED, len(model.parameters)))
    by_q = model.over(model.observed_jacobians, geometry, rng.uniform(low, high, (TRIED, len(low))),
                      rng.standard_normal((TRIED, model.place_size)))[2]
    return np.asarray(stated & ~np.all(np.abs(by_q) < ROUNDING, axis=0))
