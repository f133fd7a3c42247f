"""IMUs that are misread: units, signs or axes with which they would agree with one another."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import permutations, product

import numpy as np

from hydroopt.errors import HydrooptError, SolverError
from hydroopt.estimation.motion.motion_fit import FittedPaths
from hydroopt.estimation.motion.problem import Readings, SensorProblem, fit_motion
from hydroopt.logs.log import Log
from hydroopt.logs.recording import Recording
from hydroopt.machine.sensors import ACCELEROMETER, GYROSCOPE
from hydroopt.results.diagnostic import Diagnostic, Meaning
from hydroopt.spatial.inertia import Array
from hydroopt.units import factor

SHORT, RATE = 15.0, 10.0
"""How much of a log [s], at which rate [Hz], readings are tried on."""
FAR = 3.0
"""Misfit from which on another reading is looked for."""
BETTER = 4.0
"""How many times smaller the misfit of another reading must be, unless all sensors agree with it."""
SOUND = 2.0
"""Misfit of a reading with which all sensors agree."""
TRIAL = 8
"""Steps of a fit that a reading is tried by."""


@dataclass(frozen=True, eq=False)
class Reading:
    """Another way to read a unit: words, a matrix for rates of rotation and one for specific forces (3, 3)."""

    words: str
    gyro: Array
    accel: Array


def readings() -> Iterator[Reading]:
    """Units, signs, then axes."""
    one, degrees, g = np.eye(3), factor("deg", "rad"), factor("g_0", "m/s^2")
    yield Reading("specific forces in g, not in m/s²", one, one * g)
    yield Reading("specific forces in m/s², not in g", one, one / g)
    yield Reading("rates in deg/s, not in rad/s", one * degrees, one)
    yield Reading("rates in rad/s, not in deg/s", one / degrees, one)
    yield Reading("accelerations with the other sign of gravity: at rest +g must point up", one, -one)
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            turn = np.zeros((3, 3))
            turn[range(3), order] = signs
            if np.linalg.det(turn) > 0 and not np.array_equal(turn, one):
                named = ", ".join(f"{axis} = {'-' if sign < 0 else ''}{'xyz'[k]}"
                                  for axis, k, sign in zip("xyz", order, signs, strict=True))
                yield Reading(f"its axes turned: {named} of what is recorded", turn, turn)


def examined_fit(problem: SensorProblem) -> tuple[FittedPaths, Diagnostic | None]:
    """The fit of motion, and how an IMU is misread, if that explains why the sensors do not agree.

    Raises:
        LogError: no channel tells the motion of a joint.
        SolverError: the fit does not converge; the misreading that explains it is named.
    """
    try:
        found = fit_motion(problem)
    except SolverError as error:
        if (cause := misread(problem, None)) is None:
            raise
        raise SolverError(cause.text.rstrip("."), where=error.where, remedy=cause.remedy.rstrip(".")) from None
    return found, misread(problem, found)


def misread(problem: SensorProblem, found: FittedPaths | None) -> Diagnostic | None:
    """The reading of one IMU, or of all alike, that explains why the sensors do not agree; None where none does.

    Args:
        problem: what was asked.
        found: its fit; None where it did not converge.
    """
    short = _short(problem)
    names = [imu.name for imu in problem.machine.imus]
    if not short.logs or not names or (found is not None and _misfit(found) < FAR):
        return None
    functions: Readings = {}
    before = _tried(short, functions)
    best: tuple[float, Diagnostic] | None = None
    for subject in (*([name] for name in names), *([names] if len(names) > 1 else [])):
        for reading in readings():
            after = _tried(replace(short, logs=tuple(_read(log, subject, reading) for log in short.logs)), functions)
            explains = after * BETTER < before or after < SOUND < FAR < before
            if explains and (best is None or after < best[0]):
                log = problem.logs[0]
                best = after, Diagnostic.of("sensor misread", tuple(subject), {
                    "log": log.path or log.name, "reading": reading.words, "before": min(before, 1e6), "after": after},
                    "In {log}, {subject} contradicts the other sensors, and agrees with {reading}: the largest misfit "
                    "falls from {before:.3g} to {after:.3g} times what is stated.",
                    "Correct unit, axes or mounting in the log, its map or the machine file.", Meaning.REFUTATION)
            if best is not None and best[0] < SOUND:
                return best[1]
    return None if best is None else best[1]


def _tried(problem: SensorProblem, functions: Readings) -> float:
    """Misfit after a few steps of a fit to a short log; infinite where there is none."""
    try:
        return _misfit(fit_motion(problem, functions, enough=TRIAL))
    except (HydrooptError, np.linalg.LinAlgError):
        return np.inf


def _misfit(found: FittedPaths) -> float:
    """Largest of: RMS residual over noise of a channel, how far a common number is from its prior over its sigma, over
    two, and how much of a joint's motion lies beyond its range [deg or 0.02 m]."""
    sizes = [0.0]
    for stretch in found.fit.stretches:
        for data in stretch.data:
            left = found.fit.left(stretch, data)
            sizes += [float(np.sqrt(np.mean(left[data.used[:, k], k] ** 2))) for k in range(len(data.channels))
                      if np.any(data.used[:, k])]
        beyond = np.abs(np.median(stretch.path.coefficients, axis=0) - found.fit.middle) - found.fit.span / 2
        sizes += (beyond / np.radians(1.0)).tolist()
    sizes += [abs(found.fit.value[k] - each.prior) / each.sigma / 2 for k, each in enumerate(found.fit.common)]
    return float(np.nan_to_num(np.max(sizes), nan=np.inf))


def _short(problem: SensorProblem) -> SensorProblem:
    """The beginning of its first log, at few samples a second; only IMUs' places are unknown."""
    logs = []
    for log in problem.logs[:1]:
        begin = min(float(group.t[0]) for group in log.groups)
        groups = []
        for group in log.groups:
            every = max(1, round(1 / (RATE * group.step)))
            keep = np.flatnonzero(group.t <= begin + SHORT)[::every]
            if len(keep) > 1:
                groups.append(Log(group.name, group.t[keep], {
                    name: values[keep] for name, values in group.channels.items()}, units=group.units))
        logs.append(replace(log, groups=tuple(groups)))
    return replace(problem, logs=tuple(logs), poses=(), geometry=False)


def _read(log: Recording, names: Sequence[str], reading: Reading) -> Recording:
    """A recording with some units read in another way."""
    groups = []
    for group in log.groups:
        channels = dict(group.channels)
        for name in names:
            for axes, matrix in ((GYROSCOPE, reading.gyro), (ACCELEROMETER, reading.accel)):
                own = [f"{name}.{axis}" for axis in axes]
                if all(channel in channels for channel in own):
                    made = matrix @ np.stack([group.channels[channel] for channel in own])
                    channels |= dict(zip(own, made, strict=True))
        groups.append(replace(group, channels=channels))
    return replace(log, groups=tuple(groups))
