"""Kinematic calibration as an optimisation problem: poses of closed chains, and what is unknown in them.

Every pose gives rows that must vanish: the gap between tip and fixture, and the differences of cylinder lengths, of
tracked tips and of taped distances from their readings. Joint angles are sensed (with errors of their own), locked at
a constant of their stage, or moving without a sensor.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import ProblemError
from hydroopt.logs.frames import refuse_others
from hydroopt.logs.poses import Poses
from hydroopt.machine.machine import Machine
from hydroopt.model.closed_chain import KinematicModel
from hydroopt.parameters.parameter_set import ParameterKind, ParameterSet
from hydroopt.spatial.inertia import Array

EXACT = 1e-6
"""Standard deviation [m] of a distance between fixtures that states none."""

PoseLoss = Literal["squares", "huber", "student_t"]


@dataclass(frozen=True, eq=False)
class Gathering:
    """Where the angles and fixtures of N poses come from, for n joints, m rows and P parameters.

    q = reading + error where `sensed`, a variable of its own where `moving`, and for the others (and added to it) the
    linear function of the parameters whose triplets are `locked`: flat position in (N, n), parameter, factor.
    """

    reading: Array
    sensed: NDArray[np.bool_]
    moving: NDArray[np.bool_]
    locked: tuple[NDArray[np.intp], NDArray[np.intp], Array]
    fixture: NDArray[np.intp]
    target: Array
    present: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Distances:
    """Known distances between fixtures: parameters (k, 2, 3), lengths (k,) and standard deviations (k,) [m]."""

    ends: NDArray[np.intp]
    length: Array
    sigma: Array


@dataclass(frozen=True, eq=False)
class CalibrationProblem:
    """What is to be calibrated from which poses; solving never changes it.

    Attributes:
        model: geometry and its derivatives.
        poses: the measured ones (N of them); `validation` those held out.
        parameters: geometry, then fixtures, angles of locked joints and their drifts.
        at: where the angles of the poses come from.
        angle_sigma: (n,) standard deviation of each joint's readings [rad, m]; 0 counts as exact.
        row_sigma: (N, m) standard deviation of each row [m]; 0 must hold exactly.
        distances: between fixtures.
        fixed: parameters that keep the value given here.
        priors: whether the machine file's confidences count as measurements; those of drifts always do.
        loss: what a pose's squared error, in standard deviations, costs.
    """

    model: KinematicModel
    poses: Poses
    validation: Poses | None
    parameters: ParameterSet
    at: Gathering
    angle_sigma: Array
    row_sigma: Array
    distances: Distances
    fixed: Mapping[str, float]
    priors: bool = True
    loss: PoseLoss = "squares"

    @property
    def free(self) -> NDArray[np.bool_]:
        """(P,) which parameters are estimated."""
        return np.array([name not in self.fixed for name in self.parameters.names], dtype=bool)

    @property
    def known(self) -> Array:
        """(P,) root of the information that counts beside the data: of drifts always, of the rest as `priors` says."""
        counts = [self.priors or kind is ParameterKind.DRIFT for kind in self.parameters.kinds]
        return np.asarray(np.sqrt(np.diag(self.parameters.information)) * counts)

    @property
    def start(self) -> Array:
        """(P,) nominal values, with the fixed ones in place."""
        start = self.parameters.nominal.copy()
        for name, value in self.fixed.items():
            start[self.parameters.index(name)] = value
        return start

    def fixing(self, **values: float) -> CalibrationProblem:
        """The problem with parameters held, ``fixing(**{"ball.y": 0.0})`` [SI].

        Raises:
            ProblemError: there is no such parameter, or its value is not finite.
        """
        for name, value in values.items():
            self.parameters.index(name)
            if not np.isfinite(value):
                raise ProblemError(f"it cannot be held at {value}", where=f"parameter '{name}'",
                                   remedy="give a finite number")
        return replace(self, fixed={**self.fixed, **values})

    def with_loss(self, loss: PoseLoss) -> CalibrationProblem:
        """The problem with another loss."""
        return replace(self, loss=loss)

    def without(self, rows: NDArray[np.bool_]) -> CalibrationProblem:
        """The problem without some of its poses (N,); parameters stay."""
        keep = ~np.asarray(rows, dtype=bool)
        gathered = self.at
        n = gathered.reading.shape[1]
        where, which, factor = gathered.locked
        taken = keep[where // n]
        new_row = np.cumsum(keep) - 1
        locked = (new_row[where[taken] // n] * n + where[taken] % n, which[taken], factor[taken])
        at = Gathering(gathered.reading[keep], gathered.sensed[keep], gathered.moving[keep], locked,
                       gathered.fixture[keep], gathered.target[keep], gathered.present[keep])
        return replace(self, poses=self.poses.select(keep), at=at, row_sigma=self.row_sigma[keep])

    def angles(self, theta: Array, own: Array) -> Array:
        """Joint vectors (N, n): `own` where sensed or moving, the parameters' where locked."""
        q: Array = np.where(self.at.sensed | self.at.moving, own, self.at.reading)
        where, which, factor = self.at.locked
        np.add.at(q.ravel(), where, factor * theta[which])
        return q

    def fixtures(self, theta: Array) -> Array:
        """Position (N, 3) [m] of every pose's fixture; zero where there is none."""
        return np.where(self.at.fixture >= 0, theta[np.maximum(self.at.fixture, 0)], 0.0)

    def rows(self, theta: Array, q: Array) -> tuple[Array, Array, Array]:
        """Rows (N, m) that must vanish, and their Jacobians by all parameters (N, m, P) and by angles (N, m, n)."""
        count, n = q.shape
        k = len(self.model.parameters)
        value, by_g, by_q = self.model.over(self.model.observed_jacobians, theta[:k], q, self.fixtures(theta))
        rows = np.where(self.at.present, value[:, :, 0] - self.at.target, 0.0)
        by_q *= self.at.present[:, :, None]
        jacobian = np.zeros((count, rows.shape[1], len(self.parameters)))
        jacobian[:, :, :k] = by_g * self.at.present[:, :, None]
        where, which, factor = self.at.locked
        np.add.at(jacobian, (where[:, None] // n, np.arange(rows.shape[1]), which[:, None]),
                  factor[:, None] * by_q[where // n, :, where % n])
        there = np.flatnonzero(self.at.fixture[:, 0] >= 0)
        for axis in range(3):  # the gap loses what the fixture gains; tapes end at it
            column = self.at.fixture[there, axis]
            jacobian[there, axis, column] -= self.at.present[there, axis]
        self._tape_jacobian(jacobian, theta, q, there)
        return rows, jacobian, by_q

    def _tape_jacobian(self, jacobian: Array, theta: Array, q: Array, there: NDArray[np.intp]) -> None:
        taped = [i for i, name in enumerate(self.model.channels) if name.endswith(".distance")]
        if not taped or not np.any(self.at.present[:, taped]):
            return
        ends = self.model.over(self.model.far_ends, theta[: len(self.model.parameters)], q)[0]
        for column, i in enumerate(taped):
            away = self.fixtures(theta) - ends[:, :, column]
            away /= np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-12)
            for axis in range(3):
                jacobian[there, i, self.at.fixture[there, axis]] += (away[:, axis] * self.at.present[:, i])[there]


def calibration_problem(machine: Machine, poses: Poses, validation: Poses | None = None, *,
                        fixed: Mapping[str, float] | None = None, priors: bool = True) -> CalibrationProblem:
    """The kinematic calibration of a machine from a table of poses.

    Args:
        machine: numbers of its geometry that state a confidence are calibrated, the others are exact.
        poses: measured ones, stages in the order in which they were measured.
        validation: poses that are predicted, not fitted.
        fixed: values [SI] of parameters that are held.
        priors: whether the file's confidences count as measurements, or only say what is unknown.

    Raises:
        ProblemError: poses and machine do not fit together; the sentence names the row.
    """
    refuse_others([poses] if validation is None else [poses, validation], (Poses,), "table of poses", "calibration")
    model = KinematicModel(machine)
    builder = _Builder(machine, model, poses)
    problem = CalibrationProblem(
        model, poses, validation, builder.parameter_set(), builder.gathering(), builder.angle_sigma(),
        builder.row_sigma(), builder.distances(), builder.exact() | dict(fixed or {}), priors)
    return problem.fixing(**problem.fixed)


@dataclass
class _Extra:
    """A parameter that the poses add; without a scale it is exact, without a sigma nothing is known before."""

    name: str
    kind: ParameterKind
    unit: str
    nominal: float
    sigma: float | None
    scale: float | None


class _Builder:
    """Turns labels of poses into positions in arrays."""

    def __init__(self, machine: Machine, model: KinematicModel, poses: Poses) -> None:
        self.machine, self.model, self.poses = machine, model, poses
        self.where = f"poses of {poses.name}"
        count, n = len(poses), len(model.joints)
        self.reading = np.zeros((count, n))
        for k, joint in enumerate(model.joints):
            self.reading[:, k] = poses.channels.get(f"{joint}.q", np.full(count, np.nan))
        self.sensed = np.isfinite(self.reading)
        self.moving = np.zeros((count, n), dtype=bool)
        self.extra: list[_Extra] = []
        self.names: dict[str, int] = {}
        self.triplets: list[tuple[int, int, float]] = []
        self.fixture = np.full((count, 3), -1)
        pattern = model.observed_jacobians.sparsity_out(2)
        self.depends = np.zeros(pattern.shape, dtype=bool)
        self.depends[tuple(np.array(pattern.get_triplet(), dtype=int))] = True
        self._channels()
        self._fixtures()
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
        for i, name in enumerate(rows):
            if name in self.poses.channels:
                value = self.poses.channels[name]
                self.present[:, i] = np.isfinite(value)
                self.target[:, i] = np.where(self.present[:, i], value, 0.0)

    def _fixtures(self) -> None:
        known = {fixture.name: fixture for fixture in self.machine.fixtures}
        labels = self.poses.fixture
        if not np.any(labels != "") and len(known) == 1 and not np.any(self.present):
            labels = np.full(len(labels), next(iter(known)))
        for row in np.flatnonzero(labels != ""):
            name, stage = str(labels[row]), str(self.poses.stage[row])
            if name not in known:
                raise ProblemError(f"there is no fixture '{name}'", where=self._row(row),
                                   remedy=f"use {', '.join(known) or 'a machine file that states it'}")
            fixture = known[name]
            owner = f"{name}.{stage}" if fixture.moves and stage else name
            if f"{owner}.x" not in self.names:
                note = self.machine.notes.get(f"{name}.position")
                sigma = None if note is None else note.spread(*fixture.position)
                for axis, value in zip("xyz", fixture.position, strict=True):
                    self._add(f"{owner}.{axis}", ParameterKind.POSITION, "m", value, None if fixture.moves else sigma,
                              1e-3 if fixture.moves else sigma)
            self.fixture[row] = [self.names[f"{owner}.{axis}"] for axis in "xyz"]
        self.present[:, :3] = self.fixture >= 0

    def _add(self, name: str, kind: ParameterKind, unit: str, value: float, sigma: float | None,
             scale: float | None) -> int:
        self.names[name] = len(self.model.parameters) + len(self.extra)
        self.extra.append(_Extra(name, kind, unit, value, sigma, scale))
        return self.names[name]

    def _joints(self) -> None:
        stages = {stage.name: stage for stage in self.machine.stages}
        order = list(dict.fromkeys(str(stage) for stage in self.poses.stage))
        n = len(self.model.joints)
        holding: dict[str, int] = {}
        slips: dict[str, list[int]] = {}
        for name in order:
            rows = np.flatnonzero(self.poses.stage == name)
            stage = stages.get(name)
            progress = np.linspace(0.0, 1.0, len(rows))
            for k, joint in enumerate(self.model.joints):
                blind = rows[~self.sensed[rows, k]]
                if stage is not None and joint in stage.moves:
                    holding.pop(joint, None)
                    self.moving[blind, k] = True
                    continue
                if not blind.size or not self._matters(k, blind):
                    self.reading[blind, k] = 0.0
                    continue
                if stage is None or joint not in stage.locked:
                    if stage is None and stages:
                        raise ProblemError(f"the machine has no stage '{name}', and '{joint}.q' is not read there",
                                           where=self._row(blind[0]),
                                           remedy=f"name the stage, one of {', '.join(stages)}, or record '{joint}.q'")
                    raise ProblemError(
                        f"the joint '{joint}' is neither sensed, nor locked or moving in stage '{name}'",
                        where=self._row(blind[0]), remedy=f"record '{joint}.q', or state in the machine file's stage "
                                                          f"'{name}' what the joint does")
                if joint not in holding:
                    note = self.machine.notes.get(f"{name}.locked.{joint}")
                    sigma = None if note is None else note.spread(stage.locked[joint])
                    holding[joint] = self._add(f"{joint}.locked.{name}", ParameterKind.LOCKED_ANGLE, "rad",
                                               stage.locked[joint], sigma, sigma or np.radians(10.0))
                    slips[joint] = []
                self.reading[blind, k] = 0.0
                self.triplets += [(int(row) * n + k, holding[joint], 1.0) for row in blind]
                self.triplets += [(int(row) * n + k, slip, 1.0) for row in blind for slip in slips[joint]]
                if stage.drift > 0:
                    slip = self._add(f"{joint}.drift.{name}", ParameterKind.DRIFT, "rad", 0.0, stage.drift, stage.drift)
                    self.triplets += [(int(row) * n + k, slip, float(progress[i]))
                                      for i, row in enumerate(rows) if not self.sensed[row, k]]
                    slips[joint].append(slip)

    def _matters(self, k: int, rows: NDArray[np.intp]) -> bool:
        """Whether anything observed in these rows depends on a joint."""
        return bool(np.any(self.present[rows][:, self.depends[:, k]]))

    def _row(self, row: Any) -> str:
        return f"{self.poses.file[row] or self.poses.name}, data row {self.poses.row[row]}"

    def _guess_moving_fixtures(self) -> None:
        """Where all joints are sensed, the nominal tips tell best where a fixture stood."""
        geometry = self.model.parameters
        tips = self.model.over(self.model.tip, geometry.nominal, np.nan_to_num(self.reading))[0][:, :, 0]
        chain = self.depends[:3].any(axis=0)
        seen = np.all(self.sensed[:, chain], axis=1)
        for column in np.unique(self.fixture[self.fixture >= 0]):
            axis = int(np.flatnonzero((self.fixture == column).any(axis=0))[0])
            own = self.extra[column - len(geometry)]
            rows = seen & (self.fixture[:, axis] == column)
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
        """Fixtures whose position the machine file states without a confidence."""
        return {e.name: e.nominal for e in self.extra if e.scale is None}

    def gathering(self) -> Gathering:
        rows, columns, factors = (np.array(x) for x in zip(*self.triplets, strict=True)) if self.triplets else (
            np.zeros(0, int), np.zeros(0, int), np.zeros(0))
        reading = np.where(self.sensed, self.reading, 0.0)
        return Gathering(reading, self.sensed, self.moving, (rows, columns, factors), self.fixture, self.target,
                         self.present)

    def angle_sigma(self) -> Array:
        sensors = [self.machine.sensor(f"{joint}.q") for joint in self.model.joints]
        return np.array([0.0 if sensor is None else sensor.std for sensor in sensors])

    def row_sigma(self) -> Array:
        """(N, m): play of the fixture for the gap, accuracy of the sensor for what is read."""
        sigma = np.zeros_like(self.target)
        plays = {fixture.name: fixture.play for fixture in self.machine.fixtures}
        first = next(iter(plays.values()), 0.0)
        sigma[:, :3] = np.array([plays.get(str(label), first) for label in self.poses.fixture])[:, None]
        for i, name in enumerate(self.model.channels[3:], 3):
            if np.any(self.present[:, i]):
                sensor = self.machine.sensor(name)
                if sensor is None or sensor.std == 0:
                    raise ProblemError(f"nothing says how accurately '{name}' is read", where=self.where,
                                       remedy=f"state a sensor with the channel '{name}' in the machine file")
                sigma[:, i] = sensor.std
        return sigma

    def distances(self) -> Distances:
        """Those between fixtures that the poses visit; a fixture that moves takes its distance along."""
        ends, lengths, sigmas = [], [], []
        stages = ["", *(f".{stage}" for stage in dict.fromkeys(map(str, self.poses.stage)))]
        for distance in self.machine.distances:
            note = self.machine.notes.get(f"{distance.name}.length")
            for stage in stages:
                owners = [f"{name}{stage}" for name in distance.between]
                if all(f"{owner}.x" in self.names for owner in owners):
                    ends.append([[self.names[f"{owner}.{axis}"] for axis in "xyz"] for owner in owners])
                    lengths.append(distance.length)
                    sigmas.append((note and note.spread(distance.length)) or EXACT)
        return Distances(np.array(ends, dtype=int).reshape(-1, 2, 3), np.array(lengths), np.array(sigmas))
