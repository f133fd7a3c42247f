"""Orientations as a pose table states them: rotation vectors, or quaternions."""

from __future__ import annotations

from typing import Any

import numpy as np

from hydroopt.errors import ProblemError
from hydroopt.logs.poses import Poses
from hydroopt.spatial.inertia import Array

COMPONENTS = (".rx", ".ry", ".rz", ".qw", ".qx", ".qy", ".qz")
"""Ends of the channels of an orientation: rotation vector [rad], then quaternion."""
NOT_ONE = 1e-2
"""How far the length of a quaternion may be from one by its rounding."""


def turns(poses: Poses) -> dict[str, Array]:
    """All orientations of a table as channels of rotation vectors (N,) [rad]; NaN where nothing was read.

    Raises:
        ProblemError: a quaternion is incomplete or not of length one, a rotation vector is incomplete or longer than
            one turn, or both are stated; the sentence names the row.
    """
    found: dict[str, Array] = {}
    names = dict.fromkeys(name[:-3] for name in poses.channels if name.endswith(COMPONENTS))
    for name in names:
        vector, quaternion = (
            np.stack([poses.channels.get(name + end, np.full(len(poses), np.nan)) for end in ends], axis=1)
            for ends in (COMPONENTS[:3], COMPONENTS[3:]))
        for values, ends in ((vector, COMPONENTS[:3]), (quaternion, COMPONENTS[3:])):
            there = np.isfinite(values)
            for row in np.flatnonzero(there.any(axis=1) & ~there.all(axis=1)):
                lost = name + ends[int(np.argmin(there[row]))]
                raise ProblemError(f"'{lost}' is not stated, but other components of this orientation are",
                                   where=_row(poses, row), remedy="state all components, or none")
        both = np.isfinite(vector[:, 0]) & np.isfinite(quaternion[:, 0])
        if np.any(both):
            raise ProblemError(f"the orientation '{name}' is stated as a rotation vector and as a quaternion",
                               where=_row(poses, np.argmax(both)), remedy="state one of them")
        size = np.linalg.norm(quaternion, axis=1)
        for row in np.flatnonzero(np.abs(size - 1) > NOT_ONE):
            raise ProblemError(f"the quaternion '{name}.qw' to '.qz' has the length {size[row]:.4g}, not 1",
                               where=_row(poses, row), remedy="normalise it, and check that its columns are in the "
                               "order of their headers")
        for row in np.flatnonzero(np.linalg.norm(vector, axis=1) > 2 * np.pi):
            raise ProblemError(f"the rotation vector '{name}.rx' to '.rz' is longer than one turn",
                               where=_row(poses, row), remedy="check its unit")
        values = np.where(np.isfinite(quaternion[:, :1]), _vectors(quaternion), vector)
        found |= {name + end: values[:, k] for k, end in enumerate(COMPONENTS[:3])}
    return found


def _vectors(quaternion: Array) -> Array:
    """Rotation vectors (N, 3) [rad] of quaternions (N, 4), scalar first; the shorter way round."""
    turned = quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)
    turned = np.where(turned[:, :1] < 0, -turned, turned)
    sine = np.linalg.norm(turned[:, 1:], axis=1)
    angle = 2 * np.arctan2(sine, turned[:, 0])
    return np.asarray(turned[:, 1:] * np.where(sine > 1e-9, angle / np.maximum(sine, 1e-9), 2.0)[:, None])


def _row(poses: Poses, row: Any) -> str:
    return f"{poses.file[row] or poses.name}, data row {poses.row[row]}"
