"""Two sessions in one least squares: all parameters are shared except those that may have changed in between.

Before: f = K·ψ; after: f = K·ψ + K_c·δ. The first session and the machine file's priors determine ψ, and the
residuals of the second the change; both share every error of a wrong nominal model.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from hydroopt.errors import IdentifiabilityError, SolverError
from hydroopt.estimation.dynamic.folding import split, triangle
from hydroopt.estimation.dynamic.problem import IdentificationProblem
from hydroopt.estimation.dynamic.stored_information import StoredInformation
from hydroopt.estimation.inference import posterior as uncertainty
from hydroopt.estimation.inference import sdp
from hydroopt.estimation.inference.band_variances import FTest, combined, f_test, students
from hydroopt.estimation.inference.conditions import ScaledBody
from hydroopt.estimation.inference.constraints import Constraint, Named
from hydroopt.estimation.inference.identifiability import RANK_TOLERANCE
from hydroopt.estimation.inference.least_squares import orthonormal, without
from hydroopt.estimation.inference.whitening import gaussian_posterior
from hydroopt.model.model import Model
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


def two_session_problem(model: Model, names: Sequence[str]) -> TwoSessionProblem:
    """The problem in which parameters of these names may have changed between two sessions."""
    parameters, p = model.parameters, len(model.parameters)
    twice = doubled(parameters, names)
    chosen, copies = np.eye(p)[twice], [parameters.names[k] for k in twice]
    positions = [p + copies.index(name) for name in names]
    tied = tuple(Constraint(f"{name} unchanged", partial(_unchanged, name)) for name in copies if name not in names)
    return TwoSessionProblem(model, (), constraints=tied,
                      unknowns=joined(parameters, second_parameters(parameters, twice)),
                      second=np.hstack([np.eye(p) - chosen.T @ chosen, chosen.T]),
                      null=np.vstack([np.eye(p), chosen]), change=np.eye(p + len(twice))[:, positions],
                      labels=tuple(names))


def _unchanged(name: str, x: Named) -> Any:
    return x[AFTER + name] == x[name]


def folded(A: Array, b: Array) -> tuple[Array, Array]:
    """R (P, P) and r (P,) of ``‖R·x − r‖² = ‖A·x − b‖²`` without the part that no x changes."""
    return split(triangle(np.column_stack([A, b])))[:2]


class Wald(NamedTuple):
    """Least squares and test of a change δ (c,), without bounds and physical consistency.

    Attributes:
        value, std: (c,) NaN where δ is not identifiable.
        statistic, rank, freedom, p_value: F, Hotelling's test with k = `rank` identifiable directions of δ,
            W the Wald statistic of δ = 0 in them, and `freedom` of its denominator.
        freedoms: (c,) degrees of freedom of each δ's own standard deviation.
        partners: for each δ that is not identifiable, the positions of those it cannot be separated from.
        alone: value, standard deviation, and p-value of what is left over (c,), if this δ were the only one.
    """

    value: Array
    std: Array
    freedoms: Array
    statistic: float
    rank: int
    freedom: float
    p_value: float
    partners: tuple[tuple[int, ...], ...]
    alone: tuple[Array, Array, Array]

    def over(self, phi: float) -> Wald:
        """The same test where squared differences are φ times what the variances of the rows explain."""
        value, std, left = self.alone
        count = max(self.rank - 1, 1)
        left = stats.f.sf(stats.f.isf(left, count, self.freedom) / phi, count, self.freedom)
        return self._replace(std=self.std * np.sqrt(phi), statistic=self.statistic / phi,
                             p_value=float(stats.f.sf(self.statistic / phi, self.rank, self.freedom)),
                             alone=(value, std * np.sqrt(phi), np.asarray(left)))

    def single(self) -> Array:
        """Two-sided p-value (c,) of each δ by itself, NaN where it is not identifiable."""
        return np.asarray(2 * stats.t.sf(np.abs(self.value) / self.std, self.freedoms))


def wald(problem: TwoSessionProblem, A: Array, b: Array, freedom: Array) -> Wald:
    """Test whether anything has changed, on the directions of δ that data and priors determine.

    Args:
        problem: what may have changed, and the priors.
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
    U = orthonormal(rows @ (problem.null * np.linalg.norm(problem.null.T * scale, axis=1)))
    moved = A @ problem.change
    size = np.linalg.norm(moved, axis=0)
    effect = size * (scale @ np.abs(problem.change))
    touched = np.flatnonzero(effect > 1e-12 * np.max(effect, initial=0.0))
    C = np.vstack([moved, np.zeros((len(prior), moved.shape[1]))])[:, touched] / size[touched]
    C, rest = without(U, C), without(U, rest)
    left, s, axes = np.linalg.svd(C, full_matrices=False)
    identified = s > RANK_TOLERANCE
    k = int(np.sum(identified))
    if not k:
        raise IdentifiabilityError("these logs do not identify a change of these parameters", where=problem.where,
                                   remedy="drive longer motions that excite them, in both sessions")
    left, along = left[:, identified], left[:, identified].T @ rest
    freedom = np.append(freedom, np.full(len(prior), np.inf))
    value, std, own = (np.full(len(size), np.nan) for _ in range(3))
    root = axes[identified].T / s[identified] / size[touched][:, None]
    hidden = axes[~identified].T @ axes[~identified]
    alone = np.abs(hidden).max(axis=1, initial=0.0) < 1e-6
    value[touched[alone]] = (root @ along)[alone]
    std[touched[alone]] = np.sqrt(np.sum(root**2, axis=1))[alone]
    own[touched[alone]] = combined((left @ root[alone].T / std[touched[alone]]) ** 2, freedom)
    partners: list[tuple[int, ...]] = [()] * len(size)
    for i in np.flatnonzero(~alone):
        partners[touched[i]] = tuple(int(touched[j]) for j in np.flatnonzero(np.abs(hidden[i]) > 1e-3) if j != i)
    test = f_test(along, left**2, freedom)
    return Wald(value, std, own, *test, tuple(partners),
                _one_by_one(C, rest, float(along @ along), test, touched, size))


def _one_by_one(C: Array, rest: Array, whole: float, test: FTest, touched: NDArray[np.intp],
                size: Array) -> tuple[Array, Array, Array]:
    """Least squares on each column of C (rows, ·) by itself, and how much of the Wald statistic it leaves."""
    value, std, p = (np.full(len(size), np.nan) for _ in range(3))
    length = np.linalg.norm(C, axis=0)
    own = np.flatnonzero(length > RANK_TOLERANCE)
    at, share = touched[own], (C[:, own].T @ rest) / length[own]
    value[at], std[at] = share / length[own] / size[at], 1 / length[own] / size[at]
    left = np.maximum(1 - share**2 / max(whole, 1e-300), 0.0) * test.statistic * test.rank / max(test.rank - 1, 1)
    p[at] = stats.f.sf(left, test.rank - 1, test.freedom) if test.rank > 1 else 1.0
    return value, std, p


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
    found = sdp.semidefinite_program(problem, gaussian_posterior(problem, R, r), consistent=problem.consistent)
    if not intervals:
        return TwoSessionOptimum(found.psi, None, found.active, ())
    posterior = uncertainty.sample(problem, R, r, found.psi, consistent=problem.consistent, seed=seed)
    note = "bounds or bodies leave no interior to sample intervals from" if posterior is None else posterior.note
    return TwoSessionOptimum(found.psi, posterior, found.active, (note,))
