"""Parameters of any dynamics ẋ = f(x, u, θ), y = h(x, u, θ) from what sensors recorded: bounded least squares.

Unknowns are θ and the first states of every record; from these the dynamics give all others. With Gaussian errors of
the readings and Gaussian priors the answer is the most probable one. The information on θ is what is left when the
first states are eliminated.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.stats import truncnorm

from hydroopt.errors import ProblemError
from hydroopt.estimation.hydraulic.collocation import Collocation
from hydroopt.estimation.hydraulic.dynamics import Record, ShootingProblem, free_run
from hydroopt.estimation.hydraulic.levenberg_marquardt import Motion, fitted_motion, least_squares
from hydroopt.estimation.inference.correlation import correlation_time
from hydroopt.estimation.inference.identifiability import ROUNDING_TOLERANCE, significant
from hydroopt.spatial.inertia import Array

UNKNOWN = 0.5
"""Part of the prior's information below which the data's counts as telling less than the prior."""
SHARE = 0.3
"""Component of a direction from which on a parameter belongs to it."""


@dataclass(frozen=True, eq=False)
class Linearised:
    """Residual rows around a solution, with the states as they follow from θ and the first states of the records.

    Attributes:
        theta: (p,).
        points: for each record states (K, nx) at the points of `Record.time`.
        rows: (m,) outputs minus readings in units of σ, `readings` of them; then `priors` rows of the priors of θ, and
            those of first states.
        jacobian: (m, p + f) by θ, then by the records' f first states, in units of `Dynamics.scale`.
    """

    theta: Array
    points: tuple[Array, ...]
    rows: Array
    jacobian: Array
    readings: int
    priors: int


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

    Raises:
        SolverError: the dynamics cannot be simulated, or the steps do not converge.
    """
    parameters, scale, collocation = problem.parameters, problem.dynamics.scale, Collocation(problem)
    if isinstance(start, ShootingEstimate):
        z = (start.theta - parameters.nominal) / parameters.scale
        found = least_squares(collocation, z, [states / scale for states in start.solution.points])
    else:
        theta = np.clip(parameters.nominal if start is None else start, parameters.lower, parameters.upper)
        found = fitted_motion(collocation, (theta - parameters.nominal) / parameters.scale,
                              [states / scale for states in measured_states(problem)])
    return ShootingEstimate(problem, _linearised(collocation, found))


def _linearised(collocation: Collocation, found: Motion) -> Linearised:
    """All residual rows around a motion."""
    problem, parameters = collocation.problem, collocation.problem.parameters
    linear, p, nx = collocation.condensed(found.z, found.points), collocation.p, collocation.nx
    of_z, of_first = [each.jacobian[:, nx:] for each in linear], [each.jacobian[:, :nx] for each in linear]
    count = sum(len(each.slope) for each in linear)
    jacobian = np.block([[np.vstack(of_z), block_diag(*of_first)],
                         [collocation.prior, np.zeros((len(collocation.prior), nx * len(linear)))],
                         [np.zeros((count, p)), block_diag(*(each.slope for each in linear))]])
    jacobian[:, :p] /= parameters.scale
    rows = np.concatenate([*(each.rows for each in linear), collocation.prior @ found.z,
                           *(each.first for each in linear)])
    theta = np.clip(parameters.nominal + parameters.scale * found.z, parameters.lower, parameters.upper)  # rounding
    return Linearised(theta, tuple(states * problem.dynamics.scale for states in found.points), rows, jacobian,
                      len(rows) - len(collocation.prior) - count, len(collocation.prior))


def measured_states(problem: ShootingProblem) -> list[Array]:
    """Initial guess of the states (K, nx) of every record, straight between those at the samples."""
    return [r.between(r.guess) for r in problem.records]
