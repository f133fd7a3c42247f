"""Measured quantities of a machine in a log: joint angles, actuator forces, pressures, and the noise of each."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hydroopt.errors import LogError
from hydroopt.logs.any_log import AnyLog
from hydroopt.logs.log import Log
from hydroopt.machine.actuators import Cylinder
from hydroopt.machine.machine import Machine
from hydroopt.model.model import Model
from hydroopt.spatial.inertia import Array


def reading(machine: Machine, log: Log, channel: str) -> Array:
    """Values (N,) of a log's channel in the SI unit that the machine has for it.

    Raises:
        LogError: the log has no such channel, or it measures another kind of quantity than the machine's joint.
    """
    values, have, want = log.channel(channel), log.units[channel], machine.channel_units[channel]
    if have != want:
        joint = channel.rpartition(".")[0]
        raise LogError(f"'{channel}' is of the kind '{have}', but the machine's joint '{joint}' is "
                       f"{machine.link(joint).joint.type} and needs '{want}'", where=log.path or log.name,
                       remedy="correct the column's unit or the joint's type")
    return values


def _angle_channel(model: Model, log: AnyLog, joint: str) -> str:
    """The channel that the angle of a joint is read from."""
    actuator = model.machine.actuators[model.machine.joints.index(joint)]
    by_length = f"{actuator.name}.length"
    stands_in = f"{joint}.q" not in log.channels and by_length in log.channels and actuator.name in model.triangles
    return by_length if stands_in else f"{joint}.q"


def measured_angles(model: Model, log: Log) -> Array:
    """Positions (N, n) of all joints as read: from ``<joint>.q`` or from the length of the cylinder that moves it."""
    return np.column_stack([_angle(model, log, joint)[1] for joint in model.machine.joints])


def _angle(model: Model, log: Log, joint: str) -> tuple[str, Array]:
    """The channel that the angle of a joint is read from, and the angle (N,)."""
    channel = _angle_channel(model, log, joint)
    return channel, reading(model.machine, log, channel) if channel == f"{joint}.q" else angle_from_length(
        model, log, channel)


def angle_from_length(model: Model, log: Log, channel: str) -> Array:
    """The joint's angle (N,) by the length of the cylinder that moves it.

    Raises:
        LogError: a length at which the triangle is open.
    """
    values = reading(model.machine, log, channel)
    angle = np.asarray(model.triangles[channel.removesuffix(".length")][1](values)).ravel()
    if (open_at := np.flatnonzero(~np.isfinite(angle))).size:
        first = open_at[0]
        raise LogError(f"'{channel}' is {values[first]:.4g} m at sample {log.sample[first]}, "
                       "at which the triangle of the cylinder is open", where=log.path or log.name,
                       remedy="correct the cylinder's geometry or the transducer's zero")
    return angle


def angle_noise(model: Model, log: Log) -> Array:
    """Standard deviation of each joint's reading (n,); NaN where the machine file states none.

    An angle that comes from a cylinder's length has that of the length over the lever arm's mean over the log.
    """
    machine, stds = model.machine, []
    for joint in machine.joints:
        channel, angle = _angle(model, log, joint)
        sensor = machine.sensor(channel)
        std = sensor.std if sensor else np.nan
        if channel != f"{joint}.q":
            length = model.triangles[channel.removesuffix(".length")][0]
            arm = length.jacobian()(angle[None], 0)
            std /= float(np.mean(np.abs(np.asarray(arm))))
        stds.append(std)
    return np.array(stds)


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


def channels_used(model: Model, log: AnyLog) -> tuple[set[str], set[str]]:
    """The channels that angles are read from, and those that forces and pressures are."""
    parts = (*(_force_channels(model, log, k) for k in range(len(model.machine.actuators))),
             *_sealing_channels(model).values())
    return ({_angle_channel(model, log, joint) for joint in model.machine.joints},
            {channel for part in parts for channel in part})
