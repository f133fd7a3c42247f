"""Stated distances against what the poses say without them, and a simpler estimate against the most probable one."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from hydroopt.estimation.inference.identifiability import INFORMATION_TOLERANCE, significant
from hydroopt.estimation.kinematic.observability import Linearised
from hydroopt.estimation.kinematic.problem import CalibrationProblem
from hydroopt.parameters.parameter_set import ParameterKind
from hydroopt.spatial.inertia import Array

CONTRADICTS = 4.0
"""Difference, in standard deviations, from which on a stated distance is contradicted."""
OFF = 5.0
"""Distance from the most probable value, in standard deviations, from which on an estimate is off."""


class WrongDistance(NamedTuple):
    """A distance between fixtures [m] as stated and as the poses alone show it, with standard deviations."""

    name: str
    between: tuple[str, str]
    stated: float
    stated_std: float
    measured: float
    measured_std: float


def wrong_distances(problem: CalibrationProblem, linearised: Linearised, noise_scale: float) -> Iterator[WrongDistance]:
    """Distances that the poses contradict; one that several stages show counts by its mean.

    With the leverages H of its rows, the poses without them show the distance by ``(I − H)⁻¹·r`` standard deviations
    beside the stated one, with the covariance ``H·(I − H)⁻¹``.
    """
    free, known = np.flatnonzero(problem.free), problem.distances
    rows = np.vstack([linearised.jacobian[:, :, free].reshape(-1, len(free)), linearised.shared[:, free]])
    if not len(known.length):
        return
    left, s, _ = np.linalg.svd(rows * problem.parameters.scale[free], full_matrices=False)
    left = left[:, s > 1e-9 * s[0]]
    start, names = rows.shape[0] - len(linearised.shared), problem.parameters.names
    ends = [tuple(names[side[0]].partition(".")[0] for side in pair) for pair in known.ends]
    scale = max(1.0, noise_scale) if np.isfinite(noise_scale) else 1.0
    for name in dict.fromkeys(known.names):
        own = [k for k, each in enumerate(known.names) if each == name]
        part = left[[start + k for k in own]]
        leverage = part @ part.T
        values, vectors = np.linalg.eigh(np.eye(len(own)) - leverage)
        if values[0] < 1e-6:  # the poses say nothing without it
            continue
        inverse = vectors / values @ vectors.T
        sigma, mean = float(known.sigma[own[0]]), np.full(len(own), 1 / len(own))
        difference = sigma * float(mean @ inverse @ linearised.shared_residual[own])
        std = sigma * scale * float(np.sqrt(max(mean @ (leverage @ inverse) @ mean, 0.0)))
        if abs(difference) > CONTRADICTS * np.hypot(sigma, std):
            stated = float(known.length[own[0]])
            one, other = ends[own[0]]
            yield WrongDistance(name, (one, other), stated, sigma, stated + difference, std)


def off_optimum(problem: CalibrationProblem, linearised: Linearised, noise_scale: float) -> dict[str, float]:
    """Parameters that are off the most probable values, and by how many of their standard deviations.

    Args:
        problem: also with the drift of locked joints, which simpler methods take as zero.
        linearised: rows about a simpler estimate.
        noise_scale: of its residuals.
    """
    free = problem.free
    free[problem.parameters.places(ParameterKind.DRIFT)] = True
    some = np.flatnonzero(free)
    rows = np.vstack([linearised.jacobian[:, :, some].reshape(-1, len(some)), linearised.shared[:, some]])
    residual = np.concatenate([linearised.residual.ravel(), linearised.shared_residual])
    size = np.linalg.norm(rows, axis=0)
    size = np.where(size > 0, size, 1.0)
    values, vectors = np.linalg.eigh((rows / size).T @ (rows / size))
    good = significant(values, INFORMATION_TOLERANCE)
    half: Array = vectors[:, good] / np.sqrt(values[good])
    step = -half @ (half.T @ ((rows / size).T @ residual))
    freedom = max(len(residual) - len(problem.parameters.names) - int(good.sum()), 1)
    left = residual + rows / size @ step
    scale = max(1.0, min(noise_scale, float(np.sqrt(left @ left / freedom))))
    away = np.abs(step) / np.maximum(np.linalg.norm(half, axis=1) * scale, 1e-300)
    lost = np.linalg.norm(vectors[:, ~good], axis=1) > 1e-5
    found = {problem.parameters.names[k]: float(distance) for k, distance, unknown in zip(some, away, lost, strict=True)
             if not unknown and distance > OFF and problem.free[k]}
    return dict(sorted(found.items(), key=lambda item: -item[1]))
