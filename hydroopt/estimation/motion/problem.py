"""What is asked of sensors: the logs and poses of a machine whose IMUs, clocks and geometry are to be calibrated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import LogError, ProblemError
from hydroopt.estimation.inference.listing import counted
from hydroopt.estimation.motion.motion_fit import FittedPaths, MotionFit, Stretch, solve
from hydroopt.estimation.motion.observations import (
    Common,
    Observations,
    observations,
    row_observations,
)
from hydroopt.estimation.motion.paths import Postures, Spline
from hydroopt.logs.clock import Clock
from hydroopt.logs.frames import all_of
from hydroopt.logs.log import Log
from hydroopt.logs.poses import Poses
from hydroopt.logs.recording import Recording
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import GivenMachine, machine_of
from hydroopt.model.sensor_readings import SensorReadings
from hydroopt.spatial.inertia import Array
from hydroopt.support.notebook_card import Shown

FASTEST = 5.0
"""Frequency [Hz] up to which a machine's motion is resolved whose file states no bandwidth."""
KNOTS = 4.0
"""Knots per period of the fastest motion."""
SHORTEST = 12
"""Samples of a stretch that is fitted."""
PAUSE = 2.0
"""Time [s] without any reading that cuts a motion into two."""
STEP = 0.1
"""Time [s] over which readings are averaged."""
ACCELERATION = 0.7
"""How much links accelerate [m/s²], which a guess by the inclination of gravity leaves out."""
COARSE = {"q": 0.01, "qd": 0.02, "qdd": 1.0, "length": 0.01, "gyro": 0.02, "accel": ACCELERATION, "roll": 0.05,
          "pitch": 0.05, "x": 0.05, "y": 0.05, "z": 0.05}
"""How much readings may differ from a guess [SI], by the kind of channel."""
RATES = ("qd", "gyro")
"""Kinds of channels that tell speeds."""
DRIFT = 0.02
"""How much a joint's speed by the guess errs [rad/s or m/s]."""
SETTLE = 30
"""Steps towards the first posture."""
LARGEST = 0.3
"""Largest step of a joint in one of them [rad or m]."""


@dataclass(frozen=True, eq=False)
class SensorProblem(Shown):
    """The motion of logs, the postures of poses, and what their sensors have in common.

    Attributes:
        machine: the machine; numbers of its geometry with a stated `sigma` are unknown, within that.
        logs: recordings of motion, by any sensors, each channel with the stamps of its group.
        poses: postures at rest; rows of one stage and pose are readings of one posture.
        geometry: whether all of the geometry is unknown; otherwise only where IMUs sit.

    See `sensor_problem`.
    """

    machine: Machine
    logs: tuple[Recording, ...]
    poses: tuple[Poses, ...] = ()
    geometry: bool = True

    def __repr__(self) -> str:
        return (f"SensorProblem({self.machine.name}: {counted(len(self.logs), 'log')}, "
                f"{sum(map(len, self.poses))} rows of poses, {'all geometry' if self.geometry else 'IMUs alone'})")


def sensor_problem(machine: GivenMachine, logs: Log | Recording | Sequence[Log | Recording],
                   poses: Poses | Sequence[Poses] = (), *,
                   geometry: bool = True) -> SensorProblem:
    """The problem of calibrating sensors, clocks and geometry by motion and postures at rest.

    Args:
        machine: the machine.
        logs: of motion, by IMUs, angles, lengths of cylinders, at any mix of rates.
        poses: postures at rest, with readings of the same kinds, and positions of the tip.
        geometry: whether all of the geometry that states a `sigma` is unknown; otherwise only where IMUs sit.

    Raises:
        ProblemError: there is neither a log nor a table of poses.

    >>> import hydroopt as ho
    >>> machine = ho.load_machine("excavator_imu")
    >>> model = ho.Model(machine)
    >>> log = ho.simulate(model, ho.random_trajectory(model, duration=5.0, rate=25.0, seed=1))
    >>> found = ho.solve(ho.sensor_problem(machine, [log]))
    >>> found.parameters["stick_imu.roll"].unit, found.machine.name
    ('rad', 'excavator_imu')
    """
    machine = machine_of(machine, "sensor_problem")
    logs = all_of(logs, (Log, Recording), "log", "sensors")
    poses = all_of(poses, (Poses,), "table of poses", "sensors")
    if not logs and not poses:
        raise ProblemError("there is neither a log nor a table of poses", where="sensors", remedy="give at least one")
    return SensorProblem(machine, tuple(one if isinstance(one, Recording) else Recording.of(one) for one in logs),
                         tuple(poses), geometry)


Readings = dict[tuple[str, ...], SensorReadings]
"""Functions for the readings of channels; a fit adds those that it needs."""


def fit_motion(problem: SensorProblem, readings: Readings | None = None, enough: int | None = None) -> FittedPaths:
    """The most probable motions, postures and common numbers.

    Args:
        problem: what is asked.
        readings: functions of earlier fits of the same machine, if there are any.
        enough: number of steps after which the fit counts as it is then; by default it must converge.

    Raises:
        LogError: no channel tells the motion of a joint.
        SolverError: the fit does not converge.
    """
    machine = problem.machine
    free = {number.name for number in machine.geometry_numbers} if problem.geometry else machine.imu_numbers
    recorded = [_observed(machine, recording) for recording in problem.logs]
    tables = [row_observations(machine, table) for table in problem.poses]
    readings = {} if readings is None else readings
    common: dict[str, Common] = {}
    for data in [*(each for some in recorded for each in some), *tables]:
        if data.channels not in readings:
            readings[data.channels] = SensorReadings(machine, data.channels, free)
        for number, sigma in zip(readings[data.channels].numbers, readings[data.channels].sigma, strict=True):
            common.setdefault(number.name, Common(number.name, number.kind, number.unit, number.value, float(sigma)))
    for data in [*(each for some in recorded for each in some), *tables]:
        common |= data.own_numbers
    stretches = [_spline(machine, readings, part) for some in recorded for part in _parted(some)]
    stretches += [_postures(machine, readings[data.channels], data, _numbered(table))
                  for table, data in zip(problem.poses, tables, strict=True)]
    ranges = machine.ranges
    fastest, span = machine.bandwidth or FASTEST, np.ptp(ranges, axis=1)
    numbers = tuple(common.values())
    start = MotionFit(readings, tuple(stretches), numbers, np.array([each.prior for each in numbers]),
                      (0.1 * span * (2 * np.pi * fastest / 4) ** 3) ** 2 / (2 * fastest), ranges.mean(axis=1), span)
    return solve(start, machine.name, enough)


def _observed(machine: Machine, recording: Recording) -> list[Observations]:
    """What the groups of a recording say about the motion.

    Raises:
        LogError: none of them does.
    """
    where = recording.path or recording.name
    found = [observations(machine, group, recording.clocks.get(group.name, Clock()), where)
             for group in recording.groups]
    found = [data for data in found if data.channels]
    if not found:
        raise LogError("no channel tells the motion of a joint", where=where,
                       remedy="record angles, lengths of cylinders or IMUs that the machine file states")
    return found


def _parted(data: Sequence[Observations]) -> list[tuple[Observations, ...]]:
    """What was sampled together, without pauses."""
    stamps = np.unique(np.concatenate([each.stamped for each in data]))
    cuts = stamps[1:][np.diff(stamps) > PAUSE]
    found = []
    for low, high in pairwise([-np.inf, *cuts.tolist(), np.inf]):
        parts = [each.thinned((each.stamped >= low) & (each.stamped < high)) for each in data]
        parts = [each for each in parts if len(each.t)]
        if sum(len(each.t) for each in parts) >= SHORTEST:
            found.append(tuple(parts))
    return found


def _spline(machine: Machine, readings: Readings, data: tuple[Observations, ...]) -> Stretch:
    times, guess = _first_guess(machine, readings, data)
    stamps = np.sort(np.concatenate([each.stamped for each in data]))
    spacing = 1 / (KNOTS * (machine.bandwidth or FASTEST))
    if memory := max(each.memory for each in data):  # what lagging sensors remember was before the first reading
        stamps = np.insert(stamps, 0, stamps[0] - memory - spacing)
    intervals = int(np.ceil((stamps[-1] - stamps[0]) / spacing))
    return Stretch(Spline.over(stamps, intervals, guess.shape[1]).near(times, guess), data)


def _numbered(table: Poses) -> NDArray[np.intp]:
    """The number of the posture that each row of a table was read in: rows of one stage and pose are of one."""
    labels = [f"{stage}/{pose}" for stage, pose in zip(table.stage, table.pose, strict=True)]
    return np.asarray(np.unique(labels, return_inverse=True)[1], dtype=np.intp)


def _postures(machine: Machine, made: SensorReadings, data: Observations, number: NDArray[np.intp]) -> Stretch:
    found: list[Array] = []
    for k in range(int(number.max()) + 1):
        here = number == k
        at_once = replace(data.thinned(here), t=np.zeros(int(np.sum(here))))
        found.append(_first_guess(machine, {data.channels: made}, (at_once,))[1][0])
    return Stretch(Postures(np.array(found)), (replace(data, t=number.astype(float)),))


def _first_guess(machine: Machine, readings: Mapping[tuple[str, ...], SensorReadings],
                data: Sequence[Observations]) -> tuple[Array, Array]:
    """Times (M,) and joint positions (M, n) over a stretch, by a filter with the nominal geometry.

    Args:
        machine: the machine.
        readings: by channels.
        data: what was read along the stretch; every group of channels by its own stamps.

    Raises:
        LogError: no reading depends on some joint.
    """
    begin, end = min(each.stamped[0] for each in data), max(each.stamped[-1] for each in data)
    count = int((end - begin) / STEP) + 1
    means = [_means(each, begin, count) for each in data]
    kinds = [[channel.rpartition(".")[2].partition("_")[0] for channel in each.channels] for each in data]
    noise = [np.array([COARSE[kind] for kind in own]) for own in kinds]
    rates = [np.array([kind in RATES for kind in own], dtype=bool) for own in kinds]
    made = [readings[each.channels] for each in data]
    given = [np.array([number.value for number in each.numbers]) for each in made]
    ranges = machine.ranges
    q, spread = ranges.mean(axis=1), np.diag(np.ptp(ranges, axis=1) ** 2)
    speed, depends = np.zeros_like(q), np.zeros(len(q), dtype=bool)
    path = np.empty((count, len(q)))
    for k in range(count):
        ahead = spread + np.eye(len(q)) * (DRIFT * STEP) ** 2
        predicted = q + speed * STEP * (k > 0)
        found = predicted
        for _ in range(SETTLE if k == 0 else 1):
            information, right = np.linalg.inv(ahead), np.linalg.solve(ahead, predicted)
            turning, turned = np.eye(len(q)), np.zeros(len(q))  # speeds are of the order of one
            for read, g, sigma, rate, (values, weight) in zip(made, given, noise, rates, means, strict=True):
                state = found[None]
                expected, by_q, by_qd, _, _ = read(state, 0 * state, 0 * state, g)
                own = weight[k] & np.isfinite(expected[0])
                depends |= np.any(by_q[0] != 0, axis=0) | np.any(by_qd[0] != 0, axis=0)
                left = (values[k] - expected[0]) / sigma
                placed = own & ~rate
                rows = by_q[0][placed] / sigma[placed, None]
                information += rows.T @ rows
                right += rows.T @ (left[placed] + rows @ found)
                placed = own & rate
                rows = by_qd[0][placed] / sigma[placed, None]
                turning += rows.T @ rows
                turned += rows.T @ left[placed]
            step = np.linalg.solve(information, right) - found
            found = found + np.clip(step, -LARGEST, LARGEST)
        speed = np.linalg.solve(turning, turned)
        q, spread = found, np.linalg.inv(information)
        path[k] = q
    if not depends.all():
        joint = machine.joints[int(np.flatnonzero(~depends)[0])]
        turns = machine.position_unit(joint) == "rad"  # of a joint that slides, an IMU tells accelerations at most
        raise LogError(f"no reading depends on the joint '{joint}'" if turns else
                       f"no reading determines the position of the joint '{joint}', which slides", where=data[0].name,
                       remedy="record its angle, the length of its cylinder, or an IMU on the link that it moves"
                       if turns else "record it, or the length of its cylinder")
    return np.asarray(begin + STEP * (np.arange(count) + 0.5), dtype=np.float64), path


def _means(data: Observations, begin: float, count: int) -> tuple[Array, NDArray[np.bool_]]:
    """Means (count, m) over steps of time, and which of them hold a reading."""
    bins = np.minimum(((data.stamped - begin) / STEP).astype(int), count - 1)
    number, total = np.zeros((2, count, len(data.channels)))
    np.add.at(number, bins, data.used)
    np.add.at(total, bins, np.where(data.used, data.values, 0.0))
    held = number > 0
    return np.divide(total, number, out=np.zeros((count, len(data.channels))), where=held), held
