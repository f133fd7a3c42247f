"""What residuals and priors say before any constraint: a Gaussian, in coordinates that suit every solver."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hydroopt.estimation.problem import Problem
from hydroopt.inertia import Array

WIDEST = 1e6
"""Width, in parameter scales, given to directions that neither data nor priors determine."""


@dataclass(frozen=True, eq=False)
class Gaussian:
    """ψ = offset + slope·z with independent standard normal z (k,); the constrained estimate minimises ‖z‖².

    The columns of `slope` (p, k) are the principal axes, from what the data know best to what only the priors know, so
    that a solver moves each by its own uncertainty however far these are apart.
    """

    offset: Array
    slope: Array


def gaussian(problem: Problem, R: Array, r: Array, equalities: tuple[Array, Array] | None = None) -> Gaussian:
    """The Gaussian ``exp(−½‖R·ψ − r‖²)`` times the priors, restricted to ``E·ψ = e`` if given."""
    nominal, scale = problem.parameters.nominal, problem.parameters.scale
    p = len(nominal)
    rows, right = problem.prior_rows
    A = np.vstack([np.vstack([R, rows]) * scale, np.eye(p) / WIDEST])
    b = np.concatenate([r - R @ nominal, right - rows @ nominal, np.zeros(p)])
    particular: Array = np.zeros(p)
    free: Array = np.eye(p)
    if equalities is not None and len(equalities[0]):
        E, e = equalities[0] * scale, equalities[1] - equalities[0] @ nominal
        particular = np.asarray(np.linalg.lstsq(E, e, rcond=None)[0], dtype=float)
        free = np.asarray(np.linalg.svd(E, full_matrices=True)[2][np.linalg.matrix_rank(E) :].T, dtype=float)
    U, s, Vt = np.linalg.svd(A @ free, full_matrices=False)
    mean = particular + free @ (Vt.T @ (U.T @ (b - A @ particular) / s))
    return Gaussian(nominal + scale * mean, scale[:, None] * (free @ (Vt.T / s)))
