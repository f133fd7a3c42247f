"""Records and dynamics as one sparse nonlinear program, with the states at all points among the unknowns.

Within each interval states are polynomials that fulfil ẋ = f(x, u, θ) at three Radau points (Biegler 2010, Section
10.2): of order 5, and stable however stiff the dynamics are, as those of small chambers of oil. All derivatives are
those of two small functions, mapped over the points and gathered.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.sparse.linalg import splu

from hydroopt.estimation.hydraulic.dynamics import POINTS, WIDEST, ShootingProblem
from hydroopt.estimation.inference.program import NonlinearProgram
from hydroopt.spatial.inertia import Array


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


@dataclass(frozen=True, eq=False)
class Expressions:
    """Of the unknowns x: defects, which must vanish, residual rows, whose squares are minimised, and derivatives.

    `curvature` is the second derivative of Σ multipliers·defects + weight·Σ rows²/2, without that of the squares.
    """

    defects: ca.MX
    defects_by_x: ca.MX
    rows: ca.MX
    rows_by_x: ca.MX
    curvature: ca.MX


class Program:
    """x = (θ, states at all points of all records), in units of their scales and θ from its nominal value."""

    def __init__(self, problem: ShootingProblem) -> None:
        self.problem = problem
        records, held = problem.records, problem.dynamics.held
        self.p, self.nx, self.ny = len(problem.parameters), problem.dynamics.scale.size, len(problem.sigma)
        counts = [len(record.time) for record in records]
        self.first = np.concatenate([[0], np.cumsum(counts)])
        self.size = self.p + self.nx * int(self.first[-1])
        self.stages = np.setdiff1d(np.arange(self.first[-1]), self.first[:-1])
        self.samples = np.concatenate([k + np.arange(len(r.t)) * POINTS * r.steps
                                       for k, r in zip(self.first, records, strict=False)])
        self.defects = self.nx * len(self.stages)
        self.span = np.concatenate([np.repeat(np.diff(r.edges), POINTS) for r in records])
        self.stage_inputs = np.concatenate([r.inputs(held) for r in records])
        self.sample_inputs = np.concatenate([r.u for r in records])
        self.readings = np.concatenate([r.y for r in records])
        self.present = np.flatnonzero(np.isfinite(self.readings).ravel())
        self.derivative = _matrix(*self._derivative(), (self.defects, self.size))
        self.prior, self.prior_right, self.priors = self._priors()
        self.stage, self.reading = self._functions()

    def _derivative(self) -> tuple[Array, NDArray[np.intp], NDArray[np.intp]]:
        """Interval times ẋ at the points, of the polynomials through each interval's points, as triplets."""
        factor = np.asarray(ca.collocation_coeff(ca.collocation_points(POINTS, "radau"))[0])  # (POINTS + 1, POINTS)
        interval = np.repeat(self.stages.reshape(-1, POINTS)[:, :1] - 1, POINTS * (POINTS + 1) * self.nx, axis=1)
        power, j, i = (k.ravel() for k in np.meshgrid(np.arange(POINTS + 1), np.arange(POINTS), np.arange(self.nx),
                                                  indexing="ij"))
        row = (np.arange(len(interval))[:, None] * POINTS + j) * self.nx + i
        column = self.p + (interval + power) * self.nx + i
        return np.tile(factor[power, j], len(interval)), row.ravel(), column.ravel()

    def _priors(self) -> tuple[ca.DM, Array, int]:
        """Rows A and right side b of the priors' residuals A·x − b: of θ (how many), then of first states."""
        parameters, dynamics = self.problem.parameters, self.problem.dynamics
        values, vectors = np.linalg.eigh(parameters.information * np.outer(parameters.scale, parameters.scale))
        informed = values > 1e-14 * max(float(values.max(initial=0.0)), 1e-300)
        root = (np.sqrt(values[informed])[:, None] * vectors[:, informed].T)
        row, column = (k.ravel() for k in np.indices(root.shape))
        value, right = root.ravel(), [np.zeros(len(root))]
        for k, record in zip(self.first, self.problem.records, strict=False):
            sigma = WIDEST * dynamics.scale if record.initial_sigma is None else record.initial_sigma
            which = np.flatnonzero(np.isfinite(sigma))
            unit = dynamics.scale[which] / sigma[which]
            row = np.concatenate([row, sum(map(len, right)) + np.arange(len(which))])
            column, value = np.concatenate([column, self.p + k * self.nx + which]), np.concatenate([value, unit])
            right.append(record.guess[0, which] / sigma[which])
        total = sum(map(len, right))
        return _matrix(value, row, column, (total, self.size)), np.concatenate(right), len(root)

    def _functions(self) -> tuple[_Mapped, _Mapped]:
        """Interval times rates, in units of the states' scales; and outputs in units of σ."""
        dynamics, parameters = self.problem.dynamics, self.problem.parameters
        state, z = ca.SX.sym("x", self.nx), ca.SX.sym("z", self.p)
        u, span = ca.SX.sym("u", len(dynamics.inputs)), ca.SX.sym("span")
        x, theta = state * ca.DM(dynamics.scale), ca.DM(parameters.nominal) + ca.DM(parameters.scale) * z
        f = dynamics.rates(x, u, theta) * span / ca.DM(dynamics.scale)
        h = dynamics.outputs(x, u, theta) / ca.DM(self.problem.sigma)
        stages = _Mapped(f, state, z, ca.vertcat(u, span), np.column_stack([self.stage_inputs, self.span]), self.stages)
        return stages, _Mapped(h, state, z, u, self.sample_inputs, self.samples)

    def expressions(self, x: ca.MX, weight: ca.MX, multipliers: ca.MX) -> Expressions:
        """Constraints, residuals and derivatives that IPOPT needs."""
        z, states = x[: self.p], ca.reshape(x[self.p :], self.nx, int(self.first[-1]))
        rates, rates_by_x = self.stage.evaluate(states, z)
        outputs, outputs_by_x = self.reading.evaluate(states, z)
        index, sigma = self.present.tolist(), np.tile(self.problem.sigma, len(self.readings))
        pick = _matrix(np.ones(len(index)), np.arange(len(index)), self.present, (len(index), len(sigma)))
        right = ca.DM(self.readings.ravel()[self.present] / sigma[self.present])
        left = pick @ outputs - right
        curvature = (weight * self.reading.curvature(states, z, pick.T @ left)
                     - self.stage.curvature(states, z, multipliers))
        return Expressions(
            self.derivative @ x - rates, self.derivative - rates_by_x,
            ca.vertcat(left, self.prior @ x - ca.DM(self.prior_right)),
            ca.vertcat(pick @ outputs_by_x, ca.MX(self.prior)), curvature)

    def initial_guess(self, theta: Array, points: Sequence[Array]) -> Array:
        """x of parameters (p,) and, record by record, states (K, nx) at all points."""
        parameters = self.problem.parameters
        return np.concatenate([(theta - parameters.nominal) / parameters.scale,
                               (np.vstack(points) / self.problem.dynamics.scale).ravel()])

    def nlp(self, theta: Array, points: Sequence[Array]) -> NonlinearProgram:
        """The nonlinear program, with an initial guess of parameters (p,) and states (K, nx) of each record."""
        parameters, dynamics, records = self.problem.parameters, self.problem.dynamics, self.problem.records
        x = ca.MX.sym("x", self.size)
        here = self.expressions(x, ca.MX(0), ca.MX.zeros(self.defects))
        free, zero = np.full(self.size - self.p, np.inf), np.zeros(self.defects)
        names = [*parameters.names, *(f"{state}, record {k + 1}, {t:.6g} s" for k, record in enumerate(records)
                                      for t in record.time for state in dynamics.states)]
        units = [f"{scale:.6g} {unit} from {nominal:.6g}" for scale, unit, nominal in zip(
            parameters.scale, parameters.units, parameters.nominal, strict=True)]
        units += [f"{scale:g}" for scale in dynamics.scale] * int(self.first[-1])
        counts = np.sum(np.isfinite(self.readings), axis=0)
        terms = [f"half the sum of squares of {count} residuals of {channel}, sigma {sigma:.4g}"
                 for channel, count, sigma in zip(dynamics.channels, counts, self.problem.sigma, strict=True)]
        return NonlinearProgram(
            x=x, f=ca.sumsqr(here.rows) / 2, x_names=tuple(names), x_units=tuple(units),
            x0=self.initial_guess(theta, points),
            lbx=np.concatenate([(parameters.lower - parameters.nominal) / parameters.scale, -free]),
            ubx=np.concatenate([(parameters.upper - parameters.nominal) / parameters.scale, free]),
            g=here.defects, g_names=tuple(f"dynamics of {state}" for state in dynamics.states) * len(self.stages),
            lbg=zero, ubg=zero, p=ca.MX.sym("p", 0), objective=(
                *terms, f"half the sum of squares of {self.priors} residuals of the parameters' priors",
                f"half the sum of squares of {self.prior.size1() - self.priors} residuals of the first states' priors"))

    def linearised(self, x: Array) -> Linearised:
        """The residual rows at a solution as they change along the dynamics."""
        parameters, symbol = self.problem.parameters, ca.MX.sym("x", self.size)
        here = self.expressions(symbol, ca.MX(0), ca.MX.zeros(self.defects))
        end = ca.Function("end", [symbol], [here.rows, here.rows_by_x, here.defects_by_x])
        rows, rows_by_x, defects_by_x = end(x)
        by_x, held = rows_by_x.sparse().tocsc(), defects_by_x.sparse().tocsc()
        inner = self.p + (self.stages[:, None] * self.nx + np.arange(self.nx)).ravel()
        outer = np.setdiff1d(np.arange(self.size), inner)
        follow = splu(held[:, inner]).solve(-held[:, outer].toarray())
        jacobian = by_x[:, inner] @ follow + by_x[:, outer].toarray()
        jacobian[:, : self.p] /= parameters.scale
        states = x[self.p :].reshape(-1, self.nx) * self.problem.dynamics.scale
        points = tuple(states[a:b] for a, b in pairwise(self.first.tolist()))
        # IPOPT lets bounds give way a little
        theta = np.clip(parameters.nominal + parameters.scale * x[: self.p], parameters.lower, parameters.upper)
        return Linearised(theta, points, np.asarray(rows).ravel(), np.asarray(jacobian), len(self.present), self.priors)


class _Mapped:
    """A small function of a point's states, of θ and of data, at many points: values, and their derivative by x."""

    def __init__(self, value: ca.SX, state: ca.SX, z: ca.SX, data: ca.SX, at: Array,
                 points: NDArray[np.intp]) -> None:
        by_state, by_theta = ca.jacobian(value, state), ca.jacobian(value, z)
        count, self.rows = len(points), value.numel()
        function = ca.Function("point", [state, z, data], [value, by_state, by_theta])
        self.function, self.data, self.points = function.map(count), ca.DM(at.T), points
        block = np.repeat(np.arange(count), by_state.nnz())
        row, column = (np.tile(k, count) for k in by_state.sparsity().get_triplet())
        shared = np.repeat(np.arange(count), by_theta.nnz())
        shared_row, shared_column = (np.tile(k, count) for k in by_theta.sparsity().get_triplet())
        self.row = np.concatenate([shared * self.rows + shared_row, block * self.rows + row]).astype(np.intp)
        self.column = np.concatenate([shared_column, z.numel() + points[block] * state.numel() + column]).astype(
            np.intp)
        self.order = np.lexsort((self.row, self.column))
        multipliers, both = ca.SX.sym("m", self.rows), ca.vertcat(z, state)
        bend = ca.hessian(ca.dot(multipliers, value), both)[0]
        self.bend = ca.Function("bend", [state, z, data, multipliers], [bend]).map(count)
        row, column = (np.tile(k, count) + both.numel() * np.repeat(np.arange(count), bend.nnz())
                       for k in bend.sparsity().get_triplet())
        self.pattern = _matrix(np.ones(len(row)), row, column, (count * both.numel(),) * 2).sparsity()

    def curvature(self, states: ca.MX, z: ca.MX, multipliers: ca.MX) -> ca.MX:
        """Second derivative by x of Σ multipliers·value."""
        count, p, nx = len(self.points), z.numel(), states.size1()
        if not self.pattern.nnz():
            return ca.MX(p + states.numel(), p + states.numel())
        entries = self.bend(states[:, self.points.tolist()], ca.repmat(z, 1, count), self.data,
                            ca.reshape(multipliers, self.rows, count))
        first = (p + nx) * np.arange(count)[:, None]
        row = np.concatenate([(first + np.arange(p)).ravel(), (first + p + np.arange(nx)).ravel()])
        column = np.concatenate([np.tile(np.arange(p), count),
                                 (p + self.points[:, None] * nx + np.arange(nx)).ravel()])
        gather = _matrix(np.ones(len(row)), row, column, (count * (p + nx), p + states.numel()))
        return gather.T @ (ca.MX(self.pattern, ca.vec(entries.nz[:])) @ gather)

    def evaluate(self, states: ca.MX, z: ca.MX) -> tuple[ca.MX, ca.MX]:
        """Values at all points, and their derivative by x."""
        count, size = len(self.points), z.numel() + states.numel()
        value, by_state, by_theta = self.function(
            states[:, self.points.tolist()], ca.repmat(z, 1, count), self.data)
        starts = np.concatenate([[0], np.cumsum(np.bincount(self.column, minlength=size))])
        pattern = ca.Sparsity(self.rows * count, size, starts.tolist(), self.row[self.order].tolist())
        entries = ca.vertcat(ca.vec(by_theta.nz[:]), ca.vec(by_state.nz[:]))
        return ca.vec(value), ca.MX(pattern, entries[self.order.tolist()])


def _matrix(value: Array, row: NDArray[np.intp], column: NDArray[np.intp], shape: tuple[int, int]) -> ca.DM:
    if not len(value):
        return ca.DM(*shape)
    return ca.DM.triplet(row.tolist(), column.tolist(), ca.DM(value), *shape)
