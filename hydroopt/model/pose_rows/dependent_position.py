"""Positions of joints that follow others, such as that of a linkage's rocker, where a sensor sits on them."""

from __future__ import annotations

from collections.abc import Iterator

import casadi as ca

from hydroopt.machine.machine import Machine
from hydroopt.model.pose_rows.frames import Frames, PoseRows


def measured(machine: Machine) -> tuple[str, ...]:
    """Channels of the dependent joints that a sensor is stated for."""
    return tuple(f"{joint}.q" for joint in machine.dependent_joints if machine.sensor(f"{joint}.q"))


def inputs(machine: Machine) -> dict[str, int]:
    """What the rows need of a pose: the readings."""
    return dict.fromkeys(measured(machine), 1)


def rows(frames: Frames) -> Iterator[PoseRows]:
    """Position of a dependent joint less its reading [rad or m]; of one that turns within half a turn."""
    machine = frames.geometry.machine
    for channel in measured(machine):
        joint, unit = channel.removesuffix(".q"), machine.channel_units[channel]
        off = ca.SX(frames.joints[joint] - frames.inputs[channel])
        yield PoseRows(channel, (channel,), unit, ca.atan2(ca.sin(off), ca.cos(off)) if unit == "rad" else off, channel)
