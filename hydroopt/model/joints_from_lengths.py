"""Joints of q from the lengths of cylinders that depend on several of them, by Newton's method.

No triangle gives such a joint: a tilt cylinder spans the boom, all six cylinders of a platform move all of its joints.
Every sample is solved by itself: from mid-range, where the lengths are known, they are led to the measured ones in
small steps, so that the joints stay on the branch that mid-range is on.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hydroopt.model.model import Model
from hydroopt.spatial.inertia import Array

ALONG, CORRECTIONS = 16, 2
"""Steps from the lengths at mid-range to the measured ones, and Newton's steps in each of them."""
LAST = 4
"""Newton's steps at the measured lengths."""
STILL = 1e-10
"""Last step [rad or m] from which on Newton's method counts as converged."""


def joints_from_lengths(model: Model, q: Array, solved: Sequence[int], cylinders: Sequence[int],
                        lengths: Array) -> Array:
    """Joint vectors (N, n) at which cylinders have measured lengths; NaN where Newton's method does not converge.

    Args:
        model: the machine.
        q: (N, n) positions of all other joints; those of the joints that are solved for do not matter.
        solved: places of the joints that are solved for, in q.
        cylinders: places of the cylinders in the machine's, at least as many; of more, squares of errors are least.
        lengths: (N, c) [m] of these cylinders.

    >>> from hydroopt.machine.machine_file import load_machine
    >>> model = Model(load_machine("cat215b"))
    >>> q = np.array([[0.1, -0.4, 1.6]])
    >>> lengths = model.over(model.cylinder_kinematics, q, 0 * q, 0 * q)[0][:, :, 0]
    >>> joints_from_lengths(model, np.array([[0.1, 0.0, 0.0]]), [1, 2], [0, 1], lengths).round(9)
    array([[ 0.1, -0.4,  1.6]])
    """
    machine, own, read = model.machine, list(solved), list(cylinders)
    q = q.copy()
    q[:, own] = [sum(machine.link(machine.joints[k]).joint.range) / 2 for k in own]
    begin, step = _lengths(model, q, read)[0], np.full(len(q), np.inf)
    for share, count in [*((k / ALONG, CORRECTIONS) for k in range(1, ALONG + 1)), (1.0, LAST)]:
        for _ in range(count):
            found, arms = _lengths(model, q, read)
            arms = arms[:, :, own]
            usable: NDArray[np.bool_] = np.logical_and(np.isfinite(arms).all(axis=(1, 2)),
                                                       np.isfinite(found).all(axis=1))
            left = np.where(usable[:, None], begin + share * (lengths - begin) - found, np.nan)
            gram = np.where(usable[:, None, None], arms.transpose(0, 2, 1) @ arms, np.eye(len(own)))
            singular = np.linalg.cond(gram) > 1e14
            gram[singular] = np.eye(len(own))
            change = np.linalg.solve(gram, (arms.transpose(0, 2, 1) @ left[:, :, None]))[:, :, 0]
            change[singular] = np.nan
            q[:, own] += change
            step = np.max(np.abs(change), axis=1)
    q[~(step < STILL)] = np.nan
    return q


def _lengths(model: Model, q: Array, cylinders: Sequence[int]) -> tuple[Array, Array]:
    """Lengths (N, c) [m] of cylinders and their lever arms (N, c, n)."""
    length, _, _, arms, _ = model.over(model.cylinder_kinematics, q, 0 * q, 0 * q)
    return length[:, cylinders, 0], arms[:, cylinders]
