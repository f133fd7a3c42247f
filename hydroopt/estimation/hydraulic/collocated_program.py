"""The identification of dynamics from records as one sparse nonlinear program, for a user's own tools.

The states at all points are among the unknowns, and the collocated dynamics are constraints.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from hydroopt.estimation.hydraulic.collocation import FACTORS
from hydroopt.estimation.hydraulic.dynamics import POINTS, WIDEST, Record, ShootingProblem
from hydroopt.estimation.inference.program import NonlinearProgram
from hydroopt.spatial.inertia import Array


def nonlinear_program(problem: ShootingProblem, points: list[Array]) -> NonlinearProgram:
    """The nonlinear program, with an initial guess of states (K, nx) of each record.

    Variables are θ, from its nominal value, and the states of all records, in units of their scales.
    """
    parameters, dynamics, records = problem.parameters, problem.dynamics, problem.records
    p, nx, count = len(parameters), len(dynamics.states), sum(map(len, points))
    x, scale = ca.MX.sym("x", p + nx * count), ca.DM(dynamics.scale)
    z, states = x[:p], ca.reshape(x[p:], nx, count)
    theta = ca.DM(parameters.nominal) + ca.DM(parameters.scale) * z
    rows, constraints, first = [], [], 0
    for record, guess in zip(records, points, strict=True):
        own = states[:, first : first + len(guess)]
        constraints.append(_defects(problem, record, own, theta))
        samples = own[:, :: POINTS * record.steps]
        outputs = dynamics.outputs.map(len(record.t))(scale * samples, record.u.T, ca.repmat(theta, 1, len(record.t)))
        present = np.flatnonzero(np.isfinite(record.y).ravel()).tolist()
        sigma = np.tile(problem.sigma, len(record.t))[present]
        rows.append((ca.vec(outputs)[present] - record.y.ravel()[present]) / sigma)
        spread = WIDEST * dynamics.scale if record.initial_sigma is None else record.initial_sigma
        known = np.flatnonzero(np.isfinite(spread)).tolist()
        rows.append((scale * own[:, 0] - record.guess[0])[known] / spread[known])
        first += len(guess)
    values, vectors = np.linalg.eigh(parameters.information * np.outer(parameters.scale, parameters.scale))
    rows.append(np.sqrt(np.maximum(values, 0))[:, None] * vectors.T @ z)
    names = [*parameters.names, *(f"{state}, record {k + 1}, {t:.6g} s" for k, record in enumerate(records)
                                  for t in record.time for state in dynamics.states)]
    units = [f"{scale:.6g} {unit} from {nominal:.6g}" for scale, unit, nominal in zip(
        parameters.scale, parameters.units, parameters.nominal, strict=True)]
    units += [f"{each:g}" for each in dynamics.scale] * count
    counts = np.sum([np.isfinite(record.y).sum(axis=0) for record in records], axis=0)
    free, g = np.full(nx * count, np.inf), ca.vertcat(*constraints)
    terms = [f"half the sum of squares of {number} residuals of {channel}, sigma {sigma:.4g}"
             for channel, number, sigma in zip(dynamics.channels, counts, problem.sigma, strict=True)]
    return NonlinearProgram(
        x=x, f=ca.sumsqr(ca.vertcat(*rows)) / 2, x_names=tuple(names), x_units=tuple(units),
        x0=np.concatenate([np.zeros(p), (np.vstack(points) / dynamics.scale).ravel()]),
        lbx=np.concatenate([(parameters.lower - parameters.nominal) / parameters.scale, -free]),
        ubx=np.concatenate([(parameters.upper - parameters.nominal) / parameters.scale, free]),
        g=g, g_names=tuple(f"dynamics of {state}" for state in dynamics.states) * (g.numel() // nx),
        lbg=np.zeros(g.numel()), ubg=np.zeros(g.numel()), p=ca.MX.sym("p", 0), objective=(
            *terms, "half the sum of squares of the residuals of the parameters' priors",
            "half the sum of squares of the residuals of the first states' priors"))


def _defects(problem: ShootingProblem, record: Record, states: ca.MX, theta: ca.MX) -> ca.MX:
    """By how much the polynomials through states (nx, K) miss the dynamics, in units of the states' scales."""
    dynamics, inner = problem.dynamics, states[:, 1:]
    count, scale = inner.size2(), ca.DM(dynamics.scale)
    span = np.repeat(np.diff(record.edges), POINTS)
    rates = dynamics.rates.map(count)(scale * inner, record.inputs(dynamics.held).T, ca.repmat(theta, 1, count))
    slopes = []
    for j in range(POINTS):
        slope = FACTORS[0, j] * states[:, :-1:POINTS]
        for i in range(POINTS):
            slope += FACTORS[i + 1, j] * inner[:, i::POINTS]
        slopes.append(slope - rates[:, j::POINTS] * ca.DM(np.outer(1 / dynamics.scale, span[j::POINTS])))
    return ca.vec(ca.vertcat(*slopes))
