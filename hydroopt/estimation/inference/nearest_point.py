"""The point nearest to another that fulfils conditions: a quadratic program over cones, stated to Clarabel directly.

Conditions of physics and of the machine file need no modelling language, which takes longer to load, and to translate
a program, than Clarabel takes to solve it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.sparse import csc_matrix

from hydroopt.errors import SolverError
from hydroopt.estimation.inference.certificate import Certificate
from hydroopt.estimation.inference.conditions import MARGIN, UPPER, Condition, square
from hydroopt.estimation.inference.whitening import GaussianPosterior
from hydroopt.spatial.inertia import Array

TOLERANCE = 1e-10
"""Relative and absolute tolerance of Clarabel."""
ACTIVE = 1e-6
"""Multiplier from which on a condition counts as active."""
DIAGONAL = UPPER[0] == UPPER[1]
BY_COLUMN = np.lexsort(UPPER)
"""Entries of an upper triangle, which we have row by row, in Clarabel's order: column by column."""
LENGTH = np.where(DIAGONAL, 1.0, np.sqrt(2.0))
"""What gives the triangle the length of the matrix."""


class Nearest(NamedTuple):
    """The point (k,) and the names of the conditions that hold it back."""

    z: Array
    active: frozenset[str]


@dataclass(frozen=True, eq=False)
class Cone:
    """A condition on z (k,): constant + slope·z is not negative, or the upper triangle (10,) of a possible matrix."""

    name: str
    matrix: bool
    constant: Array
    slope: Array

    def least(self, z: Array) -> float:
        """The smallest value or eigenvalue at z."""
        return _least(self.constant + self.slope @ z, matrix=self.matrix)


def cones(conditions: Sequence[Condition], posterior: GaussianPosterior, margin: float = 0.0) -> tuple[Cone, ...]:
    """Inequalities and matrices with a margin, on the posterior's coordinates; equalities hold by their choice."""
    found = []
    for condition in conditions:
        if condition.kind != "zero":
            matrix = condition.kind == "semidefinite"
            away = (MARGIN + margin) * DIAGONAL if matrix else margin
            found.append(Cone(condition.name, matrix, condition.evaluate(posterior.offset) - away,
                              condition.rows @ posterior.slope))
    return tuple(found)


def nearest_point(target: Array, within: Sequence[Cone], where: str) -> Nearest | None:
    """The point nearest to a target (k,) within cones; None if they contradict each other.

    Raises:
        SolverError: no answer, or one that fails the check of its optimality.

    >>> positive = Cone("positive", False, np.zeros(1), np.array([[1.0, 0.0]]))
    >>> nearest_point(np.array([-1.0, 2.0]), [positive], "example").z.round(6)
    array([0., 2.])
    """
    import clarabel  # noqa: PLC0415 — loaded when it is used

    order = [BY_COLUMN if cone.matrix else slice(None) for cone in within]
    unit = [LENGTH if cone.matrix else np.ones(len(cone.constant)) for cone in within]
    slope = np.vstack([np.zeros((0, len(target))), *((one[:, None] * cone.slope)[by] for cone, by, one in zip(
        within, order, unit, strict=True))])
    constant = np.concatenate([np.zeros(0), *((one * cone.constant)[by] for cone, by, one in zip(
        within, order, unit, strict=True))])
    kinds = [clarabel.PSDTriangleConeT(4) if cone.matrix else clarabel.NonnegativeConeT(len(cone.constant))
             for cone in within]
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = TOLERANCE
    settings.max_threads = 1  # of so few rows, more take longer
    # coordinates are whitened: scaling the rows as well costs steps, and without noise the end of the search
    answers = []
    for settings.equilibrate_enable in (False, True):
        answers.append(clarabel.DefaultSolver(csc_matrix(np.eye(len(target))), -target, csc_matrix(-slope), constant,
                                              kinds, settings).solve())
        if str(answers[-1].status) == "Solved" or "PrimalInfeasible" in str(answers[-1].status):
            break
    # of two that are almost solved the latter, whose constraints hold more closely
    found = next((one for one in answers[::-1] if "Solved" in str(one.status)), answers[-1])
    status = str(found.status)
    if "PrimalInfeasible" in status:
        return None
    if "Solved" not in status:
        raise SolverError(f"Clarabel ended as '{status}'", where=where, remedy="check the scale of priors and data")
    z, raw, multipliers, first = np.array(found.x), np.array(found.z), [], 0
    for cone, by, one in zip(within, order, unit, strict=True):
        part = np.empty(len(cone.constant))
        part[by] = raw[first : first + len(part)]
        multipliers.append(part / one)  # as the triangle of a matrix
        first += len(part)
    certify(z, multipliers, target, within).trust(where)
    return Nearest(z, frozenset(cone.name for cone, multiplier in zip(within, multipliers, strict=True)
                                if np.max(np.abs(multiplier), initial=0.0) > ACTIVE))


def certify(z: Array, multipliers: Sequence[Array], target: Array, within: Sequence[Cone]) -> Certificate:
    """Recompute feasibility, stationarity and complementarity at z (k,) and the cones' multipliers, matrices by their
    triangles."""
    violation, total, size, gap = 0.0, z - target, np.abs(z - target), 0.0
    for cone, multiplier in zip(within, multipliers, strict=True):
        twice = np.where(DIAGONAL, 1.0, 2.0) * multiplier if cone.matrix else multiplier
        share = cone.slope.T @ twice
        total, size = total - share, size + np.abs(share)
        gap += abs(float(twice @ (cone.constant + cone.slope @ z)))
        violation = max(violation, -cone.least(z), -_least(multiplier, matrix=cone.matrix))
    scale = max(1.0, float(np.max(size, initial=0.0)))
    return Certificate(violation, max(float(np.max(np.abs(total), initial=0.0)) / scale, gap / scale**2))


def _least(values: Array, *, matrix: bool) -> float:
    return float(np.min(np.linalg.eigvalsh(square(values)) if matrix else values, initial=np.inf))
