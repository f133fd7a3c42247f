"""Distances of targets from planes and lines that they touch."""

from __future__ import annotations

from collections.abc import Iterator

import casadi as ca

from hydroopt.model.pose_rows.frames import Frames, PoseRows


def rows(frames: Frames) -> Iterator[PoseRows]:
    """Coordinates of a target in a datum's frame, across the datum: zero where it touches."""
    machine = frames.geometry.machine
    for datum in machine.datums:
        for target in machine.target_names:
            channels = tuple(f"{datum.name}.{target}.{axis}" for axis in datum.axes)
            if any(machine.sensor(channel) for channel in channels):
                seen = (frames.datum(datum.name).inverse() @ frames.target(target)).origin
                yield PoseRows(f"{datum.name}.{target}", channels, "m",
                               ca.SX(ca.vertcat(*(seen["xyz".index(axis)] for axis in datum.axes))))
