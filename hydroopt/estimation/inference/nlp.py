"""The same problem as a nonlinear program for IPOPT: for constraints that are not convex."""

from __future__ import annotations

import casadi as ca
import numpy as np

from hydroopt.errors import SolverError
from hydroopt.estimation.inference import sdp, solvers
from hydroopt.estimation.inference.conditions import MARGIN, UPPER, square
from hydroopt.estimation.inference.constraints import Named, as_casadi
from hydroopt.estimation.inference.gaussian import GaussianPosterior
from hydroopt.estimation.inference.problem import InferenceProblem
from hydroopt.estimation.inference.sdp import Optimum
from hydroopt.spatial.inertia import Array


def interior_point(problem: InferenceProblem, posterior: GaussianPosterior) -> Optimum:
    """The most probable ψ; matrices stay positive definite because they are Cholesky products.

    Raises:
        ProblemError: a constraint does not return a relation; or constraints, all of them convex, contradict each
            other, and the smallest contradicting set is named.
        SolverError: IPOPT failed or its answer failed our check.
    """
    parameters, unconstrained = problem.parameters, posterior
    where = problem.where
    conditions = problem.requirements(consistent=problem.consistent)
    left = unconstrained.conditioned_on(conditions)
    if left is None:
        sdp.refuse_contradiction(problem, unconstrained, consistent=problem.consistent)
        raise SolverError("the equalities contradict each other", where=where, remedy="drop or loosen one of them")
    posterior = left
    z = ca.SX.sym("z", posterior.slope.shape[1])
    psi = ca.DM(posterior.offset) + ca.DM(posterior.slope) @ z
    begin = np.linalg.lstsq(posterior.slope / parameters.scale[:, None],
                            (parameters.nominal - posterior.offset) / parameters.scale, rcond=None)[0]
    free = np.full(z.numel(), np.inf)
    unknowns, lows, highs, start = [z], [-free], [free], [begin]
    relations: list[ca.SX] = []
    bounds: list[tuple[float, float]] = []
    names: list[tuple[str, int]] = []
    factors: dict[str, ca.SX] = {}
    for condition in conditions:
        if condition.kind == "zero":
            continue
        value = ca.DM(condition.evaluate(posterior.offset)) + ca.DM(condition.rows @ posterior.slope) @ z
        if condition.kind == "semidefinite":
            L, factor = _factor(len(factors))
            value -= (L @ L.T + MARGIN * ca.DM.eye(4))[(UPPER[1] * 4 + UPPER[0]).tolist()]
            factors[condition.name] = L
            unknowns.append(factor)
            lows.append(np.where(UPPER[0] == UPPER[1], 0.0, -np.inf))
            highs.append(np.full(10, np.inf))
            start.append(_cholesky(square(condition.evaluate(parameters.nominal))).T[UPPER])
        else:
            names += [(condition.name, len(bounds) + k) for k in range(value.numel())]
        relations.append(value)
        bounds += [(0.0, 0.0 if condition.kind == "semidefinite" else np.inf)] * value.numel()
    named = Named(parameters, lambda k: psi[k])
    for constraint in problem.constraints:
        difference, equal = as_casadi(constraint, named)
        names.append((constraint.name, len(bounds)))
        relations.append(difference)
        bounds.append((0.0, 0.0) if equal else (-np.inf, 0.0))
    cost = ca.sumsqr(ca.DM(posterior.root) @ z - ca.DM(posterior.right))
    for body in problem.bodies if problem.distance == "log-det" else ():
        L = factors[body.consistency]
        cost += body.weight * (ca.sumsqr(L) - 2 * ca.sum1(ca.log(ca.diag(L))) - 4)
    g = ca.vertcat(*relations) if relations else ca.SX(0, 1)
    g_lower, g_upper = (np.array([pair[k] for pair in bounds]) for k in (0, 1))
    nlp = {"x": ca.vertcat(*unknowns), "f": cost, "g": g}
    try:
        answer = solvers.solve_nlp(nlp, np.concatenate(start), np.concatenate(lows), np.concatenate(highs),
                                   g_lower, g_upper, where, names)
    except SolverError:
        sdp.refuse_contradiction(problem, unconstrained, consistent=problem.consistent)
        raise
    solution = posterior.offset + posterior.slope @ answer[: z.numel()]
    at = np.asarray(ca.Function("g", [nlp["x"]], [g])(answer)).ravel()
    held = {c.name for c in conditions if c.kind == "zero"} | {name for name, k in names if abs(at[k]) < 1e-6}
    held |= {c.name for c in conditions if c.kind == "semidefinite" and c.margin(solution) < 1e-4}
    every = sdp.names_of(problem, consistent=problem.consistent)
    return Optimum(solution, tuple(name for name in every if name in held))


def _factor(k: int) -> tuple[ca.SX, ca.SX]:
    """A lower triangular matrix (4, 4) and its ten unknowns, in the order of the upper triangle of its transpose."""
    unknown = ca.SX.sym(f"L_{k}", 10)
    L = ca.SX(4, 4)
    for n, (i, j) in enumerate(zip(*UPPER, strict=True)):
        L[int(j), int(i)] = unknown[n]
    return L, unknown


def _cholesky(matrix: Array) -> Array:
    """Factor of the nearest positive definite matrix: an impossible nominal body gives a possible start."""
    values, vectors = np.linalg.eigh(matrix)
    return np.linalg.cholesky(vectors @ np.diag(np.maximum(values, 1e-3)) @ vectors.T)
