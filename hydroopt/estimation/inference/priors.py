"""Priors: linear expressions of parameters with a standard deviation, and the squares of all priors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Real

import casadi as ca
import numpy as np

from hydroopt.errors import ProblemError
from hydroopt.estimation.inference.conditions import total_mass
from hydroopt.estimation.inference.constraints import Expression, Named, result_of
from hydroopt.machine.links import Note
from hydroopt.machine.machine import Machine
from hydroopt.parameters.parameter_set import ParameterSet
from hydroopt.spatial.inertia import Array

NOT_LINEAR = "state what is not linear by subject_to and solve with method 'nlp', which holds it exactly"
"""Remedy for a prior that is no linear sum."""


@dataclass(frozen=True)
class Prior:
    """A linear expression of parameters known to be ``value ± sigma`` (SI, one standard deviation)."""

    name: str
    row: Array
    value: float
    sigma: float


def linear_prior(parameters: ParameterSet, name: str, expression: Expression, value: float, sigma: float) -> Prior:
    """The prior of a linear expression of parameters in SI.

    Raises:
        ProblemError: the expression is not linear in the parameters, or sigma is not positive.
    """
    if not (isinstance(value, Real) and isinstance(sigma, Real)):
        raise ProblemError("value and sigma are no numbers", where=f"prior '{name}'", remedy=(
            "give them in SI, or state all in a text such as 'boom.m = 1900 +- 300 kg'"))
    if not (0 < sigma < np.inf and np.isfinite(value)):
        raise ProblemError(f"{value} ± {sigma} is not a prior", where=f"prior '{name}'",
                           remedy="give a finite value and a positive sigma, or a constraint")
    symbols = ca.SX.sym("p", len(parameters))
    named = Named(parameters, lambda k: symbols[k])
    result = result_of(lambda p: ca.SX(expression(p)), named, f"prior '{name}'", NOT_LINEAR)
    row = ca.jacobian(result, symbols)
    if result.shape != (1, 1) or ca.depends_on(row, symbols) or not row.nnz():
        raise ProblemError("the expression is not one linear sum of parameters", where=f"prior '{name}'",
                           remedy=NOT_LINEAR)
    at_zero = ca.Function("prior", [symbols], [row, result])(ca.DM.zeros(symbols.shape))
    return Prior(name, np.asarray(ca.DM(at_zero[0])).ravel(), value - float(at_zero[1]), sigma)


def stated_priors(machine: Machine, parameters: ParameterSet) -> tuple[Prior, ...]:
    """Total masses that the machine file states with a confidence."""
    spreads = [(total, machine.notes.get(f"{total.name}.value", Note()).spread(total.value))
               for total in machine.total_masses]
    return tuple(Prior(total.name, total_mass(parameters, total.name, total.bodies), total.value, sigma)
                 for total, sigma in spreads if sigma is not None)


def prior_squares(information: Array, mean: Array, priors: Sequence[Prior]) -> tuple[Array, Array]:
    """Rows A (·, p) and b of ``‖A·ψ − b‖² = (ψ − mean)ᵀ·information·(ψ − mean)`` and the squares of further priors."""
    diagonal = np.diag(information)
    size = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))  # so that the rank does not depend on units
    values, vectors = np.linalg.eigh(information / np.outer(size, size))
    known = values > 1e-12
    root = np.sqrt(values[known])[:, None] * vectors[:, known].T * size
    return (np.vstack([root, *[prior.row / prior.sigma for prior in priors]]),
            np.concatenate([root @ mean, [prior.value / prior.sigma for prior in priors]]))
