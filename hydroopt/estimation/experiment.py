"""One log made ready for dynamics: smooth motion and actuator forces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hydroopt.inertia import Array
from hydroopt.machine import Cylinder, Machine
from hydroopt.model.build import Model
from hydroopt.signals.conditioning import Motion, Smoothing, SmoothingSpline, condition
from hydroopt.signals.log import Log


@dataclass(frozen=True, eq=False)
class Experiment:
    """Motion (N, n) and measured actuator forces (N, n) [N or N·m] of one log.

    `inside` (N,) is False near the ends of a stretch, where derivatives of noisy angles are worse: those samples take
    no part in estimation and validation.
    """

    log: Log
    motion: Motion
    force: Array

    @property
    def inside(self) -> Array:
        """Samples that take part (N,)."""
        return self.motion.interior


def experiment(model: Model, log: Log, smoothing: Smoothing | None = None) -> Experiment:
    """Condition a log.

    Joint angles are read from ``<joint>.q`` or, where a log lacks them, from the length of the cylinder that moves the
    joint. Forces are those of the pressures (Eq. 4.33, 4.61), or ``<cylinder>.force`` or ``<joint>.tau`` if present.

    Raises:
        LogError: a channel is missing, or a length at which a triangle is open.
    """
    machine = model.machine
    angles = np.column_stack([_angle(model, log, joint) for joint in machine.joints])
    motion = condition(log.t, angles, log.segment, smoothing or SmoothingSpline(), angle_noise(machine, log),
                       where=log.path or log.name)
    return Experiment(log, motion, np.column_stack([_force(model, log, k) for k in range(len(machine.joints))]))


def _angle(model: Model, log: Log, joint: str) -> Array:
    actuator = model.machine.actuators[model.machine.joints.index(joint)]
    by_length = f"{actuator.name}.length"
    if f"{joint}.q" in log.channels or by_length not in log.channels or actuator.name not in model.triangles:
        return log.channel(f"{joint}.q")
    return np.asarray(model.triangles[actuator.name][1](log.channel(by_length))).ravel()


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
