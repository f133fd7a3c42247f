"""Orientations of targets in the frames of instruments, and that of the tool in the frame of the tracker of the tip."""

from __future__ import annotations

from collections.abc import Iterator

import casadi as ca

from hydroopt.machine.machine import Machine
from hydroopt.machine.survey import TIP
from hydroopt.model.pose_rows.frames import Frames, PoseRows
from hydroopt.spatial.poses import roll_pitch_yaw
from hydroopt.spatial.rotation_vectors import rotation_of, vector_of

TRACKER = "tracker"
"""The instrument that reads the channels of the tip without a name of its own before them."""


def channels(name: str) -> tuple[str, ...]:
    """Channels of an orientation as a rotation vector [rad]."""
    return tuple(f"{name}.{axis}" for axis in ("rx", "ry", "rz"))


def measured(machine: Machine) -> Iterator[tuple[str, str, str]]:
    """What channels begin with, instrument and target of the orientations that a sensor is stated for."""
    pairs = [(f"{instrument.name}.{target}", instrument.name, target)
             for instrument in machine.instruments for target in machine.target_names]
    for name, instrument, target in [*pairs, *([(TIP, TRACKER, TIP)] if machine.tracker else [])]:
        if any(machine.sensor(channel) for channel in channels(name)):
            yield name, instrument, target


def rows(frames: Frames) -> Iterator[PoseRows]:
    """log(Mᵀ·Rᵀ·T): the turn, about the target's own axes, from a reading M to a target turned by T as an instrument
    sees it that is turned by R. With M = 1 it is what the instrument reads."""
    geometry = frames.geometry
    for name, instrument, target in measured(geometry.machine):
        turn = (roll_pitch_yaw(geometry.turn(TRACKER)) if instrument == TRACKER and name == TIP
                else frames.instrument(instrument).rotation)
        reading = rotation_of(frames.inputs[f"{name}.turn"])
        yield PoseRows(f"{name}.turn", channels(name), "rad",
                       ca.SX(vector_of(reading.T @ turn.T @ frames.target(target).rotation)), f"{name}.turn")
