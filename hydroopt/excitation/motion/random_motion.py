"""Random motions within all limits: where a search starts, and what a designed motion is compared with."""

from __future__ import annotations

import numpy as np
from threadpoolctl import threadpool_limits

from hydroopt.errors import ProblemError
from hydroopt.excitation.motion.problem import ExcitationProblem
from hydroopt.limits.limits import TIGHT
from hydroopt.spatial.inertia import Array

RESTING_POSTURES = 2000
"""Random postures among which the resting posture is chosen."""


def resting_posture(problem: ExcitationProblem, rng: np.random.Generator) -> Array:
    """The random posture with the largest distance to all limits at rest, refined by random postures near it.

    Raises:
        ProblemError: every posture violates a limit; those in conflict are named.
    """
    limits, best = problem.limits, problem.mean
    least = np.full(len(limits.rows), np.inf)
    for size in (1.0, 0.3, 0.1, 0.03, 0.01):
        q, excess = _postures(problem, best, size, rng)
        chosen = int(np.argmin(np.max(excess, axis=1)))
        best, worst, least = q[chosen], excess[chosen], np.minimum(least, np.min(excess, axis=0))
    if np.max(worst) > 0:
        never = limits.names(least > 0)
        # if each limit alone can be satisfied, the active ones conflict with the violated ones
        together = dict.fromkeys([*limits.names(worst > 0), *limits.names(worst > -TIGHT)])
        what = "in any posture" if never else "together in any posture"
        raise ProblemError(f"{', '.join(never or together)} cannot be kept {what}", where="excitation",
                           remedy="correct these limits in the machine file, the posture of joints that rest, or keep "
                           "smaller reserves")
    return problem.posture(best)


def _postures(problem: ExcitationProblem, near: Array, size: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """A posture (n,) and random ones near it, (P, n), within a part `size` of the joints' ranges; their excesses (P,
    m)."""
    joints = problem.machine.joints
    low, high = problem.machine.ranges.T
    drawn = rng.uniform(low, high, (RESTING_POSTURES, len(low)))
    q = np.vstack([near, drawn if size == 1 else np.clip(near + size * (drawn - (low + high) / 2), low, high)])
    for joint, position in problem.resting.items():
        q[:, joints.index(joint)] = position
    q = problem.limits.hanging.postures(q)
    return q, problem.limits.excess(problem.limits.values(q, 0 * q, 0 * q))


def random_motion(problem: ExcitationProblem, rest: Array, rng: np.random.Generator) -> Array:
    """A random motion about a random posture: each joint's amplitude alone within the limits, then scaled together.

    Args:
        problem: whose functions and limits.
        rest: the posture to use where no random posture satisfies the limits.
        rng: of its posture and coefficients.
    """
    return shrunk(problem, *_drawn(problem, rest, rng))


def _drawn(problem: ExcitationProblem, rest: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """A random motion before its joints are scaled together, and the posture towards which they are."""
    q, excess = _postures(problem, problem.mean, 1.0, rng)
    kept = np.flatnonzero(np.max(excess, axis=1) <= 0)
    rest = problem.posture(q[rng.choice(kept)]) if kept.size else rest
    shape = (len(problem.basis.names), len(problem.active))
    wave = rng.standard_normal(shape)
    wave -= np.outer(problem.one, wave.mean(axis=0))  # so that the posture is its mean
    total = np.zeros(shape)
    for k in (k for k, joint in enumerate(problem.active) if joint not in problem.limits.hanging.joints):
        alone = np.zeros(shape)
        alone[:, k] = wave[:, k]
        total[:, k] = np.reshape(
            shrunk(problem, rest + alone.ravel(), rest, rough=True) - rest, shape)[:, k]
    return rest + total.ravel(), rest


def shrunk(problem: ExcitationProblem, x: Array, rest: Array, *, rough: bool = False) -> Array:
    """x scaled towards rest as little as needed to satisfy all limits at the controller's rate and on the grid.

    With `rough` they are checked at the nodes only, and the scale has two digits instead of six.
    """
    times = (problem.nodes,) if rough else (problem.grid, problem.fine)

    def feasible(part: float) -> bool:
        scaled = problem.hung(rest + part * (x - rest))
        return bool(np.all(np.isfinite(scaled))) and all(problem.excess(scaled, rows) <= 0 for rows in times)

    if all(problem.excess(x, rows) <= 0 for rows in times):
        return x
    low, high, digits = 0.0, 1.0, 2.0**-8 if rough else 2.0**-20
    while high - low > digits * high and high > 2.0**-20:
        middle = (low + high) / 2
        low, high = (middle, high) if feasible(middle) else (low, middle)
    return np.asarray(problem.hung(rest + low * (x - rest)))


def best_random_motion(problem: ExcitationProblem, count: int, seed: int) -> Array:
    """The coefficients of the best of `count` random motions, each as large as the limits permit.

    All are first scaled with limits at the nodes only. The best are then scaled exactly, until none that is left could
    be better: a smaller motion tells less.
    """
    with threadpool_limits(limits=1, user_api="blas"):
        rest = resting_posture(problem, np.random.default_rng(seed))
        drawn = [_drawn(problem, rest, np.random.default_rng((seed, k, count))) for k in range(count)]
        best, least = rest, np.inf
        for value, k in sorted((problem.value(shrunk(problem, *each, rough=True)), k) for k, each in enumerate(drawn)):
            if value >= least:
                break
            exact = shrunk(problem, *drawn[k])
            if (found := problem.value(exact)) < least:
                best, least = exact, found
    return best
