"""Joint angles of a machine from a log, read directly or computed from cylinder lengths, and their noise."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hydroopt.errors import LogError
from hydroopt.logs.any_log import AnyLog
from hydroopt.logs.log import Log
from hydroopt.logs.readings import reading
from hydroopt.machine.machine import Machine
from hydroopt.model.joints_from_lengths import joints_from_lengths
from hydroopt.model.model import Model
from hydroopt.spatial.inertia import Array


class _Sources(NamedTuple):
    """Where joints are read from.

    Attributes:
        channels: of each joint that one channel gives: its own, or the length of the cylinder whose triangle moves it.
        together: joints that the lengths of `cylinders` give together.
        cylinders: the names of these.
    """

    channels: dict[str, str]
    together: tuple[str, ...]
    cylinders: tuple[str, ...]


def _sources(model: Model, log: AnyLog) -> _Sources:
    machine = model.machine
    channels = {joint: _own_channel(model, log, joint) for joint in machine.joints}
    unread = [joint for joint, channel in channels.items() if channel not in log.channels]
    cylinders = tuple(each.name for each in machine.cylinders if f"{each.name}.length" in log.channels
                      and set(unread) & set(machine.moved_by(each)))
    together = tuple(joint for joint in unread if any(joint in machine.moved_by(each) for each in machine.cylinders
                                                      if each.name in cylinders))
    if len(cylinders) < len(together):
        return _Sources(channels, (), ())
    return _Sources({joint: channel for joint, channel in channels.items() if joint not in together}, together,
                    cylinders)


def _own_channel(model: Model, log: AnyLog, joint: str) -> str:
    """The channel that alone gives a joint."""
    direct, lengths = f"{joint}.q", (f"{each.name}.length" for each in model.machine.drivers[joint]
                                     if each.name in model.triangles)
    return direct if direct in log.channels else next((one for one in lengths if one in log.channels), direct)


def angle_channels(model: Model, log: AnyLog) -> set[str]:
    """The channels that joint angles are read from."""
    sources = _sources(model, log)
    return {*sources.channels.values(), *(f"{name}.length" for name in sources.cylinders)}


def measured_angles(model: Model, log: Log) -> Array:
    """Positions (N, n) of all joints as read.

    From ``<joint>.q``, from the length of the cylinder that moves the joint alone, or, where cylinders move several
    joints, from their lengths together.

    Raises:
        LogError: a channel is missing, or lengths that no posture has.
    """
    machine, sources = model.machine, _sources(model, log)
    q = np.column_stack([np.zeros(log.size) if joint in sources.together else _angle(model, log, joint)[1]
                         for joint in machine.joints])
    if not sources.together:
        return q
    lengths = np.column_stack([reading(machine, log, f"{name}.length") for name in sources.cylinders])
    q = joints_from_lengths(model, q, *_places(machine, sources), lengths)
    if (lost := np.flatnonzero(~np.isfinite(q).all(axis=1))).size:
        said = ", ".join(f"{name} = {value:.4g} m" for name, value in zip(sources.cylinders, lengths[lost[0]],
                                                                         strict=True))
        raise LogError(f"no posture of {', '.join(sources.together)} on the way from mid-range has the lengths at "
                       f"sample {log.sample[lost[0]]}: {said}", where=log.path or log.name,
                       remedy="correct the cylinders' geometry, or the transducers' zeros")
    return q


def _places(machine: Machine, sources: _Sources) -> tuple[list[int], list[int]]:
    """Places of joints in q and of cylinders in the machine's."""
    names = [each.name for each in machine.cylinders]
    return ([machine.joints.index(joint) for joint in sources.together],
            [names.index(name) for name in sources.cylinders])


def _angle(model: Model, log: Log, joint: str) -> tuple[str, Array]:
    """The channel that the angle of a joint is read from, and the angle (N,)."""
    channel = _own_channel(model, log, joint)
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

    An angle that comes from a cylinder's length has that of the length over the lever arm's mean over the log; of
    angles that come from several lengths together errors are propagated at every sample.
    """
    machine, sources = model.machine, _sources(model, log)
    stds = np.full(len(machine.joints), np.nan)
    for k, joint in enumerate(machine.joints):
        if joint in sources.together:
            continue
        channel, angle = _angle(model, log, joint)
        sensor = machine.sensor(channel)
        std = sensor.std if sensor else np.nan
        if channel != f"{joint}.q":
            length = model.triangles[channel.removesuffix(".length")][0]
            arm = length.jacobian()(angle[None], 0)
            std /= float(np.mean(np.abs(np.asarray(arm))))
        stds[k] = std
    if sources.together:
        own, read = _places(machine, sources)
        q = measured_angles(model, log)
        arms = model.over(model.cylinder_kinematics, q, 0 * q, 0 * q)[3][:, read]
        back = np.linalg.pinv(arms[:, :, own])
        # errors of the lengths, and of the joints that are read, which change the lengths as well
        spread = np.array([sensor.std if (sensor := machine.sensor(f"{name}.length")) else np.nan
                           for name in sources.cylinders])
        others = [k for k in range(len(stds)) if k not in own and np.any(arms[:, :, k])]
        parts = [back * spread, *((back @ arms[:, :, [k]]) * stds[k] for k in others)]
        stds[own] = np.sqrt(np.mean(sum(np.sum(part**2, axis=2) for part in parts), axis=0))
    return stds
