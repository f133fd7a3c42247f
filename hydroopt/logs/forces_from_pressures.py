"""Actuator forces of a machine from the pressures in a log (Eq. 4.33, 4.61), and their noise."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hydroopt.logs.any_log import AnyLog
from hydroopt.logs.log import Log
from hydroopt.logs.readings import reading
from hydroopt.machine.actuators import Cylinder
from hydroopt.model.model import Model
from hydroopt.spatial.inertia import Array


def _force_channels(model: Model, log: AnyLog | None, k: int) -> Mapping[str, float]:
    """The channels that an actuator's force is read from, with their factors; pressures where there is no log."""
    joint, actuator = model.machine.joints[k], model.machine.actuators[k]
    direct = f"{actuator.name}.force" if isinstance(actuator, Cylinder) else f"{joint}.tau"
    parts = model.force_from_pressure[actuator.name]
    if log is not None and direct in log.channels and not set(parts) <= set(log.channels):
        return {direct: 1.0}
    return parts


def forces(model: Model, log: Log) -> Array:
    """Measured forces (N, n) of all actuators."""
    factors = [_force_channels(model, log, k) for k in range(len(model.machine.actuators))]
    return np.column_stack([sum((factor * reading(model.machine, log, channel) for channel, factor in parts.items()),
                                np.zeros(log.t.size)) for parts in factors])


def force_noise(model: Model, log: AnyLog | None = None) -> Array:
    """Standard deviation of each actuator's force from its sensors' accuracy (n,); NaN where the file states none.

    The sensors are those of the channels that `log` has, as in `experiment`; those of the pressures without a log.
    """
    stds = []
    for k in range(len(model.machine.actuators)):
        parts = _force_channels(model, log, k)
        sensors = [(model.machine.sensor(channel), factor) for channel, factor in parts.items()]
        stds.append(np.sqrt(sum((s.std * factor) ** 2 if s else np.nan for s, factor in sensors)))
    return np.array(stds)


def _sealing_channels(model: Model) -> Mapping[str, tuple[str, str]]:
    return {cylinder.name: cylinder.chambers for cylinder in model.machine.cylinders
            if cylinder.name in model.machine.sealed}


def pressures(model: Model, log: Log) -> Array | None:
    """The pressures (N, n) [Pa] that the friction of seals depends on; None where none does."""
    machine, pressed = model.machine, _sealing_channels(model)
    return np.column_stack([sum((reading(machine, log, channel) for channel in pressed.get(actuator.name, ())),
                                np.zeros(log.t.size)) for actuator in machine.actuators]) if pressed else None


def force_channels(model: Model, log: AnyLog) -> set[str]:
    """The channels that forces, and the pressures on seals, are read from."""
    parts = (*(_force_channels(model, log, k) for k in range(len(model.machine.actuators))),
             *_sealing_channels(model).values())
    return {channel for part in parts for channel in part}
