"""Distances between two targets, wherever they are."""

from __future__ import annotations

from collections.abc import Iterator

import casadi as ca

from hydroopt.model.pose_rows.frames import Frames, PoseRows

TINY = 1e-9
"""Length [m] that keeps a distance differentiable at zero."""


def rows(frames: Frames) -> Iterator[PoseRows]:
    """|p − q| of the targets at p and q."""
    machine = frames.geometry.machine
    for distance in machine.distances:
        channel = f"{distance.name}.length"
        if distance.measured and machine.sensor(channel):
            one, other = (frames.target(name).origin for name in distance.between)
            yield PoseRows(channel, (channel,), "m", ca.SX(ca.sqrt(ca.sumsqr(one - other) + TINY**2)))
