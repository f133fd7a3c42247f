"""Clarabel and IPOPT: their answers in plain words, and our own check of what they return."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import cvxpy as cp
import numpy as np

from hydroopt.errors import SolverError
from hydroopt.spatial.inertia import Array

_IPOPT_WORDS = {
    "Solve_Succeeded": "solved",
    "Solved_To_Acceptable_Level": "solved, but less accurately than requested",
    "Infeasible_Problem_Detected": "the constraints contradict each other",
    "Maximum_Iterations_Exceeded": "it ran out of iterations",
    "Restoration_Failed": "it found no point that fulfils the constraints",
    "Diverging_Iterates": "the parameters diverge",
    "Invalid_Number_Detected": "an expression is not a number at some point",
}


@dataclass(frozen=True)
class Certificate:
    """What we recomputed from a solution, each relative to the size of the terms it balances.

    `violation` of the worst constraint and `stationarity`, the gradient of the Lagrangian.
    """

    violation: float
    stationarity: float

    def trust(self, where: str, *, tolerance: float = 1e-4) -> None:
        """Accept the solution or raise a SolverError with the evidence."""
        if not (self.violation < tolerance and self.stationarity < tolerance):
            raise SolverError(
                f"the solver's answer failed our check (constraint violation {self.violation:.1e}, stationarity "
                f"{self.stationarity:.1e}, both should be below {tolerance:.0e})", where=where,
                remedy="loosen contradictory priors or constraints, or use another method")


def solve_convex(problem: cp.Problem, where: str) -> bool:
    """Solve with Clarabel; False if the constraints contradict each other.

    Raises:
        SolverError: no answer, or the problem is not convex.
    """
    if not problem.is_dcp():
        raise SolverError("a constraint is not convex", where=where, remedy="use method 'nlp'")
    try:
        with warnings.catch_warnings():  # an inaccurate answer is judged by our own certificate
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


def solve_nlp(nlp: dict[str, Any], start: Array, lower: Array, upper: Array, constraint_lower: Array,
              constraint_upper: Array, where: str, names: Sequence[tuple[str, int]],
              derivatives: Mapping[str, ca.Function] | None = None) -> Array:
    """Minimise a CasADi NLP with IPOPT and check the answer ourselves; `names` tells rows of constraints.

    `derivatives` are the options grad_f, jac_g and hess_lag of nlpsol, for a caller who knows them.

    Raises:
        SolverError: IPOPT's reason in plain words, or a failed check.
    """
    options = {"ipopt.print_level": 0, "print_time": False, "ipopt.sb": "yes", "ipopt.tol": 1e-9,
               "ipopt.dual_inf_tol": 1e-7, "ipopt.nlp_scaling_method": "none",
               "ipopt.max_iter": 1000, "error_on_fail": False} | dict(derivatives or {})
    solver = ca.nlpsol("identification", "ipopt", nlp, options)
    answer = solver(x0=start, lbx=lower, ubx=upper, lbg=constraint_lower, ubg=constraint_upper)
    status = solver.stats()["return_status"]
    if status not in ("Solve_Succeeded", "Solved_To_Acceptable_Level"):
        g = np.asarray(answer["g"]).ravel()
        gap = np.maximum(constraint_lower - g, g - constraint_upper)
        broken = dict.fromkeys(name for name, row in names if not gap[row] < 1e-6)
        named = f" ({', '.join(broken)} not fulfilled)" if broken else ""
        raise SolverError(f"IPOPT failed: {_IPOPT_WORDS.get(status, status)}{named}", where=where,
                          remedy="check the constraints you added, or start from a better nominal model")
    multipliers = ca.MX.sym("lam", nlp["g"].numel()) if isinstance(nlp["x"], ca.MX) else ca.SX.sym(
        "lam", nlp["g"].numel())
    parts = ca.Function("kkt", [nlp["x"], multipliers], [
        ca.gradient(nlp["f"], nlp["x"]), ca.jtimes(nlp["g"], nlp["x"], multipliers, True)])
    shares = [*(np.asarray(v).ravel() for v in parts(answer["x"], answer["lam_g"])),
              np.asarray(answer["lam_x"]).ravel()]
    x, g = np.asarray(answer["x"]).ravel(), np.asarray(answer["g"]).ravel()
    gaps = [lower - x, x - upper, constraint_lower - g, g - constraint_upper]
    size = max(1.0, float(np.max(sum(np.abs(s) for s in shares))))
    Certificate(max(0.0, *(float(np.max(gap, initial=0.0)) for gap in gaps)),
                float(np.max(np.abs(sum(shares)))) / size).trust(where)
    return x
