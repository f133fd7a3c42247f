"""Joints that a table of poses does not read, but that cylinders' lengths or a rocker's angle in it determine."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hydroopt.model.closed_chain import KinematicModel
from hydroopt.simulation.postures import limits
from hydroopt.spatial.inertia import Array

POSTURES = 5
"""Random positions of the unread joints at which their readings are looked at."""
SMALLEST = 1e-6
"""Part of the largest singular value from which on a direction counts as determined."""


def determined(model: KinematicModel, reading: Array, unread: NDArray[np.bool_],
               present: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which poses (N,) determine all their unread joints, by the nominal geometry, from rows other than the loop's.

    A fixture that holds the tip tells the machine's geometry: which joints it is to tell instead, a stage states.

    Args:
        model: geometry.
        reading: (N, n) joints as read [rad, m].
        unread: (N, n) those that are sought.
        present: (N, m) which rows are read.
    """
    found = np.ones(len(reading), dtype=bool)
    low, high = limits(model)
    rng = np.random.default_rng(0)
    for rows, joints in {(each.tobytes(), other.tobytes()): (each, other)
                         for each, other in zip(present, unread, strict=True) if np.any(other)}.values():
        same = np.flatnonzero(np.all(present == rows, axis=1) & np.all(unread == joints, axis=1))
        q = np.where(joints, rng.uniform(low, high, (POSTURES, len(low))), np.nan_to_num(reading[same[0]]))
        by_q = model.over(model.observed_by_angles, model.parameters.nominal, q,
                          np.zeros((POSTURES, model.place_size)))[1]
        part = by_q[:, model.loop_rows:][:, rows[model.loop_rows:]][:, :, joints]
        ranks = np.linalg.matrix_rank(part, rtol=SMALLEST) if part.shape[1] else np.zeros(1)
        found[same] = ranks.max() == np.sum(joints)
    return found
