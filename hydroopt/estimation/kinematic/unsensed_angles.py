"""Angles of joints that move without a sensor: initial guesses, and the angles that close the loops."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hydroopt.estimation.kinematic.pose_equations import PoseEquations
from hydroopt.spatial.inertia import Array

TIGHT = 1e-11
"""Gap [m] of a loop that counts as closed."""
STEPS = 20
"""Steps of Newton's method towards the unsensed angles of the nominal machine."""
GUESSES = 24
"""Angles tried for a joint that moves unsensed, over its range."""


def guess_unsensed(problem: PoseEquations, theta: Array) -> Array:
    """Initial joint vectors (N, n): readings, and for joints that move unsensed the angle that closes best."""
    layout, model = problem.layout, problem.model
    q = problem.angles(theta, layout.reading)
    moving = np.flatnonzero(layout.moving.any(axis=0))
    if not moving.size:
        return q
    ranges = np.array([link.joint.range for link in model.links if link.joint.independent])[moving]
    rng = np.random.default_rng(0)
    unread = layout.moving.any(axis=1)
    loops_only = bool(np.all(layout.held[unread]))  # the gap determines the angle, and is quicker than all rows
    function, count = (model.loop, model.loop_rows) if loops_only else (model.observed, layout.present.shape[1])
    best, least = q.copy(), np.full(len(q), np.inf)
    for k in range(GUESSES * len(moving)):
        share = (k + 0.5) / GUESSES if len(moving) == 1 else rng.uniform(size=len(moving))
        trial = q.copy()
        trial[:, moving] = np.where(layout.moving[:, moving], ranges[:, 0] + share * (ranges[:, 1] - ranges[:, 0]),
                                    q[:, moving])
        rows = model.over(function, theta[: len(model.parameters)], trial, problem.places(theta))[0][:, :, 0]
        size = np.sum(((rows - layout.target[:, :count]) * layout.present[:, :count]) ** 2, axis=1)
        better = size < least
        best[better], least[better] = trial[better], size[better]
    return best


def closed_angles(problem: PoseEquations, theta: Array, q: Array) -> Array:
    """Joint vectors (N, n) with the loops closed by the smallest errors, in standard deviations, of sensed angles."""
    layout, model = problem.layout, problem.model
    strict = layout.present[:, : model.loop_rows] & (problem.row_sigma[:, : model.loop_rows] == 0)
    weight = np.where(layout.sensed, problem.angle_sigma, np.where(layout.moving, 1.0, 0.0))
    for _ in range(STEPS if np.any(strict) else 0):
        gap, by_q = model.over(model.loop_by_angles, theta[: len(model.parameters)], q, problem.places(theta))
        gap = gap[:, :, 0] * strict
        if np.max(np.abs(gap)) < TIGHT:
            break
        weighted = by_q * strict[:, :, None] * weight[:, None, :]
        q = q - weight * (np.linalg.pinv(weighted, rcond=1e-9) @ gap[:, :, None])[:, :, 0]
    return q


def follow_unsensed(problem: PoseEquations, theta: Array, q: Array) -> Array:
    """Joint vectors (N, n) whose unsensed angles close the loops as well as they can, the readings taken as exact."""
    layout, model = problem.layout, problem.model
    for _ in range(STEPS if np.any(layout.moving) else 0):
        rows, by_q = model.over(model.observed_by_angles, theta[: len(model.parameters)], q, problem.places(theta))
        rows = (rows[:, :, 0] - layout.target) * layout.present
        step = explained_by_unsensed(by_q * layout.present[:, :, None], layout.moving, rows)
        q = q - np.clip(step, -0.2, 0.2)
        if np.max(np.abs(step)) < 1e-6:
            break
    return q


def explained_by_unsensed(by_q: Array, moving: NDArray[np.bool_], rows: Array) -> Array:
    """Change (N, n) of the unsensed angles that explains most of the rows (N, m)."""
    which = np.flatnonzero(moving.any(axis=0))
    change = np.zeros(moving.shape)
    by_unread = by_q[:, :, which] * moving[:, None, which]
    change[:, which] = (np.linalg.pinv(by_unread, rcond=1e-9) @ rows[:, :, None])[:, :, 0]
    return change
