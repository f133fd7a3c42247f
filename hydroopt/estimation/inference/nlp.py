"""The problem as a nonlinear program for IPOPT: for constraints that are not convex, and for a user's own tools.

Matrices that must be positive semidefinite equal Cholesky products L·Lᵀ, whose factors are variables of the program.
`interior_point` solves it in the whitened coordinates z of the posterior, ψ = offset + slope·z, which a solver moves
each by its own uncertainty; `nonlinear_program` gives the same program in ψ itself, in SI.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import casadi as ca
import numpy as np

from hydroopt.errors import SolverError
from hydroopt.estimation.inference import convex_program, ipopt
from hydroopt.estimation.inference.conditions import MARGIN, UPPER, Condition, square
from hydroopt.estimation.inference.constraints import Named, as_casadi
from hydroopt.estimation.inference.convex_program import Optimum
from hydroopt.estimation.inference.problem import StatedProblem, names_of
from hydroopt.estimation.inference.program import NonlinearProgram
from hydroopt.estimation.inference.whitening import WIDEST, GaussianPosterior
from hydroopt.spatial.inertia import Array


class ResidualTerm(NamedTuple):
    """Residuals of one sensor or group of sensors, ``‖T·[ψ; −1]‖² = Σ residual²``, and by what they are weighted.

    `sigma` [unit] is the standard deviation of an independent residual; None where `triangle` (·, p+1) is weighted.
    """

    name: str
    unit: str
    triangle: Array
    sigma: float | None


class _Coordinates(NamedTuple):
    """Variables x (k,) with ψ = offset + slope·x, their names, units, initial guess and bounds."""

    x: ca.SX
    offset: Array
    slope: Array
    names: tuple[str, ...]
    units: tuple[str, ...]
    start: Array
    lower: Array
    upper: Array


def interior_point(problem: StatedProblem, unconstrained: GaussianPosterior) -> Optimum:
    """The most probable ψ; matrices stay positive definite because they are Cholesky products.

    Raises:
        ProblemError: a constraint does not return a relation; or constraints, all of them convex, contradict each
            other, and the smallest contradicting set is named.
        SolverError: IPOPT failed or its answer failed our check.
    """
    parameters, where = problem.parameters, problem.where
    conditions = problem.requirements(consistent=problem.consistent)
    posterior = unconstrained.conditioned_on(conditions)
    if posterior is None:
        convex_program.refuse_contradiction(problem, unconstrained, consistent=problem.consistent)
        raise SolverError("the equalities contradict each other", where=where, remedy="drop or loosen one of them")
    size = posterior.slope.shape[1]
    z = ca.SX.sym("z", size)
    start = np.linalg.lstsq(posterior.slope / parameters.scale[:, None],
                            (parameters.nominal - posterior.offset) / parameters.scale, rcond=None)[0].astype(float)
    coordinates = _Coordinates(z, posterior.offset, posterior.slope, tuple(f"z_{k + 1}" for k in range(size)),
                               ("1",) * size, start, np.full(size, -np.inf), np.full(size, np.inf))
    cost = ca.sumsqr(ca.DM(posterior.root) @ z - ca.DM(posterior.right))
    inequalities = [c for c in conditions if c.kind != "zero"]
    program = _program(problem, inequalities, coordinates, cost)
    matrix = np.repeat([c.kind == "semidefinite" for c in inequalities], [len(c.rows) for c in inequalities])
    names = [(name, k) for k, name in enumerate(program.g_names) if k >= len(matrix) or not matrix[k]]
    try:
        answer = ipopt.solve_nlp({"x": program.x, "f": program.f, "g": program.g}, program.x0, program.lbx,
                                   program.ubx, program.lbg, program.ubg, where, names)
    except SolverError:
        convex_program.refuse_contradiction(problem, unconstrained, consistent=problem.consistent)
        raise
    psi = posterior.offset + posterior.slope @ answer[:size]
    g = np.asarray(ca.Function("g", [program.x], [program.g])(answer)).ravel()
    active = {c.name for c in conditions if c.kind == "zero"} | {name for name, k in names if abs(g[k]) < 1e-6}
    active |= {c.name for c in conditions if c.kind == "semidefinite" and c.margin(psi) < 1e-4}
    every = names_of(problem, consistent=problem.consistent)
    return Optimum(psi, tuple(name for name in every if name in active))


def nonlinear_program(problem: StatedProblem, residuals: Sequence[ResidualTerm]) -> NonlinearProgram:
    """The program in ψ (SI), then the Cholesky factors of the matrices that must be positive semidefinite.

    Its fixed numbers p are the standard deviations of the residuals. Bounds and fixed parameters are bounds of x, all
    other conditions are rows of g, scaled to about one. A prior of width `WIDEST` parameter scales keeps the answer
    finite where nothing is known, as in the solvers.
    """
    parameters = problem.parameters
    psi = ca.SX.sym("psi", len(parameters))
    fixed = np.array([problem.fixed.get(name, np.nan) for name in parameters.names])
    lower, upper = (np.where(np.isnan(fixed), bound, fixed) for bound in (parameters.lower, parameters.upper))
    size = len(parameters)
    coordinates = _Coordinates(psi, np.zeros(size), np.eye(size), parameters.names, parameters.units,
                               np.clip(parameters.nominal, lower, upper), lower, upper)
    weighted = [term for term in residuals if term.sigma is not None]
    sigma = ca.SX.sym("sigma", len(weighted))
    extended = ca.vertcat(psi, -1)
    cost = ca.SX(0)
    for term in residuals:
        squares = ca.sumsqr(ca.sparsify(ca.DM(term.triangle)) @ extended)
        cost += squares if term.sigma is None else squares / sigma[weighted.index(term)] ** 2
    rows, right = problem.square_rows
    cost += ca.sumsqr(ca.sparsify(ca.DM(rows)) @ psi - ca.DM(right))
    cost += ca.sumsqr((psi - ca.DM(parameters.nominal)) / ca.DM(WIDEST * parameters.scale))
    program = _program(problem, problem.statements(consistent=problem.consistent), coordinates, cost)
    terms = [f"squared residuals of {term.name}" + (f" [{term.unit}] over {term.name}.sigma²" if term.sigma else "")
             for term in residuals]
    terms += ["squares of all Gaussian priors", "log-det distances of bodies"][: 1 + (problem.distance == "log-det")]
    return replace(program, p=sigma, p_names=tuple(f"{term.name}.sigma" for term in weighted),
                   p_units=tuple(term.unit for term in weighted), p_value=np.array([term.sigma for term in weighted]),
                   objective=tuple(terms))


def _program(problem: StatedProblem, conditions: Sequence[Condition], coordinates: _Coordinates,
             cost: ca.SX) -> NonlinearProgram:
    """Cost, log-det distances, conditions and the user's constraints in terms of the coordinates and factors L."""
    parameters, x = problem.parameters, coordinates.x
    psi = ca.DM(coordinates.offset) + ca.sparsify(ca.DM(coordinates.slope)) @ x
    unknowns, names, units = [x], [*coordinates.names], [*coordinates.units]
    lower, upper, start = [coordinates.lower], [coordinates.upper], [coordinates.start]
    rows: list[ca.SX] = []
    bounds: list[tuple[float, float]] = []
    row_names: list[str] = []
    factors: dict[str, ca.SX] = {}
    for condition in conditions:
        value = (ca.DM(condition.evaluate(coordinates.offset))
                 + ca.sparsify(ca.DM(condition.rows @ coordinates.slope)) @ x)
        if condition.kind == "semidefinite":
            L, factor = _factor(len(factors))
            value -= (L @ L.T + MARGIN * ca.DM.eye(4))[(UPPER[1] * 4 + UPPER[0]).tolist()]
            factors[condition.name] = L
            unknowns.append(factor)
            names += [f"{condition.name}.L{j + 1}{i + 1}" for i, j in zip(*UPPER, strict=True)]
            units += ["1"] * 10
            lower.append(np.where(UPPER[0] == UPPER[1], 0.0, -np.inf))
            upper.append(np.full(10, np.inf))
            start.append(_cholesky(square(condition.evaluate(parameters.nominal))).T[UPPER])
        rows.append(value)
        row_names += [condition.name] * value.numel()
        bounds += [(0.0, np.inf if condition.kind == "nonnegative" else 0.0)] * value.numel()
    named = Named(parameters, lambda k: psi[k])
    for constraint in problem.constraints:
        difference, equal = as_casadi(constraint, named)
        row_names.append(constraint.name)
        rows.append(difference)
        bounds.append((0.0, 0.0) if equal else (-np.inf, 0.0))
    for body in problem.bodies if problem.distance == "log-det" else ():
        L = factors[body.consistency]
        cost += body.weight * (ca.sumsqr(L) - 2 * ca.sum1(ca.log(ca.diag(L))) - 4)
    low, high = (np.array([pair[k] for pair in bounds]) for k in (0, 1))
    return NonlinearProgram(
        x=ca.vertcat(*unknowns), f=cost, g=ca.vertcat(*rows) if rows else ca.SX(0, 1), x_names=tuple(names),
        x_units=tuple(units), x0=np.concatenate(start), lbx=np.concatenate(lower), ubx=np.concatenate(upper),
        g_names=tuple(row_names), lbg=low, ubg=high)


def _factor(k: int) -> tuple[ca.SX, ca.SX]:
    """A lower triangular matrix (4, 4) and its ten unknowns, in the order of the upper triangle of its transpose."""
    unknown = ca.SX.sym(f"L_{k}", 10)
    L = ca.SX(4, 4)
    for n, (i, j) in enumerate(zip(*UPPER, strict=True)):
        L[int(j), int(i)] = unknown[n]
    return L, unknown


def _cholesky(matrix: Array) -> Array:
    """Factor of the nearest positive definite matrix: an impossible nominal body gives a possible initial guess."""
    values, vectors = np.linalg.eigh(matrix)
    return np.linalg.cholesky(vectors @ np.diag(np.maximum(values, 1e-3)) @ vectors.T)
