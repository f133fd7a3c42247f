"""Valves and oil from volume balances whose readings all err: the Gauss-Helmert adjustment.

The most probable numbers are those for which the smallest corrections of readings, in units of their σ, close all
balances (Mikhail and Ackermann 1976, conditions with parameters). Derivatives are taken at the corrected readings: at
the raw ones, noise in the pressures makes the spring of the oil look softer than it is. A reading belongs to two
intervals, so that the balances' covariance is a band. What the model misses is a random flow beside the readings'
errors, whose density is the one with the greatest likelihood.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded, solve_banded
from scipy.optimize import minimize_scalar

from hydroopt.errors import SolverError
from hydroopt.estimation.hydraulic.bounded_gaussian import BoundedGaussian
from hydroopt.estimation.hydraulic.volume_balance import QUANTITIES, Misclosure, Readings, VolumeBalance
from hydroopt.estimation.inference.gauss_newton import Step, bounded_step, minimise
from hydroopt.estimation.inference.program import NonlinearProgram
from hydroopt.parameters.parameter_set import ParameterSet
from hydroopt.spatial.inertia import Array

CONVERGED = 0.04
"""Length of a step, in standard deviations, that ends the search."""
CORRECTIONS, SMALL = 4, 0.03
"""How often corrections are computed anew, until none changes by this part of its σ."""
STEPS = 60
"""Greatest number of steps."""
LEAST, MOST = 0.01, 10.0
"""Densities of the random flow: what adds this part of a reading's error over a whole stretch, and in an interval."""
INFORMED = 1e-10
"""Part of the greatest information below which another is rounding."""
ROUNDS, AGREED = 10, 0.3
"""How often that density is found again, until it changes by less than this part."""


@dataclass(frozen=True, eq=False)
class Balanced:
    """Readings of a stretch with the balances that they should close; `actuator` is the place of theirs."""

    actuator: int
    balance: VolumeBalance
    readings: Readings


@dataclass(frozen=True, eq=False)
class Linear:
    """The balances of one stretch at corrected readings.

    Attributes:
        missed: (I, c) misclosures of the raw readings [m³], linear from the corrected ones.
        at: misclosures at the corrected readings, with their derivatives.
        correction: (N, 5) of the readings.
        residuals, slope: (I·c,), (I·c, p + g) independent residuals of unit variance, and their derivatives.
        by_delay: (I·c,) their derivatives by the delay of the commands [1/s].
    """

    missed: Array
    at: Misclosure
    correction: Array
    residuals: Array
    slope: Array
    by_delay: Array

    def covariance(self, readings: Readings, density: float) -> Array:
        """Lower band (2c, I·c) of the covariance of what is missed [m⁶].

        `density` [m³/√s] is the standard deviation of the random flow, integrated over a second.
        """
        first, last, (count, c) = self.at.by_first, self.at.by_last, self.missed.shape
        before, after = readings.variance[readings.begin : -1, None], readings.variance[readings.begin + 1 :, None]
        own = (first * before) @ first.swapaxes(1, 2) + (last * after) @ last.swapaxes(1, 2)
        own[:, range(c), range(c)] += density**2 * readings.dt[readings.begin :, None]
        next_one = (first[1:] * before[1:]) @ last[:-1].swapaxes(1, 2)
        band = np.zeros((2 * c, count * c))
        for i in range(c):
            for k in range(c):
                band[c + i - k, k : (count - 1) * c : c] = next_one[:, i, k]
                if i >= k:
                    band[i - k, k::c] = own[:, i, k]
        return band


@dataclass(frozen=True, eq=False)
class Adjustment(BoundedGaussian):
    """The most probable numbers, of which `data` is the information with the geometry being unknown but for its prior.

    Attributes:
        density: (a,) of the random flow of each actuator [m³/√s].
        misfit: (a,) RMS of each actuator's residuals, in units of the sensors' errors alone; NaN without readings.
        correction: for each stretch (N, 5) corrections of its readings.
        later: (a, 2) by how much later than stated each actuator's commands seem to arrive where the delay is not
            identified, and the standard deviation [s], all identified numbers being free; NaN where nothing tells.
    """

    density: Array
    misfit: Array
    correction: tuple[Array, ...]
    later: Array


@dataclass(frozen=True, eq=False)
class _State:
    """Numbers x (p + g,): of what is identified in standard scores from nominal, then of the geometry; and all rows.

    Corrections of readings follow from them, see `_Solver.corrected`.
    """

    solver: _Solver
    x: Array
    linear: list[Linear]
    residuals: Array
    slope: Array

    @property
    def cost(self) -> float:
        return float(self.residuals @ self.residuals)

    def step(self, damping: float) -> Step:
        return bounded_step(np.column_stack([self.slope, self.residuals]), damping, self.solver.lower - self.x,
                            self.solver.upper - self.x)

    def after(self, change: Array) -> _State:
        return self.solver.at(self.x + change, [each.correction for each in self.linear])

    def corrected(self) -> _State:
        return self


class _Solver:
    """All stretches with one set of densities."""

    def __init__(self, stretches: Sequence[Balanced], parameters: ParameterSet, density: Array) -> None:
        self.stretches, self.parameters, self.density = stretches, parameters, density
        self.p, self.g = len(parameters), stretches[0].readings.lever.shape[1]
        values, vectors = np.linalg.eigh(parameters.information * np.outer(parameters.scale, parameters.scale))
        self.prior = np.zeros((self.p + self.g,) * 2)
        self.prior[: self.p, : self.p] = np.sqrt(np.maximum(values, 0))[:, None] * vectors.T
        self.prior[self.p :, self.p :] = np.eye(self.g)
        self.lower = np.append((parameters.lower - parameters.nominal) / parameters.scale, np.full(self.g, -np.inf))
        self.upper = np.append((parameters.upper - parameters.nominal) / parameters.scale, np.full(self.g, np.inf))

    def theta(self, x: Array) -> Array:
        """(p,) within their bounds, but for rounding."""
        known = self.parameters
        return np.clip(known.nominal + known.scale * x[: self.p], known.lower, known.upper)

    def at(self, x: Array, corrections: Sequence[Array]) -> _State:
        """All rows at x, with readings corrected anew from `corrections` nearby."""
        linear = [self.corrected(each, x, near) for each, near in zip(self.stretches, corrections, strict=True)]
        return _State(self, x, linear, np.concatenate([self.prior @ x, *(each.residuals for each in linear)]),
                      np.vstack([self.prior, *(each.slope for each in linear)]))

    def corrected(self, each: Balanced, x: Array, near: Array) -> Linear:
        """The balances of a stretch around the corrections that close them best, sought from those nearby."""
        std = np.sqrt(np.where(each.readings.variance > 0, each.readings.variance, np.inf))
        for _ in range(CORRECTIONS):
            found = self.linear(each, x, near)
            if np.max(np.abs(found.correction - near) / std) < SMALL:
                break
            near = found.correction
        return found

    def linear(self, each: Balanced, x: Array, correction: Array) -> Linear:
        """The balances of a stretch around corrected readings, and the corrections that follow."""
        readings, begin = each.readings, each.readings.begin
        values = readings.values + correction
        values[:, 0] += readings.lever @ x[self.p :]
        at = each.balance.misclosure(readings, values, self.theta(x))
        missed = at.value - np.einsum("nic,nc->ni", at.by_first, correction[begin:-1]) - np.einsum(
            "nic,nc->ni", at.by_last, correction[begin + 1 :])
        found = Linear(missed, at, correction, np.zeros(0), np.zeros(0), np.zeros(0))
        factor = cholesky_banded(found.covariance(readings, self.density[each.actuator]), lower=True)
        slope = np.concatenate([at.by_theta * self.parameters.scale,
                                at.by_first[:, :, :1] * readings.lever[begin:-1, None]
                                + at.by_last[:, :, :1] * readings.lever[begin + 1 :, None]], axis=2)
        both = solve_banded((len(factor) - 1, 0), factor, np.column_stack([
            missed.ravel(), slope.reshape(missed.size, -1), at.by_delay.ravel()]))
        force = cho_solve_banded((factor, True), missed.ravel()).reshape(missed.shape)
        new = np.zeros_like(correction)
        new[begin:-1] -= np.einsum("nic,ni->nc", at.by_first, force)
        new[begin + 1 :] -= np.einsum("nic,ni->nc", at.by_last, force)
        return replace(found, correction=new * readings.variance, residuals=both[:, 0], slope=both[:, 1:-1],
                       by_delay=both[:, -1])

    def solve(self, x: Array, corrections: Sequence[Array]) -> _State:
        """The least squares from x on.

        Raises:
            SolverError: the steps do not converge.
        """
        found = minimise(self.at(x, corrections), tolerance=CONVERGED, steps=STEPS)
        if not (found.converged or found.stuck):  # a corner of the model is a minimum, too
            raise SolverError(f"the squares still fall after {STEPS} steps", where="identification of valves and oil",
                              remedy="correct numbers of the machine file that are far off")
        return found.place

    def least(self, linear: Sequence[Linear]) -> Array:
        """(a,) densities of a random flow that is next to none."""
        density = self.density.copy()
        for each, one in zip(self.stretches, linear, strict=True):
            density[each.actuator] = _limits(each.readings, one)[0]
        return density

    def likeliest(self, linear: Sequence[Linear]) -> Array:
        """(a,) the density of each actuator's random flow with the greatest likelihood, at given corrections."""
        density = self.density.copy()
        for k in {each.actuator for each in self.stretches}:
            own = [(each.readings, one) for each, one in zip(self.stretches, linear, strict=True) if each.actuator == k]
            low, high = _limits(*own[0])

            def surprise(log_density: float, own: list[tuple[Readings, Linear]] = own) -> float:
                return sum(_surprise(readings, one, np.exp(log_density)) for readings, one in own)

            density[k] = np.exp(minimize_scalar(surprise, bounds=(np.log(low), np.log(high)), method="bounded",
                                                options={"xatol": AGREED / 3}).x)
        return density

    def squares(self, linear: Sequence[Linear]) -> list[float]:
        """Of what each stretch misses, in units of its sensors' errors alone."""
        found = []
        for each, one in zip(self.stretches, linear, strict=True):
            factor = cholesky_banded(one.covariance(each.readings, 0.0), lower=True)
            found.append(float(np.sum(solve_banded((len(factor) - 1, 0), factor, one.missed.ravel()) ** 2)))
        return found


def adjust(stretches: Sequence[Balanced], parameters: ParameterSet, actuators: int) -> Adjustment:
    """The most probable numbers, from the nominal ones, by the one of two ways that misses less.

    From next to no random flow, and from the one that the nominal numbers leave: a large one lets wrong numbers stand.

    Args:
        stretches: the readings of all actuators and logs.
        parameters: what is identified, with its prior and bounds.
        actuators: number of actuators.

    Raises:
        SolverError: the steps do not converge.
    """
    solver = _Solver(stretches, parameters, np.zeros(actuators))
    start: Array = np.zeros(solver.p + solver.g)
    raw = [solver.linear(each, start, np.zeros_like(each.readings.values)) for each in stretches]
    found, failure = [], None
    for density in (solver.least(raw), solver.likeliest(raw)):
        try:
            found.append(_with_likeliest_density(stretches, parameters, density))
        except SolverError as error:
            failure = error
    if failure and not found:
        raise failure
    return _answer(*min(found, key=lambda each: sum(each[0].squares(each[1].linear))))


def _with_likeliest_density(stretches: Sequence[Balanced], parameters: ParameterSet,
                            density: Array) -> tuple[_Solver, _State]:
    """Numbers and densities in turn, until the densities stay."""
    solver = _Solver(stretches, parameters, density)
    x, corrections = np.zeros(solver.p + solver.g), [np.zeros_like(each.readings.values) for each in stretches]
    if late := [k for each in stretches for k in each.balance.late]:
        # far from the solution, a delay and a spool that oscillates imitate each other
        free = solver.lower.copy(), solver.upper.copy()
        solver.lower[late] = solver.upper[late] = 0.0
        near = solver.solve(x, corrections)
        (solver.lower, solver.upper), x, corrections = free, near.x, [each.correction for each in near.linear]
    here = solver.solve(x, corrections)
    for _ in range(ROUNDS):
        density = solver.likeliest(here.linear)
        if np.all(np.abs(density - solver.density) <= AGREED * density):
            break
        solver = _Solver(stretches, parameters, density)
        here = solver.solve(here.x, [each.correction for each in here.linear])
    return solver, here


def _limits(readings: Readings, linear: Linear) -> tuple[float, float]:
    error = float(np.sqrt(np.median(linear.covariance(readings, 0.0)[0])))
    return LEAST * error / np.sqrt(np.sum(readings.dt)), MOST * error / np.sqrt(float(np.median(readings.dt)))


def _surprise(readings: Readings, linear: Linear, density: float) -> float:
    """Twice the negative logarithm of the likelihood of what is missed, but for a constant."""
    factor = cholesky_banded(linear.covariance(readings, density), lower=True)
    independent = solve_banded((len(factor) - 1, 0), factor, linear.missed.ravel())
    return float(independent @ independent + 2 * np.sum(np.log(factor[0])))


def _answer(solver: _Solver, here: _State) -> Adjustment:
    p, g, scale = solver.p, solver.g, solver.parameters.scale
    prior = p + g
    # the geometry's columns come first, so that the triangle's last rows are what is left without them
    rows = np.vstack([solver.prior[p:], here.slope[prior:]])
    triangle = np.asarray(np.linalg.qr(np.column_stack([rows[:, p:], rows[:, :p]]), mode="r"))[g:, g:]
    readings = here.residuals[prior:]
    freedom = len(readings) - np.linalg.matrix_rank(here.slope[prior:])
    actuators = [each.actuator for each in solver.stretches]
    count = np.bincount(actuators, [each.readings.balances for each in solver.stretches], len(solver.density))
    total = np.bincount(actuators, solver.squares(here.linear), len(solver.density))
    return Adjustment(
        solver.parameters, solver.theta(here.x), triangle.T @ triangle / np.outer(scale, scale),
        (here.slope.T @ here.residuals)[:p] / scale,
        float(np.sqrt(readings @ readings / freedom)) if freedom > 0 else float("nan"), solver.density,
        np.sqrt(total / np.where(count > 0, count, np.nan)), tuple(each.correction for each in here.linear),
        _later(solver, here))


def _later(solver: _Solver, here: _State) -> Array:
    """`Adjustment.later`: one step of each delay beside all identified numbers."""
    found = np.full((len(solver.density), 2), np.nan)
    values, vectors = np.linalg.eigh(here.slope.T @ here.slope)
    known = values > INFORMED * values[-1]
    root = vectors[:, known] / np.sqrt(values[known])
    for k in {each.actuator for each in solver.stretches if not each.balance.late}:
        by = np.concatenate([np.zeros(len(solver.prior)), *(
            one.by_delay * (each.actuator == k) for each, one in zip(solver.stretches, here.linear, strict=True))])
        shared = root.T @ (here.slope.T @ by)
        left = by - here.slope @ (root @ shared)
        if (information := left @ left) > INFORMED * (by @ by) > 0:
            found[k] = -(left @ here.residuals) / information, 1 / np.sqrt(information)
    return found


def nonlinear_program(stretches: Sequence[Balanced], parameters: ParameterSet) -> NonlinearProgram:
    """The least corrections of readings, in units of their σ, that close all balances.

    Variables are the parameters, from their nominal values in units of their scales, and the corrections. Balances are
    in units of what one sample's errors leave in them.
    """
    wrong = [each.readings.variance > 0 for each in stretches]
    sizes = [len(parameters), *(int(np.sum(where)) for where in wrong)]
    x = ca.MX.sym("x", sum(sizes))
    z, *corrections = ca.vertsplit(x, np.cumsum([0, *sizes]).tolist())
    theta = ca.DM(parameters.nominal) + ca.DM(parameters.scale) * z
    constraints, names, terms = [], [], []
    x_names = list(parameters.names)
    x_units = [f"{scale:.6g} {unit} from {nominal:.6g}" for scale, unit, nominal in zip(
        parameters.scale, parameters.units, parameters.nominal, strict=True)]
    for number, (each, where, correction) in enumerate(zip(stretches, wrong, corrections, strict=True), 1):
        readings, owner = each.readings, each.balance.owner
        at = np.argwhere(where.T)
        std = np.sqrt(readings.variance.T[where.T])
        moved = ca.MX(ca.DM(readings.values.T))
        moved[(at[:, 0] + at[:, 1] * len(QUANTITIES)).tolist()] += ca.DM(std) * correction
        missed = each.balance.symbolic(readings, moved, theta)[list(readings.chambers), readings.begin :]
        first = each.balance.misclosure(readings, readings.values, parameters.nominal)
        variance = (np.sum(first.by_first**2 * readings.variance[readings.begin : -1, None], axis=2)
                    + np.sum(first.by_last**2 * readings.variance[readings.begin + 1 :, None], axis=2))
        constraints.append(ca.vec(missed / ca.DM(np.sqrt(variance).T)))
        names += [f"volume balance of {owner}"] * (missed.numel())
        x_names += [f"{owner}: {QUANTITIES[k]}, stretch {number}, {readings.t[sample]:.6g} s" for k, sample in at]
        x_units += [f"{each:.4g}" for each in std]
        terms.append(f"half the sum of squares of {len(std)} corrections of readings of {owner}")
    values, vectors = np.linalg.eigh(parameters.information * np.outer(parameters.scale, parameters.scale))
    prior = np.sqrt(np.maximum(values, 0))[:, None] * vectors.T @ z
    g, free = ca.vertcat(*constraints), np.full(sum(sizes[1:]), np.inf)
    return NonlinearProgram(
        x=x, f=(ca.sumsqr(prior) + ca.sumsqr(x[sizes[0] :])) / 2, x_names=tuple(x_names), x_units=tuple(x_units),
        x0=np.zeros(sum(sizes)), lbx=np.append((parameters.lower - parameters.nominal) / parameters.scale, -free),
        ubx=np.append((parameters.upper - parameters.nominal) / parameters.scale, free), g=g, g_names=tuple(names),
        lbg=np.zeros(g.numel()), ubg=np.zeros(g.numel()), p=ca.MX.sym("p", 0), objective=(
            *terms, "half the sum of squares of the residuals of the parameters' priors"))
