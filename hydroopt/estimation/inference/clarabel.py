"""A convex program in cones, ``min ½xᵀPx + qᵀx`` with ``b − A·x`` in cones, solved by Clarabel and checked."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.sparse import csc_matrix

from hydroopt.errors import SolverError
from hydroopt.estimation.inference.certificate import Certificate
from hydroopt.spatial.inertia import Array

TOLERANCE = 1e-10
"""Relative and absolute tolerance of Clarabel."""


def solve(P: csc_matrix, q: Array, A: csc_matrix, b: Array, kinds: Sequence[Any], where: str,
          tolerance: float = TOLERANCE) -> Any:
    """Clarabel's solution: the point `x`, and the multipliers `z` of all rows; None if the cones contradict each other.

    Args:
        P: upper triangle of the objective's matrix (k, k).
        q: (k,) the objective's slope at zero.
        A, b: rows (m, k) and constants (m,).
        kinds: Clarabel's cones, in the order of their rows.
        where: subject for error messages.
        tolerance: relative and absolute, of Clarabel.

    Raises:
        SolverError: no answer, or one that fails the check of its optimality.

    >>> import clarabel
    >>> P, A, positive = csc_matrix(np.eye(2)), csc_matrix([[-1.0, 0.0]]), [clarabel.NonnegativeConeT(1)]
    >>> np.round(solve(P, np.array([1.0, -2.0]), A, np.zeros(1), positive, "example").x, 6) + 0.0
    array([0., 2.])
    """
    import clarabel  # noqa: PLC0415 — loaded when it is used

    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance
    settings.max_threads = 1  # of so few rows, more take longer
    # coordinates are whitened: scaling the rows as well costs steps, and without noise the end of the search
    answers = []
    for settings.equilibrate_enable in (False, True):
        answers.append(clarabel.DefaultSolver(P, q, A, b, kinds, settings).solve())
        if str(answers[-1].status) == "Solved" or "PrimalInfeasible" in str(answers[-1].status):
            break
    # of two that are almost solved the latter, whose constraints hold more closely
    found = next((one for one in answers[::-1] if "Solved" in str(one.status)), answers[-1])
    status = str(found.status)
    if "PrimalInfeasible" in status:
        return None
    if "Solved" not in status:
        raise SolverError(f"Clarabel ended as '{status}'", where=where, remedy="check the scale of priors and data")
    certificate(P, q, A, b, *(np.array(part) for part in (found.x, found.s, found.z))).trust(where)
    return found


def certificate(P: csc_matrix, q: Array, A: csc_matrix, b: Array, x: Array, s: Array, z: Array) -> Certificate:
    """Recompute feasibility, stationarity and complementarity at x (k,) with slack s (m,) and multipliers z (m,)."""
    terms = np.stack([P @ x + P.T @ x - P.diagonal() * x, q, A.T @ z])
    scale = max(1.0, float(np.max(np.abs(terms).sum(axis=0), initial=0.0)))
    stationarity = float(np.max(np.abs(terms.sum(axis=0)), initial=0.0)) / scale
    violation = np.abs(A @ x + s - b) / np.maximum(1.0, np.abs(b) + np.abs(s))
    return Certificate(float(np.max(violation, initial=0.0)), max(stationarity, float(np.abs(s @ z)) / scale**2))
