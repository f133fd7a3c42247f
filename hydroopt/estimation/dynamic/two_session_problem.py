"""Two sessions in one constrained least squares: all parameters are shared except what the second session adds.

Before: f = K·ψ; after: f = K·ψ + K_c·δ. The first session and the machine file's priors determine ψ, and the
residuals of the second what was added; both share every error of a wrong nominal model.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from hydroopt.errors import IdentifiabilityError, SolverError
from hydroopt.estimation.dynamic.folding import split, triangle
from hydroopt.estimation.dynamic.problem import IdentificationProblem
from hydroopt.estimation.dynamic.stored_information import StoredInformation
from hydroopt.estimation.inference import convex_program
from hydroopt.estimation.inference import posterior as uncertainty
from hydroopt.estimation.inference.band_variances import f_test, students
from hydroopt.estimation.inference.conditions import ScaledBody
from hydroopt.estimation.inference.mixed_model import projected
from hydroopt.estimation.inference.whitening import gaussian_posterior
from hydroopt.parameters.parameter_set import ParameterSet
from hydroopt.spatial.inertia import Array

AFTER = "after."
"""Prefix of the names of second values."""


@dataclass(frozen=True, eq=False, repr=False)
class TwoSessionProblem(IdentificationProblem):
    """The unknowns x (P,) of two sessions: all ψ of the first, then what the second adds.

    Attributes:
        unknowns: of x, with bounds and priors.
        second: (p, P) the second session's parameters are ``second @ x``; the first's are the first p of x.
        null: (P, ·) basis of the x in which nothing has changed.
        change: (P, c) what a change δ (c,) does to x.
        labels: (c,) names of the changes.
        gains: (n,) places in x of the relative errors of the actuators' force readings; none if they are exact.
        unconstrained: owners of bodies that need not be physically consistent; a mass is never negative.
    """

    unknowns: ParameterSet = field(kw_only=True)
    second: Array = field(kw_only=True)
    null: Array = field(kw_only=True)
    change: Array = field(kw_only=True)
    labels: tuple[str, ...] = field(kw_only=True)
    gains: tuple[int, ...] = field(default=(), kw_only=True)
    unconstrained: tuple[str, ...] = field(default=(), kw_only=True)

    @property
    def parameters(self) -> ParameterSet:
        """The unknowns x."""
        return self.unknowns

    @cached_property
    def bodies(self) -> tuple[ScaledBody, ...]:
        """Those that must be physically consistent."""
        return tuple(body for body in super().bodies if body.owner not in self.unconstrained)

    def rows(self, before: StoredInformation, after: StoredInformation) -> tuple[Array, Array, Array]:
        """A (m, P) and b (m,) with ``‖A·x − b‖²`` the weighted squares of both sessions' residuals, and the degrees of
        freedom (m,) of the rows' variances.

        Gains make f = (1 + γ)·K·ψ bilinear; A and b are then its linearisation at the most probable x.

        Raises:
            SolverError: that x was not found.
        """
        x, freedom = self.unknowns.nominal, np.concatenate([before.freedom.ravel(), after.freedom.ravel()])
        for _ in range(100 if self.gains else 1):
            A, b = self._rows_at(x, before, after)
            if not self.gains:
                return A, b, freedom
            last, x = x, gaussian_posterior(self, *folded(A, b)).offset
            if np.all(np.abs(x - last) < 1e-9 * self.unknowns.scale):
                return A, b, freedom
        raise SolverError("the gains of the force readings did not converge", where=self.where,
                          remedy="state a smaller sigma of the gains, or smaller sigmas of masses")

    @property
    def where(self) -> str:
        """Subject for error messages."""
        return f"comparison of two sessions of {self.model.machine.name}"

    def _rows_at(self, x: Array, before: StoredInformation, after: StoredInformation) -> tuple[Array, Array]:
        p, blocks, right = len(self.second), [], []
        for triangles, own in ((before.triangles, np.eye(p, len(x))), (after.triangles, self.second)):
            K, f = triangles[:, :, :p] @ own, triangles[:, :, p].copy()
            if self.gains:
                gain, predicted = x[list(self.gains)], K @ x
                K = (1 + gain)[:, None, None] * K
                K[np.arange(len(K)), :, list(self.gains)] = predicted
                f += gain[:, None] * predicted
            blocks.append(K.reshape(-1, len(x)))
            right.append(f.ravel())
        return np.vstack(blocks), np.concatenate(right)


def joined(*sets: ParameterSet) -> ParameterSet:
    """Independent sets of parameters, one after the other."""
    sizes = np.cumsum([0, *map(len, sets)])
    information = np.zeros((sizes[-1], sizes[-1]))
    for start, stop, one in zip(sizes[:-1], sizes[1:], sets, strict=True):
        information[start:stop, start:stop] = one.information
    nominal, lower, upper, scale = (np.concatenate([getattr(one, key) for one in sets])
                                    for key in ("nominal", "lower", "upper", "scale"))
    return ParameterSet(tuple(name for one in sets for name in one.names),
                        tuple(kind for one in sets for kind in one.kinds),
                        tuple(unit for one in sets for unit in one.units), nominal, lower, upper, scale, information)


def doubled(parameters: ParameterSet, names: Collection[str]) -> list[int]:
    """Positions of the parameters that need a second value if those of these names may change.

    Where one of a body's may change, the whole body has two values, so that it is physically consistent both times.
    """
    owners = {parameters.owner(name) for name in names if parameters.kind(name).is_inertial}
    return [k for k, (name, kind) in enumerate(zip(parameters.names, parameters.kinds, strict=True))
            if name in names or (kind.is_inertial and parameters.owner(name) in owners)]


def second_parameters(parameters: ParameterSet, places: Sequence[int]) -> ParameterSet:
    """The second values of parameters, with their bounds and without a prior."""
    at = list(places)
    return ParameterSet(tuple(AFTER + parameters.names[k] for k in at), tuple(parameters.kinds[k] for k in at),
                        tuple(parameters.units[k] for k in at), parameters.nominal[at], parameters.lower[at],
                        parameters.upper[at], parameters.scale[at], np.zeros((len(at), len(at))))


def folded(A: Array, b: Array) -> tuple[Array, Array]:
    """R (P, P) and r (P,) of ``‖R·x − r‖² = ‖A·x − b‖²`` without the part that no x changes."""
    return split(triangle(np.column_stack([A, b])))[:2]


class Wald(NamedTuple):
    """Least squares and test of what was added, δ (c,), without bounds and physical consistency.

    Attributes:
        value, std: (c,) NaN where δ is not identifiable.
        statistic, rank, freedom, p_value: F, Hotelling's test with k = `rank` identifiable directions of δ, and
            `freedom` of its denominator.
    """

    value: Array
    std: Array
    statistic: float
    rank: int
    freedom: float
    p_value: float


def wald(problem: TwoSessionProblem, A: Array, b: Array, freedom: Array) -> Wald:
    """Test whether anything was added, on the directions of δ that data and priors determine.

    Args:
        problem: what may have been added, and the priors.
        A, b: rows of both sessions.
        freedom: (rows,) degrees of freedom with which the rows' variances were estimated.

    Raises:
        IdentifiabilityError: no direction is identifiable, of no parameter.
    """
    scale, p = problem.unknowns.scale, len(problem.second)
    prior, right = problem.prior_rows
    rows = np.vstack([A, prior])
    # the nominal machine, unchanged; gains, which come after ψ in the basis, are nominally zero
    rest = np.concatenate([b, right]) - rows @ (problem.null[:, :p] @ problem.unknowns.nominal[:p])
    moved = np.vstack([A @ problem.change, np.zeros((len(prior), problem.change.shape[1]))])
    found = projected(rows @ (problem.null * np.linalg.norm(problem.null.T * scale, axis=1)), moved, rest,
                      scale @ np.abs(problem.change))
    if not len(found.sums):
        raise IdentifiabilityError("these logs do not identify a change of these parameters", where=problem.where,
                                   remedy="drive longer motions that excite them, in both sessions")
    freedom = np.append(freedom, np.full(len(prior), np.inf))
    return Wald(found.solution @ found.sums, np.linalg.norm(found.solution, axis=1),
                *f_test(found.sums, found.left**2, freedom))


@dataclass(frozen=True, eq=False)
class TwoSessionOptimum:
    """The most probable x (P,) with consistent bodies, samples around it (or None), and how they were computed."""

    x: Array
    posterior: uncertainty.Posterior | None
    active: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def centre(self) -> Array:
        """The most probable x (P,), or the posterior's mean where constraints are active."""
        mean = self.posterior.mean if self.posterior is not None else None
        return self.x if mean is None or not self.active else mean


def solve_both(problem: TwoSessionProblem, A: Array, b: Array, freedom: Array, *, intervals: bool,
               seed: int) -> TwoSessionOptimum:
    """The most probable unknowns with physically consistent bodies in both sessions, and samples of the posterior.

    Raises:
        SolverError: no trustworthy answer.
    """
    size = students(freedom)
    R, r = folded(A * size[:, None], b * size)
    found = convex_program.semidefinite_program(problem, gaussian_posterior(problem, R, r),
                                                consistent=problem.consistent)
    if not intervals:
        return TwoSessionOptimum(found.psi, None, found.active, ())
    posterior = uncertainty.sample(problem, R, r, found.psi, consistent=problem.consistent, seed=seed)
    note = "bounds or bodies leave no interior to sample intervals from" if posterior is None else posterior.note
    return TwoSessionOptimum(found.psi, posterior, found.active, (note,))
