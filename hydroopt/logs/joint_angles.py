"""Joint angles of a machine from a log, read directly or computed from cylinder lengths, and their noise."""

from __future__ import annotations

import numpy as np

from hydroopt.errors import LogError
from hydroopt.logs.any_log import AnyLog
from hydroopt.logs.log import Log
from hydroopt.logs.readings import reading
from hydroopt.model.model import Model
from hydroopt.spatial.inertia import Array


def _angle_channel(model: Model, log: AnyLog, joint: str) -> str:
    """The channel that the angle of a joint is read from."""
    direct, lengths = f"{joint}.q", (f"{each.name}.length" for each in model.machine.drivers[joint]
                                     if each.name in model.triangles)
    return direct if direct in log.channels else next((one for one in lengths if one in log.channels), direct)


def angle_channels(model: Model, log: AnyLog) -> set[str]:
    """The channels that joint angles are read from."""
    return {_angle_channel(model, log, joint) for joint in model.machine.joints}


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
