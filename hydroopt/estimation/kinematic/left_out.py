"""Places of poses, each predicted without it: how far off a geometry is where it has not been measured."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hydroopt.estimation.inference.identifiability import INFORMATION_TOLERANCE, significant
from hydroopt.estimation.inference.left_out import BLOCKS, ENOUGH, LeftOut
from hydroopt.estimation.kinematic.observability import Linearised
from hydroopt.estimation.kinematic.problem import CalibrationProblem

FITTED = 1e-9
"""Singular value, relative to the largest, from which on a direction is fitted to the poses of a place themselves."""


def left_out(problem: CalibrationProblem, rows: Linearised) -> tuple[bool, LeftOut]:
    """Predict the poses of each place without them, by rows about the solution; errors in standard deviations of noise.

    A place is a stage. What only its own poses tell, such as where a fixture stood, is fitted to them. Where places
    determine different numbers of the machine, or are too few, blocks of the poses of each place are left out.

    Returns:
        Whether it was places that were left out; squared errors and degrees of freedom of each part.
    """
    places = np.unique(problem.poses.stage, return_inverse=True)[1]
    if places.max(initial=0) + 1 > ENOUGH and (found := _predicted(problem, rows, places)):
        return True, found
    blocks = np.zeros(len(places), dtype=np.int64)
    for place in range(places.max(initial=0) + 1):
        own = np.flatnonzero(places == place)
        blocks[own] = np.arange(len(own)) * BLOCKS // len(own)
    return False, _predicted(problem, rows, blocks) or LeftOut(np.zeros((0, 1)), np.zeros((0, 1)))


def _predicted(problem: CalibrationProblem, rows: Linearised, part: NDArray[np.int64]) -> LeftOut | None:
    """Errors of each part; None where the others do not determine the geometry that all determine."""
    free = np.flatnonzero(problem.free)
    geometry = free < len(problem.model.parameters)
    jacobian = rows.jacobian[:, :, free] * problem.parameters.scale[free]
    shared = rows.shared[:, free] * problem.parameters.scale[free]
    whole, squares, counts = 0, [], []
    for one in (-1, *range(part.max(initial=0) + 1)):
        own = part == one
        others = np.vstack([jacobian[~own].reshape(-1, len(free)), shared])
        size = np.linalg.norm(others, axis=0)
        size[size == 0] = 1.0
        values, vectors = np.linalg.eigh((others / size).T @ (others / size))
        known = significant(values, INFORMATION_TOLERANCE)
        rank = int(np.linalg.matrix_rank(vectors[geometry][:, known]))
        if one < 0:
            whole = rank
            continue
        if rank < whole:
            return None
        vectors = vectors / size[:, None]
        residual = np.concatenate([rows.residual[~own].ravel(), rows.shared_residual])
        change = -(vectors[:, known] / values[known]) @ (vectors[:, known].T @ (others.T @ residual))
        by_own = jacobian[own].reshape(-1, len(free))
        left, s, _ = np.linalg.svd(by_own @ vectors[:, ~known], full_matrices=False)
        left = left[:, s > FITTED * s[0]] if s.size else left
        error = rows.residual[own].ravel() + by_own @ change
        squares.append([float(error @ error - np.sum((left.T @ error) ** 2))])
        counts.append([float(rows.rank[own].sum() - left.shape[1])])
    return LeftOut(np.array(squares), np.maximum(np.array(counts), 0.0))
