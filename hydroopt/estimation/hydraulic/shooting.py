"""Parameters of any dynamics ẋ = f(x, u, θ), y = h(x, u, θ) from what sensors recorded: one bounded nonlinear program.

Unknowns are θ and the states of every record, at its samples and between them. The dynamics are constraints, so that a
poor initial guess does not diverge as a simulation would (multiple shooting, Bock 1987, every interval being one). With
Gaussian errors of the readings and Gaussian priors the answer is the most probable one. IPOPT finds it with the
constrained Gauss-Newton Hessian; the information on θ is what is left when the dynamics have eliminated the states.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.stats import truncnorm

from hydroopt.errors import ProblemError, SolverError
from hydroopt.estimation.hydraulic.collocation import Linearised, Program
from hydroopt.estimation.hydraulic.dynamics import POINTS, Record, ShootingProblem, free_run
from hydroopt.estimation.inference import ipopt
from hydroopt.estimation.inference.correlation import correlation_time
from hydroopt.estimation.inference.identifiability import ROUNDING_TOLERANCE, significant
from hydroopt.spatial.inertia import Array

PATIENCE, NEAR = 60, 0.1
"""Steps that the Gauss-Newton Hessian gets to come near (the exact one gets twice as many), and IPOPT's error, in
squares of σ, that counts as near."""
ASTRAY = 3.0
"""Ratio of residuals and stated errors from which on another start is tried."""
ROUGHLY = 1e-6
"""Error of the steps of a simulation to start from."""
UNKNOWN = 0.5
"""Part of the prior's information below which the data's counts as telling less than the prior."""
SHARE = 0.3
"""Component of a direction from which on a parameter belongs to it."""


class WeakDirection(NamedTuple):
    """A direction of the parameters on which the data carry little information.

    Attributes:
        direction: (p,) change of the parameters, as long as one standard deviation of their priors.
        members: positions of the parameters that belong to it, the largest component first.
        information: of the data on it, 1 where they carry as much as the prior.
    """

    direction: Array
    members: NDArray[np.intp]
    information: float


@dataclass(frozen=True, eq=False)
class ShootingEstimate:
    """A solved problem.

    Attributes:
        problem: what was solved.
        solution: parameters, states, and the residual rows around them.
    """

    problem: ShootingProblem
    solution: Linearised

    @property
    def theta(self) -> Array:
        """(p,) most probable parameters."""
        return self.solution.theta

    def __getitem__(self, name: str) -> float:
        """Value of a parameter."""
        return float(self.theta[self.problem.parameters.index(name)])

    @cached_property
    def data(self) -> Array:
        """(p, p) information of the readings on θ, the first states being unknown but for their priors."""
        p, parameters = len(self.theta), self.problem.parameters
        first = self.solution.readings
        rows = np.delete(self.solution.jacobian, np.s_[first : first + self.solution.priors], axis=0)
        unit = rows[:, :p] * parameters.scale
        left = _without(rows[:, p:], unit)
        return np.asarray(left.T @ left / np.outer(parameters.scale, parameters.scale))

    @cached_property
    def covariance(self) -> Array:
        """(p, p), infinite variances where neither readings nor priors inform; widened where residuals exceed σ."""
        scale = self.problem.parameters.scale
        values, vectors = np.linalg.eigh((self.data + self.problem.parameters.information) * np.outer(scale, scale))
        informed = values > 1e-12 * max(float(values[-1]), 1e-300)
        root = vectors[:, informed] / np.sqrt(values[informed])
        covariance = root @ root.T * max(1.0, self.residual_scale) ** 2 * np.outer(scale, scale)
        undetermined = np.linalg.norm(vectors[:, ~informed], axis=1) > 1e-5
        covariance[undetermined, :] = covariance[:, undetermined] = 0.0
        covariance[undetermined, undetermined] = np.inf
        return np.asarray(covariance)

    @cached_property
    def residual_scale(self) -> float:
        """Root of the squared errors over the degrees of freedom; 1 where the stated σ are right."""
        unit = self.solution.jacobian[: self.solution.readings].copy()
        unit[:, : len(self.theta)] *= self.problem.parameters.scale  # in SI, moduli beside leaks look like none
        freedom = self.solution.readings - np.linalg.matrix_rank(unit)
        squares = np.sum(self.solution.rows[: self.solution.readings] ** 2)
        return float(np.sqrt(squares / freedom)) if freedom > 0 else float("nan")

    @cached_property
    def gradient(self) -> Array:
        """(p,) of half the squared errors by θ, the first states following: zero but where a bound holds."""
        p = len(self.theta)
        return np.asarray(self.solution.jacobian[:, :p].T @ _without(self.solution.jacobian[:, p:], self.solution.rows))

    @property
    def at_bound(self) -> NDArray[np.bool_]:
        """(p,) which parameters are held back by a bound, where a symmetric interval would be wrong."""
        parameters, near = self.problem.parameters, 1e-6 * self.problem.parameters.scale
        return np.asarray((self.theta < parameters.lower + near) | (self.theta > parameters.upper - near))

    @cached_property
    def std(self) -> Array:
        """(p,) standard deviations; NaN at a bound and where neither readings nor priors inform."""
        std = np.sqrt(np.diag(self.covariance))
        return np.where(np.isfinite(std) & ~self.at_bound, std, np.nan)

    @cached_property
    def ci95(self) -> Array:
        """(p, 2) intervals of the Gaussian within the bounds; from a bound on where it holds a parameter.

        There the Gaussian's middle lies beyond the bound, as far as a step without bounds would lead.
        """
        parameters, std = self.problem.parameters, np.sqrt(np.diag(self.covariance))
        inner = np.where(np.isfinite(std)[:, None] & np.isfinite(std), self.covariance, 0.0)
        middle = np.where(self.at_bound, self.theta - inner @ self.gradient, self.theta)
        low, high = (parameters.lower - middle) / std, (parameters.upper - middle) / std
        part = np.where(self.at_bound, np.where(self.gradient > 0, 0.0, 0.05), 0.025)
        interval = middle[:, None] + std[:, None] * truncnorm.ppf(
            np.column_stack([part, part + 0.95]), low[:, None], high[:, None])
        return np.where(np.isfinite(std)[:, None], interval, np.nan)

    @cached_property
    def residuals(self) -> tuple[Array, ...]:
        """For each record readings minus outputs (N, ny) in units of σ, NaN where there was no reading."""
        readings = np.concatenate([record.y for record in self.problem.records])
        left = np.full(readings.size, np.nan)
        left[np.flatnonzero(np.isfinite(readings).ravel())] = -self.solution.rows[: self.solution.readings]
        ends = np.cumsum([len(record.t) for record in self.problem.records])[:-1]
        return tuple(np.split(left.reshape(readings.shape), ends))

    @property
    def reweighted(self) -> ShootingProblem:
        """The problem with σ of each channel as large as residuals show, correlated errors counted as one.

        What no parameter explains, a real system's other dynamics, so does not count as many independent readings.
        """
        count = [len(record.t) for record in self.problem.records]
        segment = np.repeat(np.arange(len(count)), count)
        left = np.concatenate(self.residuals)
        factor = np.ones(left.shape[1])
        for k, column in enumerate(left.T):
            taken = np.isfinite(column)
            if np.any(taken):
                time = correlation_time(np.where(taken, column, 0.0), taken, segment)
                factor[k] = max(1.0, float(np.sqrt(np.mean(column[taken] ** 2)))) * np.sqrt(time)
        return replace(self.problem, sigma=self.problem.sigma * factor)

    def free_run(self, record: Record, first: Array | None = None) -> tuple[Array, Array]:
        """States (N, nx) and outputs (N, ny) simulated from a record's inputs, and the estimated first states.

        Args:
            record: any; one that was not fitted needs `first` (nx,), its states at the beginning.
            first: initial states.

        Raises:
            ProblemError: the record was not fitted, and no first states are given.
            SolverError: the states diverge.
        """
        if first is None:
            known = [k for k, own in enumerate(self.problem.records) if own is record]
            if not known:
                raise ProblemError("this record was not fitted, so that its first states are not known",
                                   where=record.name, remedy="give them")
            first = self.solution.points[known[0]][0]
        return free_run(self.problem.dynamics, record, first, self.theta)

    @cached_property
    def weak_directions(self) -> tuple[WeakDirection, ...]:
        """Directions on which the data carry less information than `UNKNOWN`."""
        parameters = self.problem.parameters
        prior = np.sqrt(np.diag(parameters.information))
        size = np.maximum(np.abs(self.theta), parameters.scale)
        unit = np.where(prior > 0, 1 / np.where(prior > 0, prior, 1.0), size)
        values, vectors = np.linalg.eigh(self.data * np.outer(unit, unit))
        found = []
        for k in np.flatnonzero(values < UNKNOWN):
            weight = np.abs(vectors[:, k])
            belong = np.flatnonzero(weight > SHARE * np.max(weight))
            found.append(WeakDirection(vectors[:, k] * unit, belong[np.argsort(-weight[belong])], float(values[k])))
        return tuple(found)

    def category(self, name: str) -> str:
        """``full``, ``combination`` or ``none``, by the readings alone."""
        k = self.problem.parameters.index(name)
        sizes = [len(each.members) for each in self.weak_directions if k in each.members]
        return "full" if not sizes else "none" if min(sizes) == 1 else "combination"


def _without(columns: Array, rows: Array) -> Array:
    """Rows (m, ·) less what columns (m, f) can explain; columns that leave no trace explain nothing."""
    basis, size, _ = np.linalg.svd(columns, full_matrices=False)
    basis = basis[:, significant(size, ROUNDING_TOLERANCE)]
    return np.asarray(rows - basis @ (basis.T @ rows))


def multiple_shooting(problem: ShootingProblem, start: Array | ShootingEstimate | None = None) -> ShootingEstimate:
    """The most probable parameters and motion, from `start` (p,), an estimate nearby, or the nominal parameters.

    The initial guess is a simulation from the start or, if that fails, the measured states. The Gauss-Newton Hessian
    comes first; the exact one continues, since the former converges slowly with large residuals. Intervals finer than
    the samples' come last.

    Raises:
        SolverError: IPOPT failed or its answer failed our check.
    """
    if isinstance(start, ShootingEstimate):
        theta, points = start.theta, start.solution.points
        with suppress(SolverError):
            return _solved(problem, theta, points, exact=True)
        # the start fulfils all constraints, so that IPOPT has nothing to restore where its line search rejects the step
        # of an indefinite Hessian; that of Gauss and Newton is not indefinite
        return _solved_near(problem, theta, points)
    parameters = problem.parameters
    theta = np.clip(parameters.nominal if start is None else start, parameters.lower, parameters.upper)
    if all(record.steps == 1 for record in problem.records):
        return _best(problem, theta)
    coarse = replace(problem, records=tuple(replace(record, steps=1) for record in problem.records))
    best = _best(coarse, theta)
    finer = [r.between(points[::POINTS]) for r, points in zip(problem.records, best.solution.points, strict=True)]
    return _solved(problem, best.theta, finer, exact=True)


def _best(problem: ShootingProblem, theta: Array) -> ShootingEstimate:
    """From a simulation or, if that fails or is far from the readings, from measured states, too."""
    try:
        found = _solved_near(problem, theta, _simulated(problem, theta))
        if found.residual_scale < ASTRAY:
            return found
    except SolverError:
        return _solved_near(problem, theta, measured_states(problem))
    with suppress(SolverError):
        other = _solved_near(problem, theta, measured_states(problem))
        return min(found, other, key=lambda one: float(np.sum(one.solution.rows**2)))
    return found


def _solved_near(problem: ShootingProblem, theta: Array, points: Sequence[Array]) -> ShootingEstimate:
    with suppress(SolverError):
        near = _solved(problem, theta, points, exact=False)
        theta, points = near.theta, near.solution.points
    return _solved(problem, theta, points, exact=True)


def _simulated(problem: ShootingProblem, theta: Array) -> list[Array]:
    found = [(r, free_run(problem.dynamics, r, r.guess[0], theta, accuracy=ROUGHLY)[0]) for r in problem.records]
    if not all(np.all(np.isfinite(states)) for _, states in found):
        raise SolverError("the simulation diverged", where=problem.name, remedy="give another start")
    return [r.between(states) for r, states in found]


def _solved(problem: ShootingProblem, theta: Array, points: Sequence[Array], *, exact: bool) -> ShootingEstimate:
    collocation = Program(problem)
    nlp = collocation.nlp(theta, points)
    x, weight, multipliers = nlp.x, ca.MX.sym("weight"), ca.MX.sym("multipliers", collocation.defects)
    here, nothing = collocation.expressions(x, weight, multipliers), ca.MX.sym("p", 0)
    hessian = weight * (here.rows_by_x.T @ here.rows_by_x) + (here.curvature if exact else 0)
    options: dict[str, Any] = {
        "grad_f": ca.Function("grad_f", [x, nothing], [
            ca.sumsqr(here.rows) / 2, ca.densify(here.rows_by_x.T @ here.rows)], ["x", "p"], ["f", "grad_f_x"]),
        "jac_g": ca.Function("jac_g", [x, nothing], [here.defects, here.defects_by_x], ["x", "p"], ["g", "jac_g_x"]),
        "hess_lag": ca.Function("hess_lag", [x, nothing, weight, multipliers], [ca.triu(hessian)],
                                ["x", "p", "lam_f", "lam_g"], ["triu_hess_gamma_x_x"])}
    options |= ({"ipopt.max_iter": 2 * PATIENCE, "ipopt.mu_init": 1e-4} if exact else
                {"ipopt.max_iter": PATIENCE, "ipopt.tol": NEAR, "ipopt.dual_inf_tol": NEAR})
    answer = ipopt.solve_nlp(nlp.as_dict(), nlp.x0, nlp.lbx, nlp.ubx, nlp.lbg, nlp.ubg,
                               f"identification of {problem.name}", (), options)
    return ShootingEstimate(problem, collocation.linearised(answer))


def measured_states(problem: ShootingProblem) -> list[Array]:
    """Initial guess of the states (K, nx) of every record, straight between those at the samples."""
    return [r.between(r.guess) for r in problem.records]
