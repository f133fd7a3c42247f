"""Records' dynamics by collocation: motions that fulfil them, and residuals as they follow from θ and first states.

Within each interval states are polynomials that fulfil ẋ = f(x, u, θ) at three Radau points (Biegler 2010, Section
10.2): of order 5, and stable however stiff the dynamics are, as those of small chambers of oil. Newton's method solves
one interval after the other. A linear system of each takes changes of its first state and of θ to its end, so that no
state remains unknown but each record's first (condensing, Bock 1987).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import casadi as ca
import numpy as np

from hydroopt.errors import SolverError
from hydroopt.estimation.hydraulic.dynamics import POINTS, WIDEST, Record, ShootingProblem
from hydroopt.kernels.native import kernel
from hydroopt.spatial.inertia import Array

FACTORS = np.asarray(ca.collocation_coeff(ca.collocation_points(POINTS, "radau"))[0])
"""(POINTS + 1, POINTS) derivative at the points of the polynomial through an interval's beginning and its points."""
EXACT, NEARLY = 1e-10, 1e-7
"""Defect, in units of the states' scales, below which an interval is solved; and below which one is, where rounding
keeps steps from making it smaller."""
NEWTON, HALVINGS = 60, 8
"""Steps that an interval gets, and how often one is halved."""
SLOW = 0.2
"""Ratio of defects after and before a step from which on derivatives are evaluated anew."""
CHUNK = 256
"""Intervals whose derivatives are held at a time."""
MANY = 2000
"""Points of all records from which on functions are compiled."""
ARGUMENTS, RESULTS = ["x", "z", "data"], ["value", "by_state", "by_z"]


@dataclass(frozen=True, eq=False)
class Condensed:
    """A record's residuals, linear in the changes of its first state and of z.

    Attributes:
        rows: (m,) of its readings, in units of σ.
        jacobian: (m, nx + p) by its first state, then by z.
        first, slope: residuals of the prior of its first state, and their derivative by this state.
    """

    rows: Array
    jacobian: Array
    first: Array
    slope: Array

    @cached_property
    def triangle(self) -> Array:
        """R of the QR decomposition of derivatives and residuals: all that a step needs."""
        prior = np.zeros((len(self.slope), self.jacobian.shape[1] + 1))
        prior[:, : self.slope.shape[1]], prior[:, -1] = self.slope, self.first
        both = np.vstack([np.column_stack([self.jacobian, self.rows]), prior])
        return np.asarray(np.linalg.qr(both, mode="r"))


class Collocation:
    """The collocated dynamics of a problem's records.

    States are in units of their scales; θ counts from its nominal value in units of its scale, as z.
    """

    def __init__(self, problem: ShootingProblem, functions: tuple[_Sloped, _Sloped] | None = None) -> None:
        self.problem = problem
        self.nx, self.p = len(problem.dynamics.states), len(problem.parameters)
        self.stage, self.reading = functions or _functions(problem)
        self.inputs = [np.column_stack([r.inputs(problem.dynamics.held), np.repeat(np.diff(r.edges), POINTS)])
                       for r in problem.records]
        self.present = [np.isfinite(r.y) for r in problem.records]
        self.readings = [np.where(here, r.y, 0.0) / problem.sigma
                         for here, r in zip(self.present, problem.records, strict=True)]
        parameters = problem.parameters
        values, vectors = np.linalg.eigh(parameters.information * np.outer(parameters.scale, parameters.scale))
        informed = values > 1e-14 * max(float(values.max(initial=0.0)), 1e-300)
        self.prior: Array = np.sqrt(values[informed])[:, None] * vectors[:, informed].T
        """Rows whose product with z are the residuals of θ's prior."""

    def of(self, records: Sequence[Record]) -> Collocation:
        """The same dynamics on other records, by the same functions."""
        return Collocation(replace(self.problem, records=tuple(records)), (self.stage, self.reading))

    def cost(self, z: Array, points: Sequence[Array]) -> float:
        """Half the sum of squares of all residuals, of readings and of priors."""
        rows = [self.prior @ z]
        for k, (record, states) in enumerate(zip(self.problem.records, points, strict=True)):
            values = self.reading.value(states[:: POINTS * record.steps], z, record.u)
            rows += [(values - self.readings[k])[self.present[k]], self._first(k, states)[0]]
        return float(sum(part @ part for part in rows)) / 2

    def condensed(self, z: Array, points: Sequence[Array]) -> tuple[Condensed, ...]:
        """Each record's residuals around states (K, nx) that fulfil the dynamics."""
        return tuple(self._condensed(k, z, states) for k, states in enumerate(points))

    def run(self, z: Array, first: Sequence[Array], near: Sequence[Array]) -> tuple[Array, ...]:
        """States (K, nx) of each record that fulfil the dynamics, from first states (nx,) on, near a guess (K, nx).

        Raises:
            SolverError: an interval has no solution near the guess.
        """
        found = [np.vstack([begin, guess[1:]]) for begin, guess in zip(first, near, strict=True)]
        for at in range(0, max(map(len, found)) - 1, POINTS):
            inner = slice(at + 1, at + POINTS + 1)
            going = [k for k, states in enumerate(found) if len(states) > at + 1]
            begin = np.array([found[k][at] for k in going])
            guess = begin[:, None] + np.array([near[k][inner] - near[k][at] for k in going])
            solved = self._solved(z, begin, guess, np.array([self.inputs[k][at : at + POINTS] for k in going]))
            for k, states in zip(going, solved, strict=True):
                if not np.all(np.isfinite(states)):
                    raise SolverError("the simulation did not converge", where=self.problem.records[k].name,
                                      remedy="start from other parameters and states")
                found[k][inner] = states
        return tuple(found)

    def _first(self, k: int, states: Array) -> tuple[Array, Array]:
        """Residuals of the prior of the k-th record's first state, and their derivative by this state."""
        record, scale = self.problem.records[k], self.problem.dynamics.scale
        sigma = (WIDEST * scale if record.initial_sigma is None else record.initial_sigma) / scale
        which = np.flatnonzero(np.isfinite(sigma))
        slope = np.zeros((len(which), self.nx))
        slope[np.arange(len(which)), which] = 1 / sigma[which]
        return (states[0] - record.guess[0] / scale)[which] / sigma[which], slope

    def _condensed(self, k: int, z: Array, states: Array) -> Condensed:
        record, data, long = self.problem.records[k], self.inputs[k], POINTS * CHUNK
        nodes = [np.eye(self.nx, self.nx + self.p)]
        for at in range(0, len(data), long):
            for end in self._ends(z, states[at : at + long + 1], data[at : at + long]):
                nodes.append(end[:, : self.nx] @ nodes[-1])
                nodes[-1][:, self.nx :] += end[:, self.nx :]
        value, by_x, by_z = self.reading.slopes(states[:: POINTS * record.steps], z, record.u)
        change = by_x @ np.array(nodes[:: record.steps])
        change[:, :, self.nx :] += by_z
        here = self.present[k]
        return Condensed((value - self.readings[k])[here], change[here], *self._first(k, states))

    def _ends(self, z: Array, states: Array, data: Array) -> Array:
        """(E, nx, nx + p) how the ends of intervals follow from their first states and from z."""
        nx, count, diagonal = self.nx, len(data) // POINTS, np.arange(self.nx)
        _, by_x, by_z = self.stage.slopes(states[1:], z, data)
        right = np.zeros((count, POINTS, nx, nx + self.p))
        right[:, :, diagonal, diagonal] = -FACTORS[0][:, None]
        right[..., nx:] = by_z.reshape(count, POINTS, nx, self.p)
        return np.asarray(np.linalg.solve(self._newton(by_x), right.reshape(count, POINTS * nx, -1))[:, -nx:])

    def _solved(self, z: Array, begin: Array, guess: Array, data: Array) -> Array:
        """States (E, POINTS, nx) of intervals from their first states (E, nx) on; NaN where Newton's method fails."""
        states = guess.copy()
        missed = self._missed(z, begin, states, data)
        matrix = np.zeros((len(states), POINTS * self.nx, POINTS * self.nx))
        stale, again = np.ones((2, len(states)), dtype=bool)
        for _ in range(NEWTON):
            size = _largest(missed)
            left = np.flatnonzero(~(size < EXACT))
            if not left.size:
                break
            fresh = left[stale[left]]
            if fresh.size:
                matrix[fresh] = self._newton(self.stage.slopes(_flat(states[fresh]), z, _flat(data[fresh]))[1])
            step = _solve(matrix[left], missed[left])
            for part in 0.5 ** np.arange(HALVINGS):
                tried = states[left] - part * step
                new = self._missed(z, begin[left], tried, data[left])
                better = _largest(new) < (1 - part / 10) * size[left]
                taken = left[better]
                states[taken], missed[taken] = tried[better], new[better]
                stale[taken] = _largest(new[better]) > SLOW * size[taken]
                left, step = left[~better], step[~better]
                if not left.size:
                    break
            for k in left:  # where no step makes the defect smaller
                if not stale[k]:
                    stale[k] = True
                elif size[k] < NEARLY:
                    missed[k] = 0.0
                elif again[k]:
                    again[k], states[k] = False, begin[k]
                    missed[k] = self._missed(z, begin[[k]], states[[k]], data[[k]])[0]
                else:
                    states[k], missed[k] = np.nan, 0.0
        states[~(_largest(missed) < EXACT)] = np.nan
        return states

    def _missed(self, z: Array, begin: Array, states: Array, data: Array) -> Array:
        """Defects (E, POINTS, nx) of intervals: by how much the polynomials miss the dynamics."""
        rates = self.stage.value(_flat(states), z, _flat(data))
        return np.asarray(FACTORS[0][:, None] * begin[:, None] + np.einsum("ij,eik->ejk", FACTORS[1:], states)
                          - rates.reshape(states.shape))

    def _newton(self, by_x: Array) -> Array:
        """(E, POINTS·nx, POINTS·nx) derivative of intervals' defects by their points, from (E·POINTS, nx, nx)."""
        nx, diagonal = self.nx, np.arange(self.nx)
        left = np.zeros((len(by_x) // POINTS, POINTS, nx, POINTS, nx))
        left[:, :, diagonal, :, diagonal] = FACTORS[1:].T
        for j in range(POINTS):
            left[:, j, :, j] -= by_x[j::POINTS]
        return left.reshape(-1, POINTS * nx, POINTS * nx)


def _functions(problem: ShootingProblem) -> tuple[_Sloped, _Sloped]:
    """Rates times an interval, in units of the states' scales; and outputs in units of σ."""
    dynamics, parameters = problem.dynamics, problem.parameters
    state, z = ca.SX.sym("x", len(dynamics.states)), ca.SX.sym("z", len(parameters))
    u, span, scale = ca.SX.sym("u", len(dynamics.inputs)), ca.SX.sym("span"), ca.DM(dynamics.scale)
    theta = ca.DM(parameters.nominal) + ca.DM(parameters.scale) * z
    points = sum(len(record.time) for record in problem.records)
    rates = dynamics.rates(state * scale, u, theta) * span / scale
    outputs = dynamics.outputs(state * scale, u, theta) / ca.DM(problem.sigma)
    return _Sloped(rates, state, z, ca.vertcat(u, span), points), _Sloped(outputs, state, z, u, points)


class _Sloped:
    """A function of a state, z and data at many points: its values and derivatives, which are sparse."""

    def __init__(self, value: ca.SX, state: ca.SX, z: ca.SX, data: ca.SX, points: int) -> None:
        slopes = [ca.jacobian(value, by) for by in (state, z)]
        self.places = [np.array(slope.sparsity().get_triplet(), dtype=np.intp) for slope in slopes]
        self.shapes = [slope.shape for slope in slopes]
        given = [state, z, data]
        found = [ca.densify(value), *(ca.densify(ca.vertcat(ca.SX(0, 1), *slope.nonzeros())) for slope in slopes)]
        self._value = _at_points(ca.Function("value", given, found[:1], ARGUMENTS, RESULTS[:1]), points)
        self._slopes = _at_points(ca.Function("slopes", given, found, ARGUMENTS, RESULTS), points)

    def value(self, states: Array, z: Array, data: Array) -> Array:
        """(N, rows)."""
        return self._value(states, z, data)[0]

    def slopes(self, states: Array, z: Array, data: Array) -> tuple[Array, Array, Array]:
        """Values (N, rows), and their derivatives by the state (N, rows, nx) and by z (N, rows, p)."""
        value, *entries = self._slopes(states, z, data)
        dense = []
        for (row, column), shape, part in zip(self.places, self.shapes, entries, strict=True):
            made = np.zeros((len(states), *shape))
            made[:, row, column] = part
            dense.append(made)
        return value, dense[0], dense[1]


def _at_points(function: ca.Function, points: int) -> Callable[[Array, Array, Array], list[Array]]:
    """A function's vectors (N, ·) at N states, at one z and at N data; compiled if there are many points in all."""
    compiled = kernel(function) if points > MANY else None

    def evaluated(states: Array, z: Array, data: Array) -> list[Array]:
        columns = [np.ascontiguousarray(values) for values in (states, z, data)]
        if compiled:
            return [values.reshape(len(states), -1) for values in compiled(columns, len(states))]
        found = function.map(len(states)).call([columns[0].T, z, columns[2].T])
        return [np.asarray(values).T for values in found]

    return evaluated


def _flat(values: Array) -> Array:
    """(E·POINTS, k) of (E, POINTS, k)."""
    return values.reshape(-1, values.shape[-1])


def _largest(missed: Array) -> Array:
    """(E,) largest defect of each interval; infinite where one is no number."""
    size = np.abs(missed).max(axis=(1, 2))
    return np.where(np.isfinite(size), size, np.inf)


def _solve(matrices: Array, right: Array) -> Array:
    """Solutions (E, POINTS, nx); NaN where a matrix has no inverse."""
    found = np.full(right.shape, np.nan)
    good = np.all(np.isfinite(matrices), axis=(1, 2)) & np.all(np.isfinite(right), axis=(1, 2))
    try:
        found[good] = np.linalg.solve(matrices[good], right[good].reshape(int(good.sum()), -1, 1)).reshape(
            -1, *right.shape[1:])
    except np.linalg.LinAlgError:  # one of them: each by itself
        for k in np.flatnonzero(good):
            found[k] = np.linalg.lstsq(matrices[k], right[k].ravel(), rcond=None)[0].reshape(right[k].shape)
    return found
