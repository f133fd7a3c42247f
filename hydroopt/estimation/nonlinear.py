"""The same problem as a nonlinear program for IPOPT: for constraints that are not convex."""

from __future__ import annotations

import casadi as ca
import numpy as np

from hydroopt import inertia, solvers
from hydroopt.estimation.feasible import MARGIN, Solution, scaled_bodies
from hydroopt.estimation.gaussian import Gaussian
from hydroopt.estimation.problem import Named, Problem, as_casadi
from hydroopt.inertia import Array


def solve(problem: Problem, belief: Gaussian) -> Solution:
    """The most probable ψ; bodies stay possible because their pseudo-inertia is a Cholesky product.

    Raises:
        ProblemError: a constraint does not return a relation.
        SolverError: IPOPT failed or its answer failed our check.
    """
    parameters = problem.parameters
    where = f"identification of {problem.model.machine.name}"
    z = ca.SX.sym("z", belief.slope.shape[1])
    psi = ca.DM(belief.offset) + ca.DM(belief.slope) @ z
    lower, upper = parameters.lower.copy(), parameters.upper.copy()
    for name, value in problem.fixed.items():
        lower[parameters.index(name)] = upper[parameters.index(name)] = value
    bounded = np.flatnonzero(np.isfinite(lower) | np.isfinite(upper))
    begin = np.linalg.lstsq(belief.slope / parameters.scale[:, None],
                            (parameters.nominal - belief.offset) / parameters.scale, rcond=None)[0]
    free = np.full(z.numel(), np.inf)
    unknowns, lows, highs, start = [z], [-free], [free], [begin]
    relations = [psi[int(k)] / parameters.scale[k] for k in bounded]
    bounds = [(lower[k] / parameters.scale[k], upper[k] / parameters.scale[k]) for k in bounded]
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
            start.append(_cholesky(body.pseudo_inertia(parameters.nominal[body.columns]))[below])
    named = Named(parameters, lambda k: psi[k])
    for constraint in problem.constraints:
        difference, equal = as_casadi(constraint, named)
        names.append((constraint.name, len(relations)))
        relations.append(difference)
        bounds.append((0.0, 0.0) if equal else (-np.inf, 0.0))
    g = ca.vertcat(*relations) if relations else ca.SX(0, 1)
    g_lower, g_upper = (np.array([pair[k] for pair in bounds]) for k in (0, 1))
    nlp = {"x": ca.vertcat(*unknowns), "f": ca.sumsqr(z), "g": g}
    answer = solvers.solve_nlp(nlp, np.concatenate(start), np.concatenate(lows), np.concatenate(highs),
                               g_lower, g_upper, where, dict(names))
    solution = belief.offset + belief.slope @ answer[: z.numel()]
    at = np.asarray(ca.Function("g", [nlp["x"]], [g])(answer)).ravel()
    active = [f"{side} bound of {parameters.names[k]}" for side, bound in (("lower", lower), ("upper", upper))
              for k in bounded if abs(solution[k] - bound[k]) < 1e-6 * parameters.scale[k]
              and parameters.names[k] not in problem.fixed]
    active += [f"{name} fixed" for name in problem.fixed]
    if problem.consistent:
        active += [f"physical consistency of {body.owner}" for body in scaled_bodies(problem)
                   if np.linalg.eigvalsh(body.pseudo_inertia(solution[body.columns]))[0] < 1e-4]
    active += [name for name, k in names if abs(at[k]) < 1e-6]
    return Solution(solution, tuple(active))


def _cholesky(matrix: Array) -> Array:
    """Factor of the nearest positive definite matrix: an impossible nominal body gives a possible start."""
    values, vectors = np.linalg.eigh(matrix)
    return np.linalg.cholesky(vectors @ np.diag(np.maximum(values, 1e-3)) @ vectors.T)
