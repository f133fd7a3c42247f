"""One log made ready for dynamics: smooth motion and actuator forces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import LogError
from hydroopt.inertia import Array
from hydroopt.machine import Machine
from hydroopt.model.build import Model
from hydroopt.parts import Cylinder
from hydroopt.signals.conditioning import Motion, Smoothing, SmoothingSpline, condition
from hydroopt.signals.log import Log

NOISE_FACTOR, OVERSHOOT, STANDSTILL = 4.0, 0.15, 1e-6
"""A joint counts as standing still below this many standard deviations of its velocity's noise, below this part of its
RMS speed (smoothing lets an abrupt stop ring, so that slower readings may have the wrong sign), and below this speed in
rad/s or m/s."""

SELDOM = 0.01
"""A joint that seems to move in less than this part of the samples stands still: noise alone does as much."""


@dataclass(frozen=True, eq=False)
class Experiment:
    """Motion (N, n) and measured actuator forces (N, n) [N or N·m] of one log.

    `inside` (N,) is False near the ends of a stretch, where derivatives of noisy angles are worse: those samples take
    no part in estimation and validation. `moving` (N, n) is False where a joint is too slow for the sign of its
    velocity, and so of its dry friction, to be known (Eq. 4.51): those take no part in estimation.
    """

    log: Log
    motion: Motion
    force: Array
    moving: NDArray[np.bool_]

    @property
    def inside(self) -> NDArray[np.bool_]:
        """Samples that take part (N,)."""
        return self.motion.interior

    @property
    def notes(self) -> tuple[str, ...]:
        """What was done to the log, in plain words."""
        still = np.sum(self.inside[:, None] & ~self.moving, axis=0)
        left_out = f"{int(np.sum(~self.inside))} of {len(self.inside)} samples at the ends of stretches left out"
        return (*self.motion.notes, left_out,
                f"standing still (no sign of friction) per joint: {still.tolist()} samples")


def experiment(model: Model, log: Log, smoothing: Smoothing | None = None) -> Experiment:
    """Condition a log.

    Joint angles are read from ``<joint>.q`` or, where a log lacks them, from the length of the cylinder that moves the
    joint. Forces are those of the pressures (Eq. 4.33, 4.61), or ``<cylinder>.force`` or ``<joint>.tau`` if present.

    Raises:
        LogError: a channel is missing, or a length at which a triangle is open.
    """
    machine = model.machine
    angles = np.column_stack([_angle(model, log, joint) for joint in machine.joints])
    smoothing = smoothing or SmoothingSpline(bandwidth=machine.bandwidth)
    motion = condition(log.t, angles, log.segment, smoothing, angle_noise(machine, log),
                       names=machine.joints, where=log.path or log.name)
    force = np.column_stack([_force(model, log, k) for k in range(len(machine.joints))])
    rms_speed = np.sqrt(np.mean(motion.qd**2, axis=0))
    slow = np.maximum(NOISE_FACTOR * _velocity_noise(angles, motion), OVERSHOOT * rms_speed)
    moving = np.abs(motion.qd) > np.maximum(slow, STANDSTILL)
    return Experiment(log, motion, force, moving & (np.mean(moving, axis=0) > SELDOM))


def _velocity_noise(angles: Array, motion: Motion) -> Array:
    """Standard deviation of the smoothed velocities (n,): white noise, low-passed and differentiated.

    σ_v² = ∫₀^f (2πν)²·2σ²Δt dν with the smoother's bandwidth f and the σ of what it took out.
    """
    sigma = np.std(angles - motion.q, axis=0)
    step = float(np.median(np.diff(motion.t)))
    bandwidth = np.clip(motion.bandwidth, 1 / float(motion.t[-1] - motion.t[0]), 0.5 / step)
    return np.asarray(sigma * np.sqrt(8 / 3 * np.pi**2 * step * bandwidth**3))


def _angle(model: Model, log: Log, joint: str) -> Array:
    actuator = model.machine.actuators[model.machine.joints.index(joint)]
    by_length = f"{actuator.name}.length"
    if f"{joint}.q" in log.channels or by_length not in log.channels or actuator.name not in model.triangles:
        return log.channel(f"{joint}.q")
    angle = np.asarray(model.triangles[actuator.name][1](log.channel(by_length))).ravel()
    if (open_at := np.flatnonzero(~np.isfinite(angle))).size:
        first = open_at[0]
        raise LogError(f"'{by_length}' is {log.channel(by_length)[first]:.4g} m at sample {log.sample[first]}, "
                       "at which the triangle of the cylinder is open", where=log.path or log.name,
                       remedy="correct the cylinder's geometry or the transducer's zero")
    return angle


def _force(model: Model, log: Log, k: int) -> Array:
    joint, actuator = model.machine.joints[k], model.machine.actuators[k]
    direct = f"{actuator.name}.force" if isinstance(actuator, Cylinder) else f"{joint}.tau"
    parts = model.force_from_pressure[actuator.name]
    if direct in log.channels and not set(parts) <= set(log.channels):
        return log.channel(direct)
    total: Array = sum((factor * log.channel(channel) for channel, factor in parts.items()), np.zeros(log.t.size))
    return total


def angle_noise(machine: Machine, log: Log) -> Array | None:
    """Standard deviation of each joint's reading (n,), or None if the machine file does not state all of them."""
    sensors = [machine.sensor(f"{joint}.q") for joint in machine.joints]
    if any(s is None for s in sensors) or any(f"{joint}.q" not in log.channels for joint in machine.joints):
        return None
    return np.array([s.std for s in sensors if s is not None])


def force_noise(model: Model) -> Array:
    """Standard deviation of each actuator's force from its sensors' accuracy (n,); NaN where the file states none."""
    stds = []
    for parts in model.force_from_pressure.values():
        sensors = [(model.machine.sensor(channel), factor) for channel, factor in parts.items()]
        stds.append(np.sqrt(sum((s.std * factor) ** 2 if s else np.nan for s, factor in sensors)))
    return np.array(stds)
