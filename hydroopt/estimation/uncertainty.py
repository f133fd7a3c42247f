"""Intervals that stay honest when constraints are active: samples of the posterior, cut off where bodies end to exist.

Residuals and priors make a Gaussian posterior; bounds, physical consistency and the user's constraints cut it. Its
samples are drawn by elliptical slice sampling (Murray, Adams, MacKay 2010), many chains side by side. Covariances of
the unconstrained problem would be wrong at an active constraint, and those of the active set alone too small.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from hydroopt import inertia
from hydroopt.errors import ProblemError
from hydroopt.estimation.feasible import MARGIN, scaled_bodies
from hydroopt.estimation.gaussian import Gaussian, gaussian
from hydroopt.estimation.problem import Named, Problem, as_casadi
from hydroopt.inertia import Array

Mask = NDArray[np.bool_]

CHAINS, WARM_UP, SWEEPS, KEEP_EVERY, BLOCK, TRIES = 128, 60, 16, 2, 8, 6
"""Chains side by side, sweeps until they have settled and of which every second is kept, coordinates moved together,
places tried for each move."""

DRIFT, ROUNDS = 0.5, 4
"""Chains have settled when their mean moves by less than this many of its standard deviations over half a warm-up; they
are given this many warm-ups."""


@dataclass(frozen=True, eq=False)
class Posterior:
    """Samples (s, p) of the parameters, their mean (p,), and how they were drawn in words.

    `mean` is None where the mean of possible parameters is not itself possible: constraints that are not convex.
    """

    samples: Array
    mean: Array | None
    note: str

    def interval(self, rows: Array | None = None) -> tuple[Array, Array]:
        """Standard deviation (k,) and 95 % interval (k, 2) of the parameters, or of linear sums of them (k, p)."""
        values = self.samples if rows is None else self.samples @ rows.T
        return np.std(values, axis=0), np.quantile(values, [0.025, 0.975], axis=0).T


def sample(problem: Problem, R: Array, r: Array, psi: Array, *, consistent: bool, seed: int) -> Posterior | None:
    """Sample the posterior around the estimate ψ; None (with no samples) where a constraint forbids it.

    Args:
        problem: priors, bounds and constraints.
        R: (p, p) and r (p,): weighted residuals ``‖R·ψ − r‖²``.
        psi: (p,) the constrained estimate, from which the chains start.
        consistent: whether bodies must be possible.
        seed: of the random numbers.
    """
    wishes = _wishes(problem)
    if wishes is None:
        return None
    belief = gaussian(problem, R, r, wishes.equalities)
    limits = _Limits(problem, belief, wishes, consistent=consistent)
    scale = problem.parameters.scale
    for distance in (0.1, 0.01, 0.001):
        inner = wishes.inwards(_inner_point(problem, psi, consistent=consistent), belief, distance)
        # the start in the Gaussian's coordinates; what leaves the equalities is dropped
        start = np.linalg.lstsq(belief.slope / scale[:, None], (inner - belief.offset) / scale, rcond=None)[0]
        state = np.tile(start[:, None], CHAINS)
        reach = limits.of(state)
        if np.all(limits.hold(reach, lambda: state)):  # noqa: B023 - called at once
            break
    else:
        return None
    rng = np.random.default_rng(seed)

    def sweep() -> None:
        nonlocal state, reach
        order = rng.permutation(len(state))
        for first in range(0, len(order), BLOCK):
            state, reach = _elliptical_step(state, reach, order[first : first + BLOCK], limits, rng)

    settled = False
    for _ in range(ROUNDS):
        for _ in range(WARM_UP // 2):
            sweep()
        half_way = state.mean(axis=1)
        for _ in range(WARM_UP - WARM_UP // 2):
            sweep()
        drift = np.abs(state.mean(axis=1) - half_way) / np.maximum(state.std(axis=1), 1e-12)
        settled = bool(np.all(drift < DRIFT))
        if settled:
            break
    kept = []
    for step in range(SWEEPS):
        sweep()
        if step % KEEP_EVERY == 0:
            kept.append(belief.offset + (belief.slope @ state).T)
    samples = np.concatenate(kept)
    mean = (samples.mean(axis=0) - belief.offset) / scale
    centre = np.linalg.lstsq(belief.slope / scale[:, None], mean[:, None], rcond=None)[0]
    possible = bool(limits.hold(limits.of(centre), lambda: centre)[0])
    note = (f"intervals from the Gaussian posterior cut off by bounds and constraints: {len(samples)} samples by "
            "elliptical slice sampling" + ("" if settled else ", WHICH HAD NOT SETTLED: do not rely on them"))
    return Posterior(samples, samples.mean(axis=0) if possible else None, note)


class _Limits:
    """All inequalities as functions of the Gaussian's coordinates z; a column each chain.

    The linear ones, bounds and the entries of pseudo-inertias, are kept as numbers (m, c) that a step updates cheaply.
    """

    def __init__(self, problem: Problem, belief: Gaussian, wishes: _Wishes, *, consistent: bool) -> None:
        parameters = problem.parameters
        p, scale = len(parameters), parameters.scale
        free = np.array([name not in problem.fixed for name in parameters.names])
        bodies = scaled_bodies(problem) if consistent else ()
        # first entries of all scaled pseudo-inertias, second entries, ..., then distances to lower and upper bounds
        upper = np.triu_indices(4)
        entries = np.zeros((10, len(bodies), p))
        for k, body in enumerate(bodies):
            entries[:, k, body.columns] = (body.scaling @ inertia.PSEUDO_BASIS @ body.scaling)[:, upper[0], upper[1]].T
        rows = [entries.reshape(10 * len(bodies), p)]
        constants = [np.repeat(-MARGIN / 2 * (upper[0] == upper[1]), len(bodies))]
        for bound, sign in ((parameters.lower, 1.0), (parameters.upper, -1.0)):
            bounded = np.flatnonzero(free & np.isfinite(bound))
            rows.append(sign * np.diag(1 / scale)[bounded])
            constants.append(-sign * (bound / scale)[bounded])
        gradient = np.vstack(rows)
        self.slope, self.start = gradient @ belief.slope, np.concatenate(constants) + gradient @ belief.offset
        self._bodies = len(bodies)
        self._wishes = wishes
        self._belief = belief

    def of(self, state: Array) -> Array:
        """The linear functions (m, c) at the states z (k, c)."""
        return np.asarray(self.start[:, None] + self.slope @ state)

    def hold(self, reach: Array, state: Callable[[], Array]) -> Mask:
        """Whether all limits hold (c,), from the linear functions and, only if the user has others, the states."""
        good: Mask = np.all(reach[10 * self._bodies :] >= 0, axis=0)
        if self._bodies:
            entries = reach[: 10 * self._bodies].reshape(10, self._bodies, -1)
            good &= np.all(_positive_definite(entries), axis=0)
        if self._wishes.inequality is not None:
            good[good] = self._wishes.hold(self._belief.offset + (self._belief.slope @ state()[:, good]).T)
        return good


def _elliptical_step(state: Array, reach: Array, block: NDArray[np.intp], limits: _Limits,
                     rng: np.random.Generator) -> tuple[Array, Array]:
    """Move a block of coordinates of all chains along random ellipses, shrunk until the limits hold.

    A chain that found no place after `TRIES` stays: every number of rejected places is as likely on the way back, so
    that stopping early keeps the distribution, and the slowest chain does not hold up the others.
    """
    chains = state.shape[1]
    other = rng.standard_normal((len(block), chains))
    # how the bracket shrinks does not depend on the limits: all places to try are known beforehand
    angles = np.empty((TRIES, chains))
    angles[0] = rng.uniform(0, 2 * np.pi, chains)
    high = angles[0]
    low = high - 2 * np.pi
    for k in range(1, TRIES):
        angles[k] = rng.uniform(low, high)
        low, high = np.where(angles[k] < 0, angles[k], low), np.where(angles[k] < 0, high, angles[k])
    state, reach = state.copy(), reach.copy()
    waiting = np.arange(chains)
    for tries in (angles[:1], angles[1:]):  # most chains are done after one
        at, here = tries[:, waiting], state[np.ix_(block, waiting)]
        step = here[:, None] * (np.cos(at) - 1) + other[:, waiting][:, None] * np.sin(at)
        flat = step.reshape(len(block), -1)
        linear = np.tile(reach[:, waiting], len(tries)) + limits.slope[:, block] @ flat
        good = limits.hold(linear, partial(_stepped, state, np.tile(waiting, len(tries)), block, flat))
        good = good.reshape(at.shape)
        found = np.flatnonzero(good.any(axis=0))
        pick = np.argmax(good[:, found], axis=0) * len(waiting) + found  # the first good one
        state[np.ix_(block, waiting[found])] += flat[:, pick]
        reach[:, waiting[found]] = linear[:, pick]
        waiting = np.delete(waiting, found)
    return state, reach


def _stepped(state: Array, chains: NDArray[np.intp], block: NDArray[np.intp], step: Array) -> Array:
    moved = state[:, chains]
    moved[block] += step
    return moved


def _positive_definite(upper: Array) -> Mask:
    """Whether each of many symmetric matrices, given by their upper triangles (10, ...), is positive definite."""
    a, b, c, d, e, f, g, h, i, j = upper
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):  # past a pivot that fails the rest is void
        e, f, g, h, i, j = e - b * b / a, f - b * c / a, g - b * d / a, h - c * c / a, i - c * d / a, j - d * d / a
        h, i, j = h - f * f / e, i - f * g / e, j - g * g / e
        return np.asarray((a > 0) & (e > 0) & (h > 0) & (j - i * i / h > 0))


def _inner_point(problem: Problem, psi: Array, *, consistent: bool) -> Array:
    """The estimate moved a little off its bounds and bodies' edges."""
    parameters = problem.parameters
    start = psi.copy()
    for bound, sign in ((parameters.lower, 1.0), (parameters.upper, -1.0)):
        near = np.isfinite(bound) & (sign * (start - bound) < 1e-4 * parameters.scale)
        start[near] = bound[near] + sign * 1e-4 * parameters.scale[near]
    for body in scaled_bodies(problem) if consistent else ():
        inverse = np.linalg.inv(body.scaling)
        start[body.columns] += inertia.from_pseudo_inertia(1e-4 * inverse @ inverse)
    for name, value in problem.fixed.items():
        start[parameters.index(name)] = value
    return start


@dataclass(frozen=True)
class _Wishes:
    """The user's constraints: equalities ``E·ψ = e``, and inequalities ``g(ψ) ≤ 0`` with their slopes, if any."""

    equalities: tuple[Array, Array]
    inequality: ca.Function | None
    slopes: ca.Function | None

    def hold(self, psi: Array) -> Mask:
        """Whether all inequalities hold (s,) at ψ (s, p)."""
        if self.inequality is None or not len(psi):
            return np.ones(len(psi), dtype=bool)
        return np.asarray(np.all(np.asarray(self.inequality(psi.T)) <= 0, axis=0))

    def inwards(self, psi: Array, belief: Gaussian, distance: float) -> Array:
        """ψ moved until every inequality is `distance` standard deviations from its edge, to first order."""
        if self.inequality is None or self.slopes is None:
            return psi
        for i in range(self.inequality.size1_out(0)):
            slope = belief.slope.T @ np.asarray(self.slopes(psi))[i]
            size = float(np.linalg.norm(slope)) or 1.0
            excess = float(np.asarray(self.inequality(psi)).ravel()[i]) / size + distance
            psi = psi - belief.slope @ (max(excess, 0.0) * slope / size)
        return psi


def _wishes(problem: Problem) -> _Wishes | None:
    """The user's constraints in a form that can be sampled.

    None if one cannot be: a nonlinear equality, or a relation that only cvxpy understands.
    """
    parameters = problem.parameters
    psi = ca.SX.sym("psi", len(parameters))
    named = Named(parameters, lambda k: psi[k])
    rows = [np.eye(len(parameters))[parameters.index(name)] for name in problem.fixed]
    values = list(problem.fixed.values())
    insides: list[ca.SX] = []
    for constraint in problem.constraints:
        try:
            body, equal = as_casadi(constraint, named)
        except (ProblemError, TypeError, ValueError, NotImplementedError):  # what cvxpy raises at CasADi symbols
            return None
        if not equal:
            insides.append(body)
            continue
        row = ca.jacobian(body, psi)
        if ca.depends_on(row, psi):
            return None
        at_zero = ca.Function("equality", [psi], [row, body])(ca.DM.zeros(psi.shape))
        rows.append(np.asarray(ca.DM(at_zero[0])).ravel())
        values.append(-float(at_zero[1]))
    equalities = (np.array(rows).reshape(-1, len(parameters)), np.array(values))
    if not insides:
        return _Wishes(equalities, None, None)
    g = ca.vertcat(*insides)
    return _Wishes(equalities, ca.Function("inequality", [psi], [g]),
                   ca.Function("slopes", [psi], [ca.densify(ca.jacobian(g, psi))]))
