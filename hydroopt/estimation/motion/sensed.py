"""The motion of a log whose rates or accelerations are measured, or whose positions lag, in the place of smoothed and
differentiated angles."""

from __future__ import annotations

import pickle
from dataclasses import replace
from hashlib import sha256
from typing import Any, NamedTuple

import numpy as np

from hydroopt.errors import LogError
from hydroopt.estimation.motion.misread import examined_fit
from hydroopt.estimation.motion.motion_fit import FittedPaths
from hydroopt.estimation.motion.observations import motion_channels
from hydroopt.estimation.motion.paths import motion
from hydroopt.estimation.motion.problem import FASTEST, SensorProblem
from hydroopt.logs.log import Log
from hydroopt.logs.recording import Recording
from hydroopt.logs.smoothing import Motion, inside
from hydroopt.machine.machine import Machine
from hydroopt.results.diagnostic import Diagnostic
from hydroopt.spatial.inertia import Array

KEPT = 4
"""Fits that are kept, so that preparing the same logs again, as for each set of friction, does not repeat them."""
FORCES = frozenset({"body", "friction", "circuit", "oil", "pump", "total_masses", "identical"})
"""Keys of a machine file of which motion knows nothing."""
_kept: dict[bytes, tuple[FittedPaths, Diagnostic | None]] = {}
POSITIONS = ("q", "length")
"""Endings of channels that tell positions, which alone call for no fit."""


def calls_for_fit(machine: Machine, log: Log) -> bool:
    """Whether a log has rates, accelerations or inclinations with a stated accuracy, or positions that lag."""
    return any(channel.rpartition(".")[2] not in (*POSITIONS, "x", "y", "z") or machine.lag(channel).value
               for channel in motion_channels(machine, log.channels))


class Sensed(NamedTuple):
    """A log with the fitted positions, the fitted motion at its samples, and the RMS standard deviation (n,) of the
    joints' positions in it."""

    log: Log
    motion: Motion
    position_std: Array


def sensed(machine: Machine, log: Log) -> Sensed:
    """The motion of a log by all its sensors.

    Of the geometry only the places of IMUs count as uncertain: calibrate it before.

    Raises:
        LogError: a joint's motion is not measured, or an IMU is misread.
        SolverError: the fit does not converge.
    """
    recording = Recording.of(log)
    found, cause = _kept_fit(SensorProblem(machine, (recording,), geometry=False))
    if cause is not None:
        raise LogError(cause.text.rstrip("."), where=log.path or log.name, remedy=cause.remedy.rstrip("."))
    t = _taken(found, log, recording)
    made = np.full((3, log.size, len(machine.joints)), np.nan)
    std = np.full(made.shape[1:], np.nan)
    for k, stretch in enumerate(found.fit.stretches):
        here = (t >= stretch.begin) & (t <= stretch.end)
        support = stretch.path.support(t[here])
        made[:, here] = motion(stretch.path, support)[:3]
        std[here] = found.std(k, support)
    kept = np.isfinite(made).all(axis=(0, 2))
    used = replace(log, t=log.t[kept], sample=log.sample[kept], segment=log.segment[kept],
                   channels={name: values[kept] for name, values in log.channels.items()})
    angles = {f"{joint}.q": made[0, kept, j] for j, joint in enumerate(machine.joints)}
    used = replace(used, channels={**used.channels, **angles},
                   units={**used.units, **{name: machine.channel_units[name] for name in angles}})
    bandwidth = np.full(len(machine.joints), machine.bandwidth or FASTEST)
    interior = np.concatenate([inside(used.t[used.segment == number], bandwidth) for number in np.unique(used.segment)])
    position_std = np.sqrt(np.nanmean(std**2, axis=0))
    said = ", ".join(f"{joint} {_spread(value, machine.position_unit(joint))}" for joint, value in zip(
        machine.joints, position_std, strict=True))
    note = f"motion fitted to {len(motion_channels(machine, log.channels))} channels; standard deviations: {said}"
    q, qd, qdd = made[:, kept]
    return Sensed(used, Motion(used.t, q, qd, qdd, used.segment, interior, bandwidth,
                               np.ones(len(machine.joints), dtype=int), (note,)), position_std)


def _kept_fit(problem: SensorProblem) -> tuple[FittedPaths, Diagnostic | None]:
    """As `examined_fit`, but once for the same recording and machine, whatever its bodies and friction."""
    machine = problem.machine
    notes = {path: note for path, note in machine.notes.items() if not {"body", "friction"} & set(path.split("."))}
    motion = _without_forces(machine.model_dump(exclude={"notes"}))
    key = sha256(pickle.dumps((repr((motion, notes)), problem.logs))).digest()
    if key not in _kept:
        _kept[key] = examined_fit(problem)
        if len(_kept) > KEPT:
            del _kept[next(iter(_kept))]
    return _kept[key]


def _without_forces(stated: Any) -> Any:
    if isinstance(stated, dict):
        return {key: _without_forces(value) for key, value in stated.items() if key not in FORCES}
    return [_without_forces(each) for each in stated] if isinstance(stated, list | tuple) else stated


def _taken(found: FittedPaths, log: Log, recording: Recording) -> Array:
    """When the samples (N,) of a log were taken [s], by the clock that the fit gives those of its stamps."""
    grid = recording.grid
    for data in found.fit.stretches[0].data:
        if set(data.channels) <= set(grid.channels):
            stamps = log.t * (1 + data.clock.drift) + data.clock.delay
            delay, drift = found.fit.clock(data)
            return np.asarray((stamps - delay) / (1 + drift))
    return log.t


def _spread(value: float, unit: str) -> str:
    return f"{1e3 * value:.2g} mm" if unit == "m" else f"{np.degrees(value):.2g} deg"

