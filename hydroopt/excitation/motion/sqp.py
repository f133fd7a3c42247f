"""Sequential quadratic programming on the design of a motion, in a trust region.

Every step solves a quadratic program: damped BFGS approximates the Lagrangian's Hessian, and constraints are
linearised. Of the thousands of limits over time the quadratic program contains an active set only: after each solution
the limits that the step violates are added, and those far from it leave. A step therefore takes some ten milliseconds,
however fine the time grid.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import piqp
from numpy.typing import NDArray

from hydroopt.excitation.motion.problem import WIDEST, ExcitationProblem
from hydroopt.spatial.inertia import Array

ALLOWED, FEASIBLE = 0.02, 1e-3
"""Violation of a limit, as a part of its scale, that an iterate may have, and that a solution may have."""
OVERLOOKED, EXACT = FEASIBLE, 1e-7
"""Violation that a quadratic program's solution may have of limits that are not in its active set, and its accuracy: a
smaller violation calls for more programs a step, and ends no better."""
NEAR = 0.03
"""Distance to a bound below which a limit belongs to the first active set."""
MAX_STEPS, MAX_QPS = 400, 12
"""Largest number of steps, and of quadratic programs in one step."""
FIRST_RADIUS, SMALLEST_RADIUS, LARGEST_RADIUS = 0.3, 1e-6, 1.0
"""First, smallest and largest radius of the trust region."""
CONVERGED = 1e-6
"""Decrease of the criterion below which the search has converged."""


class Room(NamedTuple):
    """Distances (N, m) to the lower and to the upper bound, and the largest violation, as parts of each limit's scale.

    The violation is infinite where a limit is not a number.
    """

    below: Array
    above: Array
    violation: float

    @property
    def least(self) -> Array:
        """The distance (N, m) to the nearer bound."""
        return np.minimum(self.below, self.above)


class Point(NamedTuple):
    """An iterate: variables, criterion, gradient, and what is left to the limits."""

    x: Array
    value: float
    gradient: Array
    room: Room


class Search(NamedTuple):
    """Where a search stands: its iterate (k,), what approximates the Hessian (k, k) there, the radius of the trust
    region, the active set (N, m), the best iterate (k,) so far and its criterion, infinite where it violates limits.
    """

    x: Array
    hessian: Array
    radius: float
    active: NDArray[np.bool_] | None
    best: Array
    value: float
    ended: bool

    @classmethod
    def at(cls, x: Array) -> Search:
        """A search that begins at a motion (k,)."""
        return cls(x, np.eye(len(x)), FIRST_RADIUS, None, x, np.inf, False)

    def again(self) -> Search:
        """A search that begins at the best motion, with what is known of the Hessian, for other bounds."""
        return Search(self.best, self.hessian, FIRST_RADIUS, None, self.best, np.inf, False)


def sequential_quadratic_programming(problem: ExcitationProblem, search: Search, back_off: float,
                                     stopped: Callable[[], bool], report: Callable[[float], None],
                                     steps: int = MAX_STEPS) -> Search:
    """The best motion near a start.

    Args:
        problem: the design.
        search: where to go on.
        back_off: part of every limit's range by which bounds are tightened.
        stopped: whether to stop at once.
        report: is called with every better value.
        steps: that are tried at most.
    """
    if search.ended:
        return search
    hessian, radius, ended = search.hessian, search.radius, True
    current = Point(search.x, *problem.objective(search.x), _room(problem, search.x, back_off))
    slopes = problem.slopes(search.x)
    active = _tightest(current.room.least, NEAR) if search.active is None else search.active
    best, value = search.best, search.value
    if current.room.violation <= FEASIBLE and current.value < value:
        best, value = current.x, current.value
    for tried in range(MAX_STEPS):
        if stopped() or radius < SMALLEST_RADIUS:
            break
        if tried == steps:
            ended = False
            break
        step, multipliers, active = _step(problem, current, slopes, hessian, radius, active)
        if step is None:
            radius *= 0.5
            continue
        trial = _trial(problem, current, current.x + step, back_off)
        predicted = -float(current.gradient @ step + step @ hessian @ step / 2)
        decrease = current.value - trial.value if trial else -np.inf
        if trial is None or not (_restored(current.room, trial.room) or (trial.room.violation <= ALLOWED and (
                decrease > 1e-4 * predicted if predicted > 0 else trial.room.violation < current.room.violation))):
            radius = 0.5 * min(radius, float(np.max(np.abs(step))))
            continue
        new = problem.slopes(trial.x)
        change = (trial.gradient - current.gradient + problem.weighted_gradient(new, multipliers)
                  - problem.weighted_gradient(slopes, multipliers))
        hessian = _updated(hessian, step, change)
        if decrease > 0.7 * predicted:
            radius = min(max(radius, 3 * float(np.max(np.abs(step)))), LARGEST_RADIUS)
        elif decrease < 0.25 * predicted:
            radius = 0.7 * float(np.max(np.abs(step)))
        done = abs(decrease) < CONVERGED and predicted < 10 * CONVERGED and trial.room.violation <= FEASIBLE
        active = (multipliers != 0) | _tightest(trial.room.least, NEAR)
        current, slopes = trial, new
        if current.room.violation <= FEASIBLE and current.value < value:
            best, value = current.x, current.value
            report(value)
        if done:
            break
    return Search(current.x, hessian, radius, active, best, value, ended)


def _room(problem: ExcitationProblem, x: Array, back_off: float) -> Room:
    values = problem.constraints(x)
    lower, upper = problem.bounds(back_off)
    below, above = values - lower, upper - values
    violation = -min(float(np.min(below)), float(np.min(above)))
    return Room(below, above, np.inf if np.isnan(violation) else max(violation, 0.0))


def _restored(before: Room, after: Room) -> bool:
    """Whether a violation that is too large has become much smaller."""
    return before.violation > ALLOWED and after.violation < 0.7 * before.violation


def _trial(problem: ExcitationProblem, current: Point, x: Array, back_off: float) -> Point | None:
    """The next iterate; None where its limits or its criterion rule it out."""
    room = _room(problem, x, back_off)
    if room.violation > ALLOWED and not _restored(current.room, room):
        return None
    value, gradient = problem.objective(x)
    return Point(x, value, gradient, room) if np.isfinite(value) else None


def _step(problem: ExcitationProblem, current: Point, slopes: Array, hessian: Array, radius: float,
          active: NDArray[np.bool_]) -> tuple[Array | None, Array, NDArray[np.bool_]]:
    """The step (k,) that minimises the quadratic model, multipliers (N, m) of the limits, and the active set (N, m)."""
    box = np.maximum(-radius, -WIDEST - current.x), np.minimum(radius, WIDEST - current.x)
    multipliers, left = np.zeros(active.shape), np.zeros(active.shape, dtype=bool)
    for relaxed in (False, True):  # a violated limit may not be reachable within the trust region
        low, high = -current.room.below, current.room.above
        if relaxed:
            low, high = np.minimum(low, 0), np.maximum(high, 0)
        for _ in range(MAX_QPS):
            solver = piqp.DenseSolver()
            solver.settings.eps_abs = solver.settings.eps_rel = EXACT
            rows = (problem.jacobian(slopes, active), np.maximum(low[active], -1e30), np.minimum(high[active], 1e30))
            solver.setup(hessian, current.gradient, None, None, *(rows if np.any(active) else (None, None, None)), *box)
            if solver.solve() != piqp.PIQP_SOLVED:
                break
            step = np.array(solver.result.x)
            change = problem.directional_derivative(slopes, step)
            distance = np.minimum(high - change, change - low)
            broken = _tightest(distance, -OVERLOOKED) & ~active
            if not np.any(broken):
                if np.any(active):
                    multipliers[active] = solver.result.z_u - solver.result.z_l
                multipliers[np.abs(multipliers) < 1e-9] = 0.0
                return step, multipliers, active
            # what is far from its bounds leaves, but once only: sets must not alternate
            idle = active & ~left & (distance > NEAR)
            left |= idle
            active = (active & ~idle) | broken
    return None, multipliers, active


def _tightest(distance: Array, bound: float) -> NDArray[np.bool_]:
    """Where a limit's distance (N, m) is below a bound and a local minimum over time."""
    edge = np.full((1, distance.shape[1]), np.inf)
    return ((distance < bound) & (distance <= np.vstack([edge, distance[:-1]]))
            & (distance <= np.vstack([distance[1:], edge])))


def _updated(hessian: Array, step: Array, change: Array) -> Array:
    """BFGS's update, damped so that the matrix stays positive definite (Powell 1978)."""
    along = hessian @ step
    predicted, found = float(step @ along), float(step @ change)
    part = 1.0 if found >= 0.2 * predicted else 0.8 * predicted / (predicted - found)
    change = part * change + (1 - part) * along
    return np.asarray(hessian - np.outer(along, along) / predicted + np.outer(change, change) / (step @ change))
