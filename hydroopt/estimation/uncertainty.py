"""Intervals that stay honest when constraints are active: samples of the posterior, cut off where bodies end to exist.

Residuals and priors make a Gaussian posterior; bounds, physical consistency and the user's constraints cut it. Its samples
are drawn by elliptical slice sampling (Murray, Adams, MacKay 2010), many chains side by side. Covariances of the
unconstrained problem would be wrong at an active constraint, and those of the active set alone too small.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np

from hydroopt import inertia
from hydroopt.estimation.feasible import MARGIN, scaled_bodies
from hydroopt.estimation.problem import Named, Problem
from hydroopt.inertia import Array

CHAINS, WARM_UP, STEPS, KEEP_EVERY = 128, 150, 250, 5


@dataclass(frozen=True, eq=False)
class Posterior:
    """Samples (s, p) of the parameters; `note` tells in words how they were drawn, or why there are none."""

    samples: Array
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
    parameters = problem.parameters
    scale = parameters.scale
    rows, right = problem.prior_rows
    A = np.vstack([R, rows]) * scale
    b = np.concatenate([r, right]) - np.vstack([R, rows]) @ parameters.nominal
    equalities, inequality = _linear_equalities(problem)
    if equalities is None:
        return None
    mean, root = _gaussian(A, b, equalities)
    inside = _indicator(problem, consistent=consistent, inequality=inequality)
    start = _inner_point(problem, psi, consistent=consistent)
    # the start must lie on the equalities; what the step inwards moved is put back
    start = _project((start - parameters.nominal) / scale, equalities)
    to_psi: Callable[[Array], Array] = lambda x: parameters.nominal + scale * x  # noqa: E731
    if not inside(to_psi(start[None]))[0]:
        return None
    rng = np.random.default_rng(seed)
    state = np.tile(start, (CHAINS, 1))
    kept = []
    for step in range(WARM_UP + STEPS):
        state = _elliptical_step(state, mean, root, lambda x: inside(to_psi(x)), rng)
        if step >= WARM_UP and step % KEEP_EVERY == 0:
            kept.append(to_psi(state))
    note = f"Gaussian posterior cut off by bounds and constraints, {CHAINS * len(kept)} samples by elliptical slice sampling"
    return Posterior(np.concatenate(kept), note)


def _gaussian(A: Array, b: Array, equalities: tuple[Array, Array]) -> tuple[Array, Array]:
    """Mean (p,) and a root (p, k) of the covariance of ``exp(−½‖A·x − b‖²)`` on ``E·x = e``."""
    E, e = equalities
    p = A.shape[1]
    A = np.vstack([A, 1e-6 * np.eye(p)])  # directions that nothing determines get a width of 10⁶ scales
    b = np.concatenate([b, np.zeros(p)])
    if len(E):
        particular = np.linalg.lstsq(E, e, rcond=None)[0]
        free = np.linalg.svd(E, full_matrices=True)[2][np.linalg.matrix_rank(E) :].T
    else:
        particular, free = np.zeros(p), np.eye(p)
    Q, T = np.linalg.qr(A @ free)
    inverse = np.linalg.inv(T)
    return particular + free @ (inverse @ (Q.T @ (b - A @ particular))), free @ inverse


def _project(x: Array, equalities: tuple[Array, Array]) -> Array:
    E, e = equalities
    return x - np.linalg.lstsq(E, E @ x - e, rcond=None)[0] if len(E) else x


def _elliptical_step(state: Array, mean: Array, root: Array, inside: Callable[[Array], Array],
                     rng: np.random.Generator) -> Array:
    """One step of all chains: a random ellipse through each state, shrunk until a point on it is inside."""
    chains = len(state)
    centred = state - mean
    other = rng.standard_normal((chains, root.shape[1])) @ root.T
    angle = rng.uniform(0, 2 * np.pi, chains)
    low, high = angle - 2 * np.pi, angle.copy()
    moved = state.copy()
    waiting = np.arange(chains)
    while waiting.size:
        at = angle[waiting, None]
        proposal = mean + centred[waiting] * np.cos(at) + other[waiting] * np.sin(at)
        good = inside(proposal)
        moved[waiting[good]] = proposal[good]
        waiting = waiting[~good]
        behind = angle[waiting] < 0
        low[waiting[behind]] = angle[waiting[behind]]
        high[waiting[~behind]] = angle[waiting[~behind]]
        angle[waiting] = rng.uniform(low[waiting], high[waiting])
    return moved


def _indicator(problem: Problem, *, consistent: bool,
               inequality: Callable[[Array], Array] | None) -> Callable[[Array], Array]:
    """Function from ψ (s, p) to whether all inequalities hold (s,)."""
    parameters = problem.parameters
    free = np.array([name not in problem.fixed for name in parameters.names])
    low, high = parameters.lower[free], parameters.upper[free]
    bodies = scaled_bodies(problem) if consistent else ()
    maps = [(body.columns, np.einsum("ij,kjl,lm->kim", body.scaling, inertia.PSEUDO_BASIS, body.scaling))
            for body in bodies]

    def inside(psi: Array) -> Array:
        good = np.all((psi[:, free] >= low) & (psi[:, free] <= high), axis=1)
        for columns, basis in maps:
            good[good] = _positive_definite(np.tensordot(psi[good][:, columns], basis, axes=1))
        if inequality is not None:
            good[good] = inequality(psi[good])
        return np.asarray(good)

    return inside


def _positive_definite(matrices: Array) -> Array:
    """Whether each of many (s, 4, 4) matrices is positive definite, by elimination on all of them at once."""
    work = matrices - MARGIN / 2 * np.eye(4)
    good = np.ones(len(work), dtype=bool)
    for k in range(4):
        pivot = work[:, k, k]
        good &= pivot > 0
        safe = np.where(good, pivot, 1.0)
        work = work - work[:, :, k : k + 1] * work[:, k : k + 1, :] / safe[:, None, None]
    return good


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


def _linear_equalities(problem: Problem) -> tuple[tuple[Array, Array] | None, Callable[[Array], Array] | None]:
    """Equalities ``E·x = e`` on the scaled step x, and the inequalities as a function of ψ (s, p).

    The first is None if a constraint cannot be sampled: a nonlinear equality, or one that only cvxpy understands.
    """
    parameters = problem.parameters
    psi = ca.SX.sym("psi", len(parameters))
    named = Named(parameters, lambda k: psi[k])
    rows: list[Array] = []
    values: list[float] = []
    insides: list[ca.SX] = []
    for name, value in problem.fixed.items():
        rows.append(np.eye(len(parameters))[parameters.index(name)])
        values.append(value)
    for constraint in problem.constraints:
        try:
            relation = constraint.relation(named)
        except Exception:  # noqa: BLE001 - whatever a user's cvxpy function raises when handed CasADi symbols
            return None, None
        if not isinstance(relation, ca.SX) or relation.n_dep() != 2:
            return None, None
        body = relation.dep(0) - relation.dep(1)
        if relation.op() != ca.OP_EQ:
            insides.append(body)
            continue
        row = ca.jacobian(body, psi)
        if ca.depends_on(row, psi):
            return None, None
        at_zero = ca.Function("equality", [psi], [row, body])(ca.DM.zeros(psi.shape))
        rows.append(np.asarray(ca.DM(at_zero[0])).ravel())
        values.append(-float(at_zero[1]))
    inequality = None
    if insides:
        function = ca.Function("inequalities", [psi], [ca.vertcat(*insides)])
        inequality = lambda s: np.all(np.asarray(function(s.T)) <= 0, axis=0) if len(s) else np.ones(0, bool)  # noqa: E731
    E = np.array(rows).reshape(-1, len(parameters))
    return (E * parameters.scale, np.array(values) - E @ parameters.nominal), inequality
