"""Parameters of any dynamics ẋ = f(x, u, θ), y = h(x, u, θ) from what sensors recorded: one bounded nonlinear program.

Unknowns are θ and the states of every record, at its samples and between them. The dynamics are constraints, so that
a start far off does not run away as a simulation would (multiple shooting, Bock 1987, every interval being one). With
Gaussian errors of the readings and Gaussian priors the answer is the most probable one. IPOPT finds it with the
constrained Gauss-Newton Hessian; the information on θ is what is left when the dynamics have eliminated the states.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.stats import truncnorm

from hydroopt.errors import ProblemError, SolverError
from hydroopt.estimation.hydraulic.collocation import Linearised, Program
from hydroopt.estimation.hydraulic.dynamics import POINTS, Record, ShootingProblem, free_run
from hydroopt.estimation.inference import solvers
from hydroopt.estimation.inference.correlation import correlation_time
from hydroopt.estimation.inference.identifiability import ROUNDING_TOLERANCE, significant
from hydroopt.spatial.inertia import Array

PATIENCE, NEAR = 60, 0.1
"""Steps that the Gauss-Newton Hessian gets to come near (the exact one gets twice as many), and IPOPT's error, in
squares of σ, that counts as near."""
ASTRAY = 3.0
"""How many times the stated errors must be exceeded for another start to be tried."""
ROUGHLY = 1e-6
"""Error of the steps of a simulation to start from."""
UNKNOWN = 0.5
"""Part of the prior's information below which the data's counts as telling less than the prior."""
SHARE = 0.3
"""Component of a direction from which on a parameter belongs to it."""


@dataclass(frozen=True, eq=False)
class ShootingEstimate:
    """A solved problem.

    Attributes:
        problem: what was solved.
        at: parameters, states, and the rows around them.
    """

    problem: ShootingProblem
    at: Linearised

    @property
    def theta(self) -> Array:
        """(p,) most probable parameters."""
        return self.at.theta

    def __getitem__(self, name: str) -> float:
        """Value of a parameter."""
        return float(self.theta[self.problem.parameters.index(name)])

    @cached_property
    def data(self) -> Array:
        """(p, p) information of the readings on θ, the first states being unknown but for their priors."""
        p, parameters = len(self.theta), self.problem.parameters
        rows = np.delete(self.at.jacobian, np.s_[self.at.seen : self.at.seen + self.at.known], axis=0)
        unit = rows[:, :p] * parameters.scale
        left = _without(rows[:, p:], unit)
        return np.asarray(left.T @ left / np.outer(parameters.scale, parameters.scale))

    @cached_property
    def covariance(self) -> Array:
        """(p, p), infinite variances where neither readings nor priors tell; widened where residuals exceed σ."""
        scale = self.problem.parameters.scale
        values, vectors = np.linalg.eigh((self.data + self.problem.parameters.information) * np.outer(scale, scale))
        told = values > 1e-12 * max(float(values[-1]), 1e-300)
        root = vectors[:, told] / np.sqrt(values[told])
        covariance = root @ root.T * max(1.0, self.residual_scale) ** 2 * np.outer(scale, scale)
        blind = np.linalg.norm(vectors[:, ~told], axis=1) > 1e-5
        covariance[blind, :] = covariance[:, blind] = 0.0
        covariance[blind, blind] = np.inf
        return np.asarray(covariance)

    @cached_property
    def residual_scale(self) -> float:
        """Root of the squared errors over the degrees of freedom; 1 where the stated σ are right."""
        unit = self.at.jacobian[: self.at.seen].copy()
        unit[:, : len(self.theta)] *= self.problem.parameters.scale  # in SI, moduli beside leaks look like none
        freedom = self.at.seen - np.linalg.matrix_rank(unit)
        return float(np.sqrt(np.sum(self.at.rows[: self.at.seen] ** 2) / freedom)) if freedom > 0 else float("nan")

    @cached_property
    def gradient(self) -> Array:
        """(p,) of half the squared errors by θ, the first states following: zero but where a bound holds."""
        p = len(self.theta)
        return np.asarray(self.at.jacobian[:, :p].T @ _without(self.at.jacobian[:, p:], self.at.rows))

    @property
    def at_bound(self) -> NDArray[np.bool_]:
        """(p,) which parameters are held back by a bound, where a symmetric interval would be wrong."""
        parameters, near = self.problem.parameters, 1e-6 * self.problem.parameters.scale
        return np.asarray((self.theta < parameters.lower + near) | (self.theta > parameters.upper - near))

    @cached_property
    def std(self) -> Array:
        """(p,) standard deviations; NaN at a bound and where neither readings nor priors tell."""
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
        left[np.flatnonzero(np.isfinite(readings).ravel())] = -self.at.rows[: self.at.seen]
        ends = np.cumsum([len(record.t) for record in self.problem.records])[:-1]
        return tuple(np.split(left.reshape(readings.shape), ends))

    @property
    def reweighted(self) -> ShootingProblem:
        """The problem with σ of each channel as large as residuals show, errors that repeat themselves counted as one.

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
            first: states to begin with.

        Raises:
            ProblemError: the record was not fitted, and no first states are given.
            SolverError: the states run away.
        """
        if first is None:
            known = [k for k, own in enumerate(self.problem.records) if own is record]
            if not known:
                raise ProblemError("this record was not fitted, so that its first states are not known",
                                   where=record.name, remedy="give them")
            first = self.at.points[known[0]][0]
        return free_run(self.problem.dynamics, record, first, self.theta)

    @cached_property
    def _weak(self) -> tuple[tuple[Array, NDArray[np.intp], float], ...]:
        """Directions (p,) about which the readings tell little, who belongs to each, and how much they tell."""
        parameters = self.problem.parameters
        prior = np.sqrt(np.diag(parameters.information))
        size = np.maximum(np.abs(self.theta), parameters.scale)
        unit = np.where(prior > 0, 1 / np.where(prior > 0, prior, 1.0), size)
        values, vectors = np.linalg.eigh(self.data * np.outer(unit, unit))
        found = []
        for k in np.flatnonzero(values < UNKNOWN):
            weight = np.abs(vectors[:, k])
            belong = np.flatnonzero(weight > SHARE * np.max(weight))
            found.append((vectors[:, k] * unit, belong[np.argsort(-weight[belong])], float(values[k])))
        return tuple(found)

    def category(self, name: str) -> str:
        """``full``, ``combination`` or ``none``, by the readings alone."""
        k = self.problem.parameters.index(name)
        sizes = [len(belong) for _, belong, _ in self._weak if k in belong]
        return "full" if not sizes else "none" if min(sizes) == 1 else "combination"

    @property
    def doubts(self) -> tuple[str, ...]:
        """What the readings cannot tell, in plain words."""
        return (*(self._words(*weak) for weak in self._weak),
                *(self._held(int(k)) for k in np.flatnonzero(self.at_bound)))

    def _held(self, k: int) -> str:
        """What is known of a parameter that stands at a bound."""
        parameters, (low, high) = self.problem.parameters, self.ci95[k]
        least = self.gradient[k] > 0
        return (f"{parameters.names[k]} stands at its {'least' if least else 'greatest'} value, "
                f"{(parameters.lower if least else parameters.upper)[k]:.3g} {parameters.units[k]}; 95 % lie "
                f"{'below' if least else 'above'} {high if least else low:.3g}")

    def _words(self, direction: Array, belong: NDArray[np.intp], value: float) -> str:
        """One direction about which the readings tell little."""
        parameters = self.problem.parameters
        names = [parameters.names[k] for k in belong]
        informed = all(parameters.information[k, k] > 0 for k in belong)
        decides = "the prior decides" if informed else "nothing decides"
        if len(names) == 1:
            k = belong[0]
            if value < 1e-6:
                return f"{names[0]}: the readings tell nothing of it; {decides}"
            reach = 1.96 * abs(direction[k]) / np.sqrt(value)
            low = max(self.theta[k] - reach, parameters.lower[k])
            high = min(self.theta[k] + reach, parameters.upper[k])
            return (f"{names[0]}: the readings hold anything from {low:.3g} to {high:.3g} {parameters.units[k]}; "
                    f"{decides}")
        if len(names) == 2 and np.all(self.theta[belong] != 0):
            relative = direction[belong] / self.theta[belong]
            how = "ratio" if relative[0] * relative[1] > 0 else "product"
            if abs(abs(relative[0] / relative[1]) - 1) < SHARE:
                return f"{' and '.join(names)} show only as a {how}; {decides} between them"
        return f"{', '.join(names[:-1])} and {names[-1]} show only together; {decides} between them"


def _without(columns: Array, rows: Array) -> Array:
    """Rows (m, ·) less what columns (m, f) can explain; columns that leave no trace explain nothing."""
    basis, size, _ = np.linalg.svd(columns, full_matrices=False)
    basis = basis[:, significant(size, ROUNDING_TOLERANCE)]
    return np.asarray(rows - basis @ (basis.T @ rows))


def multiple_shooting(problem: ShootingProblem, start: Array | ShootingEstimate | None = None) -> ShootingEstimate:
    """The most probable parameters and motion, from `start` (p,), an estimate nearby, or the nominal parameters.

    It begins with a simulation by the start or, if that comes to nothing, with the guessed states. The Gauss-Newton
    Hessian leads near, if it does; the exact one goes on, since the other creeps where much is left unexplained. Finer
    intervals than the samples' come last.

    Raises:
        SolverError: IPOPT failed or its answer failed our check.
    """
    if isinstance(start, ShootingEstimate):
        return _solved(problem, start.theta, start.at.points, exact=True)
    parameters = problem.parameters
    theta = np.clip(parameters.nominal if start is None else start, parameters.lower, parameters.upper)
    if all(record.steps == 1 for record in problem.records):
        return _best(problem, theta)
    coarse = replace(problem, records=tuple(replace(record, steps=1) for record in problem.records))
    best = _best(coarse, theta)
    finer = [r.between(points[::POINTS]) for r, points in zip(problem.records, best.at.points, strict=True)]
    return _solved(problem, best.theta, finer, exact=True)


def _best(problem: ShootingProblem, theta: Array) -> ShootingEstimate:
    """From a simulation or, if that comes to nothing or far from the readings, from guessed states, too."""
    try:
        found = _solved_near(problem, theta, _simulated(problem, theta))
        if found.residual_scale < ASTRAY:
            return found
    except SolverError:
        return _solved_near(problem, theta, _guessed(problem, theta))
    with suppress(SolverError):
        other = _solved_near(problem, theta, _guessed(problem, theta))
        return min(found, other, key=lambda one: float(np.sum(one.at.rows**2)))
    return found


def _solved_near(problem: ShootingProblem, theta: Array, points: Sequence[Array]) -> ShootingEstimate:
    with suppress(SolverError):
        near = _solved(problem, theta, points, exact=False)
        theta, points = near.theta, near.at.points
    return _solved(problem, theta, points, exact=True)


def _simulated(problem: ShootingProblem, theta: Array) -> list[Array]:
    found = [(r, free_run(problem.dynamics, r, r.guess[0], theta, accuracy=ROUGHLY)[0]) for r in problem.records]
    if not all(np.all(np.isfinite(states)) for _, states in found):
        raise SolverError("the simulation left what is possible", where=problem.name, remedy="start elsewhere")
    return [r.between(states) for r, states in found]


def _guessed(problem: ShootingProblem, theta: Array) -> list[Array]:
    return [r.between(r.guess) for r in problem.records]


def _solved(problem: ShootingProblem, theta: Array, points: Sequence[Array], *, exact: bool) -> ShootingEstimate:
    program = Program(problem)
    parameters = problem.parameters
    x = ca.MX.sym("x", program.size)
    weight, multipliers, nothing = ca.MX.sym("weight"), ca.MX.sym("multipliers", program.defects), ca.MX.sym("p", 0)
    at = program.at(x, weight, multipliers)
    cost = ca.sumsqr(at.rows) / 2
    hessian = weight * (at.rows_by_x.T @ at.rows_by_x) + (at.curvature if exact else 0)
    options: dict[str, Any] = {
        "grad_f": ca.Function("grad_f", [x, nothing], [cost, ca.densify(at.rows_by_x.T @ at.rows)],
                              ["x", "p"], ["f", "grad_f_x"]),
        "jac_g": ca.Function("jac_g", [x, nothing], [at.defects, at.defects_by_x], ["x", "p"], ["g", "jac_g_x"]),
        "hess_lag": ca.Function("hess_lag", [x, nothing, weight, multipliers], [ca.triu(hessian)],
                                ["x", "p", "lam_f", "lam_g"], ["triu_hess_gamma_x_x"])}
    options |= ({"ipopt.max_iter": 2 * PATIENCE, "ipopt.mu_init": 1e-4} if exact else
                {"ipopt.max_iter": PATIENCE, "ipopt.tol": NEAR, "ipopt.dual_inf_tol": NEAR})
    free = np.full(program.size - len(parameters), np.inf)
    lower = np.concatenate([(parameters.lower - parameters.nominal) / parameters.scale, -free])
    upper = np.concatenate([(parameters.upper - parameters.nominal) / parameters.scale, free])
    zero = np.zeros(program.defects)
    nlp, where = {"x": x, "f": cost, "g": at.defects}, f"identification of {problem.name}"
    answer = solvers.solve_nlp(nlp, program.start(theta, points), lower, upper, zero, zero, where, (), options)
    return ShootingEstimate(problem, program.linearised(answer))
