"""The identification of valves and oil as one sparse nonlinear program, for a user's own tools.

The corrections of all readings are among the unknowns, and the volume balances are constraints.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

from hydroopt.estimation.hydraulic.adjustment import Balanced
from hydroopt.estimation.hydraulic.readings import QUANTITIES
from hydroopt.estimation.inference.program import NonlinearProgram
from hydroopt.parameters.parameter_set import ParameterSet


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
