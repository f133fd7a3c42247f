"""Nonlinear programs solved by IPOPT: options, status messages and a check of the solution."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from hydroopt.errors import SolverError
from hydroopt.estimation.inference.certificate import Certificate
from hydroopt.spatial.inertia import Array

OPTIONS: Mapping[str, Any] = {
    "ipopt.print_level": 0, "print_time": False, "ipopt.sb": "yes", "ipopt.tol": 1e-9, "ipopt.dual_inf_tol": 1e-7,
    "ipopt.nlp_scaling_method": "none", "ipopt.max_iter": 1000, "error_on_fail": False,
    "ipopt.option_file_name": ""}  # or ipopt.opt in the working directory could load libraries and overwrite files
"""Of all programs."""
_IPOPT_WORDS = {
    "Solve_Succeeded": "solved",
    "Solved_To_Acceptable_Level": "solved, but less accurately than requested",
    "Infeasible_Problem_Detected": "the constraints contradict each other",
    "Maximum_Iterations_Exceeded": "it ran out of iterations",
    "Restoration_Failed": "it found no point that fulfils the constraints",
    "Diverging_Iterates": "the parameters diverge",
    "Error_In_Step_Computation": "no step could be computed",
    "Invalid_Number_Detected": "an expression is not a number at some point",
}


def improved(nlp: dict[str, Any], start: Array, lower: Array, upper: Array, constraint_lower: Array,
             constraint_upper: Array, steps: int) -> Array:
    """Where so many steps with first derivatives alone lead from a start: a better point near by, not always a
    solution."""
    solver = ca.nlpsol("improved", "ipopt", nlp, {
        **OPTIONS, "ipopt.hessian_approximation": "limited-memory", "ipopt.limited_memory_max_history": 20,
        "ipopt.max_iter": steps, "ipopt.tol": 1e-3, "ipopt.constr_viol_tol": 1e-7, "ipopt.mu_init": 1e-2})
    answer = solver(x0=start, lbx=lower, ubx=upper, lbg=constraint_lower, ubg=constraint_upper)
    return np.asarray(answer["x"]).ravel()


def solve_nlp(nlp: dict[str, Any], start: Array, lower: Array, upper: Array, constraint_lower: Array,
              constraint_upper: Array, where: str, names: Sequence[tuple[str, int]]) -> Array:
    """Minimise a CasADi NLP with IPOPT and check the answer ourselves; `names` tells rows of constraints.

    Raises:
        SolverError: IPOPT's reason in plain words, or a failed check.
    """
    solver = ca.nlpsol("identification", "ipopt", nlp, dict(OPTIONS))
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
