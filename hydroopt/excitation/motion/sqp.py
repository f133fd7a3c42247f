"""Sequential quadratic programming on the design of a motion, in a trust region.

Every step solves a quadratic program exactly: damped BFGS approximates the Lagrangian's Hessian, limits are linear in
the step. Of the thousands of limits over time only those take part that the step would break, found by looking at all
of them after each quadratic program; so a step takes some ten milliseconds, however finely time is divided.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import piqp
from numpy.typing import NDArray

from hydroopt.excitation.motion.problem import WIDEST, ExcitationProblem
from hydroopt.spatial.inertia import Array

LOOSE, KEPT = 0.02, 1e-3
"""By how much of its scale a limit may be broken on the way, and where a motion counts."""
NEAR = 0.03
"""Room below which a limit takes part from the first step on."""
STEPS, QUADRATIC = 400, 12
"""Most steps, and most quadratic programs in one."""
FIRST, SMALLEST, LARGEST = 0.3, 1e-6, 1.0
"""Sizes of the trust region."""
GAIN = 1e-6
"""Gain of the criterion below which the search ends."""


class Point(NamedTuple):
    """Where the search stands: variables, criterion, gradient, room (N, m) to the lower and to the upper bound."""

    x: Array
    value: float
    gradient: Array
    below: Array
    above: Array

    @property
    def broken(self) -> float:
        """By how much a limit is broken at most."""
        return max(0.0, -float(np.min(self.below)), -float(np.min(self.above)))


def sequential_quadratic_programming(problem: ExcitationProblem, x: Array, back_off: float, end: float,
                                     interrupted: Callable[[], bool],
                                     report: Callable[[float], None]) -> Array:
    """The best motion near a start.

    Args:
        problem: the design.
        x: initial guess (k,).
        back_off: part of every limit's range that is left.
        end: value of ``time.monotonic()`` at which to stop.
        interrupted: whether to stop at once.
        report: is called with every better value.
    """
    at, size = _point(problem, x, back_off), FIRST
    slopes, hessian, best = problem.slopes(x), np.eye(len(x)), at
    taken = _tightest(np.minimum(at.below, at.above), NEAR)
    for _ in range(STEPS):
        if time.monotonic() > end or interrupted() or size < SMALLEST:
            break
        step, multipliers, taken = _step(problem, at, slopes, hessian, size, taken)
        if step is None:
            size *= 0.5
            continue
        to = _point(problem, at.x + step, back_off)
        promised = -float(at.gradient @ step + step @ hessian @ step / 2)
        gain = at.value - to.value
        better = gain > 1e-4 * promised if promised > 0 else to.broken < at.broken
        if not (np.isfinite(to.value) and ((to.broken <= LOOSE and better)
                                           or (at.broken > LOOSE and to.broken < 0.7 * at.broken))):
            size = 0.5 * min(size, float(np.max(np.abs(step))))
            continue
        new = problem.slopes(to.x)
        bend = to.gradient - at.gradient + problem.pulled(new, multipliers) - problem.pulled(slopes, multipliers)
        hessian = _updated(hessian, step, bend)
        if gain > 0.7 * promised:
            size = min(max(size, 3 * float(np.max(np.abs(step)))), LARGEST)
        elif gain < 0.25 * promised:
            size = 0.7 * float(np.max(np.abs(step)))
        done = abs(gain) < GAIN and promised < 10 * GAIN and to.broken <= KEPT
        taken = (multipliers != 0) | _tightest(np.minimum(to.below, to.above), NEAR)
        at, slopes = to, new
        if at.broken <= KEPT and (at.value < best.value or best.broken > KEPT):
            best = at
            report(at.value)
        if done:
            break
    return best.x


def _point(problem: ExcitationProblem, x: Array, back_off: float) -> Point:
    value, gradient = problem.objective(x)
    values = problem.constraints(x)
    lower, upper = problem.bounds(back_off)
    below, above = values - lower, upper - values
    sound = np.isfinite(value) and np.all(np.isfinite(values))
    return Point(x, value if sound else np.inf, gradient, below, above)


def _step(problem: ExcitationProblem, at: Point, slopes: tuple[Array, Array, Array], hessian: Array, size: float,
          taken: NDArray[np.bool_]) -> tuple[Array | None, Array, NDArray[np.bool_]]:
    """The best step (k,) of the quadratic model, multipliers (N, m) of the limits, and those that took part."""
    box = np.maximum(-size, -WIDEST - at.x), np.minimum(size, WIDEST - at.x)
    multipliers = np.zeros(taken.shape)
    for relaxed in (False, True):  # a broken limit may be too far away to be kept after one step
        low, high = (np.minimum(-at.below, 0), np.maximum(at.above, 0)) if relaxed else (-at.below, at.above)
        for _ in range(QUADRATIC):
            solver = piqp.DenseSolver()
            solver.settings.eps_abs = solver.settings.eps_rel = 1e-9
            rows = (problem.jacobian(slopes, taken), np.maximum(low[taken], -1e30), np.minimum(high[taken], 1e30))
            solver.setup(hessian, at.gradient, None, None, *(rows if np.any(taken) else (None, None, None)), *box)
            if solver.solve() != piqp.PIQP_SOLVED:
                break
            step = np.array(solver.result.x)
            change = problem.pushed(slopes, step)
            broken = _tightest(np.minimum(high - change, change - low), -1e-9) & ~taken
            if not np.any(broken):
                if np.any(taken):
                    multipliers[taken] = solver.result.z_u - solver.result.z_l
                multipliers[np.abs(multipliers) < 1e-9] = 0.0
                return step, multipliers, taken
            taken = taken | broken
    return None, multipliers, taken


def _tightest(room: Array, below: float) -> NDArray[np.bool_]:
    """Where a limit's room (N, m) is below something and at its least in time: its neighbours follow."""
    edge = np.full((1, room.shape[1]), np.inf)
    return (room < below) & (room <= np.vstack([edge, room[:-1]])) & (room <= np.vstack([room[1:], edge]))


def _updated(hessian: Array, step: Array, bend: Array) -> Array:
    """BFGS's update, damped so that the matrix stays positive definite (Powell 1978)."""
    pressed = hessian @ step
    predicted, found = float(step @ pressed), float(step @ bend)
    part = 1.0 if found >= 0.2 * predicted else 0.8 * predicted / (predicted - found)
    bend = part * bend + (1 - part) * pressed
    return np.asarray(hessian - np.outer(pressed, pressed) / predicted + np.outer(bend, bend) / (step @ bend))
