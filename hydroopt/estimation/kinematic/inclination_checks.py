"""Checks of inclinations at rest against the machine: unit, sign and exchanged axes of what IMUs read."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import permutations

import numpy as np

from hydroopt.errors import ProblemError
from hydroopt.estimation.kinematic.problem import CalibrationProblem
from hydroopt.machine.sensors import ACCELEROMETER, Imu
from hydroopt.spatial.inertia import Array

STRAY = 0.1
"""Part by which the magnitude of specific forces at rest may differ from gravity."""
OFF = 0.3
"""Angle [rad] between felt and expected gravity from which on a mistake is looked for."""
BETTER = 0.2
"""Part of it that must be left otherwise to name the mistake."""
UPRIGHT = np.radians(85.0)
"""Pitch beyond which roll is not defined."""


def refuse_misread_inclination(problem: CalibrationProblem) -> None:
    """Refuse accelerations of another magnitude than gravity, inclinations of upright units, and mistaken axes.

    A mistake of axes is named only if the nominal machine agrees far better with the axes read otherwise.

    Raises:
        ProblemError: which unit, why, and what to do.
    """
    where = f"poses of {problem.poses.name}"
    for imu in problem.model.machine.imus:
        pitch = problem.poses.channels.get(f"{imu.name}.pitch", np.empty(0))
        if np.any(np.abs(pitch) > UPRIGHT):
            row = int(np.argmax(np.abs(pitch) > UPRIGHT))
            raise ProblemError(
                f"'{imu.name}.pitch' is {np.degrees(pitch[row]):.0f} deg, where roll is not defined",
                where=f"{problem.poses.file[row] or problem.poses.name}, data row {problem.poses.row[row]}",
                remedy=f"check its unit, record '{imu.name}.accel_x' to '.accel_z', or turn the unit on its link")
        _refuse_magnitude(problem, imu, where)
        expected, felt, names = _up(problem, imu)
        if len(felt) and (usual := _angle(expected, felt)) > OFF:
            left, words = min(((_angle(expected, other), words) for other, words in _otherwise(felt, names)))
            if left < BETTER * usual:
                raise ProblemError(
                    f"{words}: as they stand, gravity is {np.degrees(usual):.0f} deg off what the nominal machine "
                    f"expects, otherwise {np.degrees(left):.1f} deg", where=where,
                    remedy=f"correct the columns, or the orientation of '{imu.name}' in the machine file")


def _refuse_magnitude(problem: CalibrationProblem, imu: Imu, where: str) -> None:
    felt, gravity = _accelerations(problem, imu), problem.model.machine.gravity
    size = float(np.median(np.linalg.norm(felt, axis=1))) if len(felt) else gravity
    if abs(size - gravity) > STRAY * gravity:
        seem = next((f"; they seem to be {words}" for words, factor in (
            ("g given as m/s^2", gravity), ("mg given as m/s^2", gravity / 1e3), ("m/s^2 given as g", 1 / gravity))
            if abs(size * factor - gravity) < STRAY * gravity), "")
        raise ProblemError(
            f"at rest the accelerations of '{imu.name}' have the magnitude {size:.3g} m/s^2, not that of gravity, "
            f"{gravity:.3g} m/s^2{seem}", where=where,
            remedy="correct the unit in the header or the map, or leave out poses that moved")


def _accelerations(problem: CalibrationProblem, imu: Imu) -> Array:
    """Complete specific forces (K, 3) [m/s²]."""
    channels = problem.poses.channels
    nothing = np.full(len(problem.poses), np.nan)
    felt = np.stack([channels.get(f"{imu.name}.{axis}", nothing) for axis in ACCELEROMETER], axis=1)
    return np.asarray(felt[np.isfinite(felt).all(axis=1)])


def _up(problem: CalibrationProblem, imu: Imu) -> tuple[Array, Array, tuple[str, ...]]:
    """Directions of up (K, 3) in a unit's axes, expected and felt, where all joints are read; and the channels."""
    model, layout = problem.model, problem.layout
    place = problem.places(problem.start)
    place[:, list(model.readings.values())] = 0.0
    predicted = model.over(model.observed, problem.start[: len(model.parameters)], layout.reading, place)[0][:, :, 0]
    for names in (tuple(f"{imu.name}.{axis}" for axis in ACCELEROMETER), (f"{imu.name}.roll", f"{imu.name}.pitch")):
        if not set(names) <= set(model.channels):
            continue
        columns = [model.channels.index(name) for name in names]
        there = layout.present[:, columns].all(axis=1) & ~layout.moving.any(axis=1)
        if np.any(there):
            read = np.stack([problem.poses.channels[name][there] for name in names], axis=1)
            return _direction(predicted[there][:, columns]), _direction(read), names
    return np.zeros((0, 3)), np.zeros((0, 3)), ()


def _direction(values: Array) -> Array:
    """Unit vectors (K, 3) upwards, of specific forces (K, 3) or of roll and pitch (K, 2)."""
    if values.shape[1] == 3:
        return np.asarray(values / np.linalg.norm(values, axis=1, keepdims=True))
    roll, pitch = values.T
    return np.stack([-np.sin(pitch), np.sin(roll) * np.cos(pitch), np.cos(roll) * np.cos(pitch)], axis=1)


def _angle(one: Array, other: Array) -> float:
    """RMS angle [rad] between directions (K, 3)."""
    return float(np.sqrt(np.mean(np.arccos(np.clip(np.sum(one * other, axis=1), -1, 1)) ** 2)))


def _otherwise(felt: Array, names: tuple[str, ...]) -> Iterator[tuple[Array, str]]:
    """Directions with signs and axes read otherwise, with what that means."""
    listed = f"'{names[0]}' to '{names[-1].rpartition('.')[2]}'"
    yield -felt, f"the signs of {listed} seem to be reversed: at rest they point up, as the force that holds the unit"
    for order in permutations(range(3)):
        for signs in np.array(np.meshgrid(*3 * [[1.0, -1.0]])).reshape(3, -1).T:
            if np.linalg.det(np.eye(3)[list(order)] * signs[:, None]) > 0 and (order != (0, 1, 2) or np.any(signs < 0)):
                axes = ", ".join(f"{'-' if sign < 0 else ''}{'xyz'[k]}" for k, sign in zip(order, signs, strict=True))
                yield felt[:, order] * signs, f"the axes of {listed} seem to be exchanged for {axes}"
