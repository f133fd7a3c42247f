"""Joints of q from readings that depend on them: lengths of cylinders, angles of joints that follow them; by Newton.

No closed form gives such a joint: a tilt cylinder spans the boom, all six cylinders of a platform move all of its
joints, a sensor sits on the rocker of a linkage. Every sample is solved by itself: from mid-range, where the readings
are known, they are led to the measured ones in small steps, so that the joints stay on the branch that mid-range is
on.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hydroopt.model.model import Model
from hydroopt.spatial.inertia import Array

ALONG, CORRECTIONS = 16, 2
"""Steps from the readings at mid-range to the measured ones, and Newton's steps in each of them."""
LAST = 4
"""Newton's steps at the measured readings."""
STILL = 1e-10
"""Last step [rad or m] from which on Newton's method counts as converged."""


def joints_from_readings(model: Model, q: Array, solved: Sequence[int], channels: Sequence[str],
                         measured: Array) -> Array:
    """Joint vectors (N, n) at which readings are the measured ones; NaN where Newton's method does not converge.

    Args:
        model: the machine.
        q: (N, n) positions of all other joints; those of the joints that are solved for do not matter.
        solved: places of the joints that are solved for, in q.
        channels: ``<cylinder>.length`` or ``<dependent joint>.q``, at least as many; of more, squares of errors are
            least.
        measured: (N, c) [m or rad] of these channels; angles are those nearest to mid-range, whatever turns they count.

    >>> from hydroopt.machine.machine_file import load_machine
    >>> model = Model(load_machine("excavator_bucket"))
    >>> q = np.array([[0.1, -0.4, -1.6, -0.3]])
    >>> channels = ["stick_cylinder.length", "rocker.q"]
    >>> measured, _ = readings(model, q, channels)
    >>> joints_from_readings(model, q * [1, 1, 0, 0], [2, 3], channels, measured).round(9)
    array([[ 0.1, -0.4, -1.6, -0.3]])
    """
    machine, own = model.machine, list(solved)
    q = q.copy()
    q[:, own] = [sum(machine.link(machine.joints[k]).joint.range) / 2 for k in own]
    begin, step = readings(model, q, channels)[0], np.full(len(q), np.inf)
    turning = [machine.channel_units[channel] == "rad" for channel in channels]
    whole = np.where(turning, 2 * np.pi * np.round((measured - begin) / (2 * np.pi)), 0.0)
    away = measured - whole - begin
    for share, count in [*((k / ALONG, CORRECTIONS) for k in range(1, ALONG + 1)), (1.0, LAST)]:
        for _ in range(count):
            found, arms = readings(model, q, channels)
            arms = arms[:, :, own]
            usable: NDArray[np.bool_] = np.logical_and(np.isfinite(arms).all(axis=(1, 2)),
                                                       np.isfinite(found).all(axis=1))
            left = np.where(usable[:, None], begin + share * away - found, np.nan)
            gram = np.where(usable[:, None, None], arms.transpose(0, 2, 1) @ arms, np.eye(len(own)))
            singular = np.linalg.cond(gram) > 1e14
            gram[singular] = np.eye(len(own))
            change = np.linalg.solve(gram, (arms.transpose(0, 2, 1) @ left[:, :, None]))[:, :, 0]
            change[singular] = np.nan
            q[:, own] += change
            step = np.max(np.abs(change), axis=1)
    q[~(step < STILL)] = np.nan
    return q


def readings(model: Model, q: Array, channels: Sequence[str]) -> tuple[Array, Array]:
    """Lengths of cylinders, positions of dependent joints (N, c) [m or rad] by channel, and derivatives (N, c, n)."""
    machine = model.machine
    found: dict[str, tuple[Array, Array]] = {}
    if any(channel.endswith(".length") for channel in channels):
        length, _, _, arms, _ = model.over(model.cylinder_kinematics, q, 0 * q, 0 * q)
        found |= {f"{each.name}.length": (length[:, k, 0], arms[:, k]) for k, each in enumerate(machine.cylinders)}
    if any(channel.endswith(".q") for channel in channels):
        position, by_q = model.over(model.dependent_positions, q)
        found |= {f"{joint}.q": (position[:, k, 0], by_q[:, k]) for k, joint in enumerate(machine.dependent_joints)}
    return (np.column_stack([found[channel][0] for channel in channels]),
            np.stack([found[channel][1] for channel in channels], axis=1))
