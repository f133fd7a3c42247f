"""The same problem as a nonlinear program for IPOPT: for constraints that are not convex."""

from __future__ import annotations

import casadi as ca
import numpy as np

from hydroopt import inertia, solvers
from hydroopt.errors import ProblemError
from hydroopt.estimation.feasible import MARGIN, Solution, scaled_bodies
from hydroopt.estimation.problem import Named, Problem
from hydroopt.inertia import Array


def solve(problem: Problem, R: Array, r: Array) -> Solution:
    """Minimise ``‖R·ψ − r‖²`` plus priors; bodies stay possible because their pseudo-inertia is a Cholesky product.

    Raises:
        ProblemError: a constraint does not return a relation.
        SolverError: IPOPT failed or its answer failed our check.
    """
    parameters = problem.parameters
    nominal, scale = parameters.nominal, parameters.scale
    where = f"identification of {problem.model.machine.name}"
    rows, right = problem.prior_rows
    A = np.vstack([R, rows]) * scale
    b = np.concatenate([r, right]) - np.vstack([R, rows]) @ nominal
    size = max(1.0, float(b @ b))
    x = ca.SX.sym("x", len(nominal))
    psi = ca.DM(nominal) + ca.DM(scale) * x
    lower, upper = ((bound - nominal) / scale for bound in (parameters.lower, parameters.upper))
    for name, value in problem.fixed.items():
        k = parameters.index(name)
        lower[k] = upper[k] = (value - nominal[k]) / scale[k]
    unknowns, lows, highs, start = [x], [lower], [upper], [np.zeros(len(nominal))]
    relations: list[ca.SX] = []
    bounds: list[tuple[float, float]] = []
    names: list[tuple[str, int]] = []
    if problem.consistent:
        below = np.tril_indices(4)
        for body in scaled_bodies(problem):
            factor = ca.SX.sym(f"L_{body.owner}", len(below[0]))
            L = ca.SX(4, 4)
            for k, (i, j) in enumerate(zip(*below, strict=True)):
                L[int(i), int(j)] = factor[k]
            product = L @ L.T + MARGIN * ca.DM.eye(4)
            wanted = sum((psi[body.columns][k] * ca.DM(body.scaling @ inertia.PSEUDO_BASIS[k] @ body.scaling)
                          for k in range(10)), ca.SX(4, 4))
            relations += [product[int(i), int(j)] - wanted[int(i), int(j)] for i, j in zip(*below, strict=True)]
            bounds += [(0.0, 0.0)] * len(below[0])
            unknowns.append(factor)
            diagonal = below[0] == below[1]
            lows.append(np.where(diagonal, 0.0, -np.inf))
            highs.append(np.full(len(below[0]), np.inf))
            start.append(_cholesky(body.pseudo_inertia(nominal[body.columns]))[below])
    named = Named(parameters, lambda k: psi[k])
    for constraint in problem.constraints:
        relation = constraint.relation(named)
        if not isinstance(relation, ca.SX) or relation.n_dep() != 2:
            raise ProblemError("it does not return a relation", where=f"constraint '{constraint.name}'",
                               remedy="return left == right, left <= right or left >= right")
        names.append((constraint.name, len(relations)))
        relations.append(relation.dep(0) - relation.dep(1))
        bounds.append((0.0, 0.0) if relation.op() == ca.OP_EQ else (-np.inf, 0.0))
    g = ca.vertcat(*relations) if relations else ca.SX(0, 1)
    g_lower, g_upper = (np.array([pair[k] for pair in bounds]) for k in (0, 1))
    nlp = {"x": ca.vertcat(*unknowns), "f": ca.sumsqr(ca.DM(A) @ x - ca.DM(b)) / size, "g": g}
    answer = solvers.solve_nlp(nlp, np.concatenate(start), np.concatenate(lows), np.concatenate(highs), g_lower, g_upper,
                               where)
    step = answer[: len(nominal)]
    at = np.asarray(ca.Function("g", [nlp["x"]], [g])(answer)).ravel()
    active = [f"lower bound of {n}" for k, n in enumerate(parameters.names) if step[k] - lower[k] < 1e-6]
    active += [f"upper bound of {n}" for k, n in enumerate(parameters.names) if upper[k] - step[k] < 1e-6]
    solution = nominal + scale * step
    if problem.consistent:
        active += [f"physical consistency of {body.owner}" for body in scaled_bodies(problem)
                   if np.linalg.eigvalsh(body.pseudo_inertia(solution[body.columns]))[0] < 1e-4]
    active += [name for name, k in names if abs(at[k]) < 1e-6]
    return Solution(solution, tuple(active))


def _cholesky(matrix: Array) -> Array:
    """Factor of the nearest positive definite matrix: an impossible nominal body gives a possible start."""
    values, vectors = np.linalg.eigh(matrix)
    return np.linalg.cholesky(vectors @ np.diag(np.maximum(values, 1e-3)) @ vectors.T)
