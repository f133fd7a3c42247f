"""Convex programs solved by Clarabel through cvxpy: status messages and a check of the solution."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any

import numpy as np

from hydroopt.errors import SolverError
from hydroopt.estimation.inference.certificate import Certificate
from hydroopt.extras import Lazy
from hydroopt.spatial.inertia import Array

if TYPE_CHECKING:
    import cvxpy as cp
else:  # takes long to load, and most problems do without it
    cp = Lazy("cvxpy", "constraints of one's own, log-det distances and contradictions are stated with cvxpy",
              where="constraints")


def solve_convex(problem: cp.Problem, where: str) -> bool:
    """Solve with Clarabel; False if the constraints contradict each other.

    Raises:
        SolverError: no answer, or the problem is not convex.
    """
    if not problem.is_dcp():
        raise SolverError("a constraint is not convex", where=where, remedy="use method 'nlp'")
    try:
        with warnings.catch_warnings():  # the certificate decides about an inaccurate answer
            warnings.simplefilter("ignore", UserWarning)
            problem.solve(solver=cp.CLARABEL, tol_gap_abs=1e-10, tol_gap_rel=1e-10, tol_feas=1e-10)
    except cp.SolverError as error:
        raise SolverError(f"Clarabel failed ({error})", where=where,
                          remedy="check the scale of priors and data") from None
    if problem.status in ("infeasible", "infeasible_inaccurate"):
        return False
    if problem.status not in ("optimal", "optimal_inaccurate"):
        raise SolverError(f"Clarabel ended as '{problem.status}'", where=where,
                          remedy="add a prior or a bound so that the answer is finite")
    return True


def certify_convex(variable: cp.Variable, gradient: Array, constraints: list[Any]) -> Certificate:
    """Recompute feasibility and stationarity of ``min f(x) s.t. constraints`` at the returned x and multipliers.

    Args:
        variable: x, holding the solution.
        gradient: (k,) of the objective f at x.
        constraints: all cvxpy constraints, each holding its multiplier.
    """
    total, size = gradient.copy(), np.abs(gradient)
    violation = 0.0
    for constraint in constraints:
        body = constraint.args[0] - constraint.args[1] if len(constraint.args) == 2 else constraint.args[0]
        violation = max(violation, float(np.max(constraint.violation())))
        derivative = body.grad[variable]
        if derivative is None:
            continue
        # a semidefinite cone enters the Lagrangian with a minus, all else as multiplier times (left − right)
        sign = -1.0 if isinstance(constraint, cp.constraints.PSD) else 1.0
        multiplier = np.asarray(constraint.dual_value, dtype=float).ravel(order="F")
        share = sign * np.asarray(derivative @ multiplier).ravel()
        total += share
        size = size + np.abs(share)
    return Certificate(violation, float(np.max(np.abs(total)) / max(1.0, float(size.max()))))
