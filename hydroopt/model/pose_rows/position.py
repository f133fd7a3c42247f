"""Positions of targets in the frames of instruments."""

from __future__ import annotations

from collections.abc import Iterator

import casadi as ca

from hydroopt.machine.machine import Machine
from hydroopt.model.pose_rows.frames import Frames, PoseRows


def channels(instrument: str, target: str) -> tuple[str, ...]:
    """Channels of a target's position [m]."""
    return tuple(f"{instrument}.{target}.{axis}" for axis in "xyz")


def measured(machine: Machine) -> Iterator[tuple[str, str]]:
    """Instruments and the targets whose positions they measure: those with a sensor."""
    for instrument in machine.instruments:
        for target in machine.target_names:
            if any(machine.sensor(channel) for channel in channels(instrument.name, target)):
                yield instrument.name, target


def rows(frames: Frames) -> Iterator[PoseRows]:
    """Rᵀ·(p − o): a target at p as an instrument sees it that stands at o, turned by R."""
    for instrument, target in measured(frames.geometry.machine):
        seen = frames.instrument(instrument).inverse() @ frames.target(target)
        yield PoseRows(f"{instrument}.{target}", channels(instrument, target), "m", ca.SX(seen.origin))
