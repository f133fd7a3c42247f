"""Angles of joints that move without a sensor: initial guesses, and the angles that close the loops."""

from __future__ import annotations

from collections.abc import Iterator

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from hydroopt.estimation.kinematic.observability import FARTHEST
from hydroopt.estimation.kinematic.pose_equations import PoseEquations
from hydroopt.simulation.postures import limits
from hydroopt.spatial.inertia import Array

TIGHT = 1e-11
"""Gap [m] of a loop that counts as closed."""
STEPS = 20
"""Steps of Newton's method towards the unsensed angles of the nominal machine."""
SMALL = 1e-6
"""Change of an unsensed angle [rad, m] that ends these steps."""
GUESSES = 24
"""Angles tried for a joint that moves unsensed, over its range."""


def guess_unsensed(problem: PoseEquations, theta: Array) -> Array:
    """Initial joint vectors (N, n): readings, and for joints that move unsensed the angle that closes best."""
    layout, model = problem.layout, problem.model
    best = problem.angles(theta, layout.reading)
    moving = np.flatnonzero(layout.moving.any(axis=0))
    if not moving.size:
        return best
    g, places = theta[: len(model.parameters)], problem.places(theta)
    unread = layout.moving.any(axis=1)
    loops_only = bool(np.all(layout.held[unread]))  # the gap determines the angle, and is quicker than all rows
    function, count = (model.loop, model.loop_rows) if loops_only else (model.observed, layout.present.shape[1])
    low, high = limits(model)
    for joints, rows, shares in _tries(function, moving, np.asarray(layout.present[unread, :count].any(axis=0))):
        before, least = best.copy(), np.full(len(best), np.inf)
        for share in shares:
            trial = before.copy()
            trial[:, joints] = np.where(layout.moving[:, joints], (low + share * (high - low))[joints],
                                        before[:, joints])
            left = model.over(function, g, trial, places)[0][:, :, 0] - layout.target[:, :count]
            size = np.sum(np.where(layout.present[:, :count] & rows, left, 0.0) ** 2, axis=1)
            better = size < least
            best[better], least[better] = trial[better], size[better]
        if not loops_only:  # lengths, inclinations and places determine unsensed angles far better than a guess
            own = np.isin(np.arange(best.shape[1]), joints)
            best = _followed(problem, theta, best, layout.moving & own, layout.present & rows)
    return follow_unsensed(problem, theta, best) if model.measurements or not loops_only else best


def _tries(function: ca.Function, moving: NDArray[np.intp],
           read: NDArray[np.bool_]) -> Iterator[tuple[NDArray[np.intp], NDArray[np.bool_], Array]]:
    """Joints to try together, by which of the rows (m,) that are read, and where (k, n) in their ranges, from 0 to 1.

    Those that a row depends on alone, as a cylinder's length does on its joint, come first and are tried alone: they
    are known then, whatever the others make of the tip.
    """
    n = function.size1_in(1)
    depends = np.array(ca.DM(function.jac_sparsity(0, 1)).full(), dtype=bool) & read[:, None]
    unknown = set(moving.tolist())
    while unknown:
        counts = depends[:, sorted(unknown)].sum(axis=1)
        alone = {k for k in unknown if np.any(depends[:, k] & (counts == 1))}
        joints = np.array(sorted(alone))[:1] if alone else np.array(sorted(unknown))
        rows = depends[:, joints].any(axis=1) & (counts <= len(joints))
        yield joints, rows, ((np.arange(GUESSES)[:, None] + 0.5) / GUESSES * np.ones(n) if len(joints) == 1
                             else np.random.default_rng(0).uniform(size=(GUESSES * len(joints), n)))
        unknown -= set(joints.tolist())


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
    return _followed(problem, theta, q, problem.layout.moving, problem.layout.present)


def _followed(problem: PoseEquations, theta: Array, q: Array, moving: NDArray[np.bool_],
              present: NDArray[np.bool_]) -> Array:
    """Joint vectors whose `moving` (N, n) angles make some rows, `present` (N, m), as small as they can."""
    model = problem.model
    g, places = theta[: len(model.parameters)], problem.places(theta)
    least, step, reached = np.full(len(q), np.inf), np.zeros_like(q), q
    for _ in range(STEPS if np.any(moving) else 0):
        rows, by_q = model.over(model.observed_by_angles, g, reached - step, places)
        rows = np.where(present, rows[:, :, 0] - problem.layout.target, 0.0)
        size = np.sum(rows**2, axis=1)
        better = size < least  # never where a linkage cannot close
        reached = np.where(better[:, None], reached - step, reached)
        least = np.where(better, size, least)
        found = explained_by_unsensed(np.where((better[:, None] & present)[:, :, None], by_q, 0.0), moving,
                                      np.where(better[:, None], rows, 0.0))
        step = np.where(better[:, None], np.clip(found, -FARTHEST, FARTHEST), step / 4)
        if np.max(np.abs(step)) < SMALL:
            break
    return reached


def explained_by_unsensed(by_q: Array, moving: NDArray[np.bool_], rows: Array) -> Array:
    """Change (N, n) of the unsensed angles that explains most of the rows (N, m)."""
    which = np.flatnonzero(moving.any(axis=0))
    change = np.zeros(moving.shape)
    by_unread = by_q[:, :, which] * moving[:, None, which]
    change[:, which] = (np.linalg.pinv(by_unread, rcond=1e-9) @ rows[:, :, None])[:, :, 0]
    return change
