"""Inclination at rest: roll and pitch of inertial measurement units, and the direction of gravity that they feel."""

from __future__ import annotations

from collections.abc import Iterator

import casadi as ca

from hydroopt.machine.machine import Machine
from hydroopt.machine.sensors import ACCELEROMETER, INCLINATION, Imu
from hydroopt.model.pose_rows.frames import Frames, PoseRows
from hydroopt.spatial.poses import roll_pitch_yaw


def angles(machine: Machine, imu: Imu) -> tuple[str, ...]:
    """Channels of a unit's roll and pitch [rad] that a sensor is stated for."""
    names = (f"{imu.name}.{angle}" for angle in INCLINATION)
    return tuple(name for name in names if machine.sensor(name))


def inputs(machine: Machine) -> dict[str, int]:
    """Sizes of what the rows need of a pose: roll and pitch as read, and an accelerometer's bias."""
    found = {f"{imu.name}.inclination": len(angles(machine, imu)) for imu in machine.imus if angles(machine, imu)}
    return found | {f"{imu.name}.bias": 3 for imu in machine.imus if imu.accelerometer}


def rows(frames: Frames) -> Iterator[PoseRows]:
    """Roll and pitch of a unit's axes less those that it reads, within half a turn; and g·Rᵀ·up + bias."""
    machine = frames.geometry.machine
    up = roll_pitch_yaw(machine.orientation).T @ ca.DM([0.0, 0.0, 1.0])
    for imu in machine.imus:
        turn = frames.link(imu.link).rotation @ roll_pitch_yaw(frames.geometry.turn(imu.name))
        x, y, z = ca.vertsplit(ca.SX(turn.T @ up))
        if channels := angles(machine, imu):
            both = {"roll": ca.atan2(y, z), "pitch": ca.atan2(-x, ca.sqrt(y**2 + z**2))}
            off = ca.vertcat(*(both[name.rpartition(".")[2]] for name in channels)) - frames.inputs[
                f"{imu.name}.inclination"]
            yield PoseRows(f"{imu.name}.inclination", channels, "rad", ca.atan2(ca.sin(off), ca.cos(off)),
                           f"{imu.name}.inclination")
        if imu.accelerometer:
            yield PoseRows(f"{imu.name}.accel", tuple(f"{imu.name}.{axis}" for axis in ACCELEROMETER), "m/s^2",
                           machine.gravity * ca.vertcat(x, y, z) + frames.inputs[f"{imu.name}.bias"])
