"""Joint angles of a machine from a log: read directly, or from dependent joints or cylinder lengths; their noise."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hydroopt.errors import LogError
from hydroopt.logs.log import Log
from hydroopt.logs.readings import reading
from hydroopt.machine.machine import Machine
from hydroopt.model.joints_from_readings import joints_from_readings, readings
from hydroopt.model.model import Model
from hydroopt.spatial.inertia import Array


class _Sources(NamedTuple):
    """Where joints are read from.

    Attributes:
        channels: of each joint that one channel gives: its own, or the length of the cylinder whose triangle moves it.
        solved: joints that `beside` give together: angles of joints that follow them, lengths of cylinders.
        beside: these channels.
    """

    channels: dict[str, str]
    solved: tuple[str, ...]
    beside: tuple[str, ...]


def _sources(model: Model, log: Log) -> _Sources:
    machine, followed = model.machine, model.machine.followed
    missing = {joint for joint in machine.joints if f"{joint}.q" not in log.channels}
    angles = [joint for joint in machine.dependent_joints
              if f"{joint}.q" in log.channels and missing & set(followed[joint])]
    channels = {joint: _own_channel(model, log, joint) for joint in machine.joints}
    following = {joint for each in angles for joint in followed[each]} & missing
    unread = {joint for joint, channel in channels.items() if channel not in log.channels} - following
    cylinders = [each for each in machine.cylinders if f"{each.name}.length" in log.channels
                 and unread & set(machine.moved_by(each))]
    touched = following | {joint for each in cylinders for joint in machine.moved_by(each)} & unread
    solved = tuple(joint for joint in machine.joints if joint in touched)
    beside = (*(f"{joint}.q" for joint in angles), *(f"{each.name}.length" for each in cylinders))
    if len(beside) < len(solved):
        return _Sources(channels, (), ())
    return _Sources({joint: channel for joint, channel in channels.items() if joint not in touched}, solved, beside)


def _own_channel(model: Model, log: Log, joint: str) -> str:
    """The channel that alone gives a joint."""
    direct, lengths = f"{joint}.q", (f"{each.name}.length" for each in model.machine.drivers[joint]
                                     if each.name in model.triangles)
    return direct if direct in log.channels else next((one for one in lengths if one in log.channels), direct)


def angle_channels(model: Model, log: Log) -> set[str]:
    """The channels that joint angles are read from."""
    sources = _sources(model, log)
    return {*sources.channels.values(), *sources.beside}


def measured_angles(model: Model, log: Log) -> Array:
    """Positions (N, n) of all joints as read.

    From ``<joint>.q``, else from the angle of a joint that follows it, else from the length of the cylinder that moves
    the joint alone, or, where cylinders move several joints, from their lengths together.

    Raises:
        LogError: a channel is missing, or lengths that no posture has.
    """
    machine, sources = model.machine, _sources(model, log)
    q = np.column_stack([np.zeros(log.size) if joint in sources.solved else _angle(model, log, joint)[1]
                         for joint in machine.joints])
    if not sources.solved:
        return q
    measured = np.column_stack([reading(machine, log, channel) for channel in sources.beside])
    q = joints_from_readings(model, q, _places(machine, sources), sources.beside, measured)
    if (lost := np.flatnonzero(~np.isfinite(q).all(axis=1))).size:
        said = ", ".join(f"{channel} = {value:.4g} {machine.channel_units[channel]}"
                         for channel, value in zip(sources.beside, measured[lost[0]], strict=True))
        raise LogError(f"no posture of {', '.join(sources.solved)} on the way from mid-range has the readings at "
                       f"sample {log.sample[lost[0]]}: {said}", where=log.path or log.name,
                       remedy="correct the geometry of the machine file or the sensors' zeros, or read what changes "
                       "steadily with each joint")
    return q


def _places(machine: Machine, sources: _Sources) -> list[int]:
    """Places in q of the joints that are solved for."""
    return [machine.joints.index(joint) for joint in sources.solved]


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
    angles that are solved for errors are propagated at every sample.
    """
    machine, sources = model.machine, _sources(model, log)
    stds = np.full(len(machine.joints), np.nan)
    for k, joint in enumerate(machine.joints):
        if joint in sources.solved:
            continue
        channel, angle = _angle(model, log, joint)
        sensor = machine.sensor(channel)
        std = sensor.std if sensor else np.nan
        if channel != f"{joint}.q":
            length = model.triangles[channel.removesuffix(".length")][0]
            arm = length.jacobian()(angle[None], 0)
            std /= float(np.mean(np.abs(np.asarray(arm))))
        stds[k] = std
    if sources.solved:
        own = _places(machine, sources)
        arms = readings(model, measured_angles(model, log), sources.beside)[1]
        back = np.linalg.pinv(arms[:, :, own])
        # errors of the readings, and of the joints that are read by themselves, which change these as well
        spread = np.array([sensor.std if (sensor := machine.sensor(channel)) else np.nan for channel in sources.beside])
        others = [k for k in range(len(stds)) if k not in own and np.any(arms[:, :, k])]
        parts = [back * spread, *((back @ arms[:, :, [k]]) * stds[k] for k in others)]
        stds[own] = np.sqrt(np.mean(sum(np.sum(part**2, axis=2) for part in parts), axis=0))
    return stds
