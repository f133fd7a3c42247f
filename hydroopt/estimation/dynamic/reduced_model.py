"""The thesis's reduced model, without barrels and rods, identified from the same weighted residuals (Section 4.6)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from hydroopt.errors import HydrooptError, ProblemError
from hydroopt.estimation.dynamic.folding import split, triangle
from hydroopt.estimation.dynamic.problem import IdentificationProblem
from hydroopt.estimation.inference import convex_program, least_squares, nlp
from hydroopt.estimation.inference.conditions import Condition
from hydroopt.estimation.inference.convex_program import Optimum
from hydroopt.estimation.inference.priors import Prior
from hydroopt.estimation.inference.whitening import gaussian_posterior
from hydroopt.model.model import Model, recent_model
from hydroopt.parameters.dynamic import bodies
from hydroopt.spatial.inertia import Array

if TYPE_CHECKING:
    from hydroopt.estimation.dynamic.weighted_residuals import WeightedResiduals

WITH_PRIORS = ("sdp", "qp", "nlp")
"""Methods that use the machine file's priors, bounds and statements; the others compute from the data alone."""


def most_probable(problem: IdentificationProblem, method: str, R: Array, r: Array, tolerance: float) -> Optimum:
    """The most probable parameters of ``‖R·ψ − r‖²`` by a method with priors, ``sdp``, ``qp`` or ``nlp``; by others
    those of least squares on base parameters that are nearest to the nominal ones.

    Raises:
        ProblemError, SolverError: as of the solvers.
    """
    if method not in WITH_PRIORS:
        parameters = problem.parameters
        psi, _, found = least_squares.base_least_squares(R, r, parameters.names, tolerance)
        return Optimum(least_squares.nearest(parameters, found, psi), ())
    posterior = gaussian_posterior(problem, R, r)
    if method == "nlp":
        return nlp.interior_point(problem, posterior)
    return convex_program.semidefinite_program(problem, posterior, consistent=method == "sdp" and problem.consistent)


def reduced_parameters(weighted: WeightedResiduals[IdentificationProblem], method: str, tolerance: float,
                       ridge: float | None) -> Array | None:
    """Parameters ψ (p,) of the reduced model, zero for barrels and rods; None where there is no such model.

    The reduced model is a restriction of the complete one: the columns of barrels and rods leave the triangle, and what
    is left is solved by the same method. Weights are those of the complete model. There is none where no barrel or rod
    has a body, where a statement binds one, or where forces are not linear in the parameters.
    """
    problem, parameters = weighted.problem, weighted.problem.parameters
    model = problem.model
    if not model.linear or parameters.bodies.keys() == bodies(model.machine, actuator_inertia=False,
                                                              calibrator=model.calibrator).keys():
        return None
    small = (Model(model.machine, actuator_inertia=False, calibrator=model.calibrator, terms=model.terms) if model.terms
             else recent_model(model.machine, actuator_inertia=False, calibrator=model.calibrator))
    kept = parameters.select(small.parameters.names)
    psi = np.zeros(len(parameters))
    try:
        psi[kept] = _solved(weighted, _restricted(problem, small, kept), kept, method, tolerance, ridge)
    except HydrooptError:  # a statement cannot hold without barrels and rods, or the solver gives no answer
        return None
    return psi


def _solved(weighted: WeightedResiduals[IdentificationProblem], restricted: IdentificationProblem, kept: Sequence[int],
            method: str, tolerance: float, ridge: float | None) -> Array:
    """The parameters (k,) that are kept, by a method of `hydroopt.estimation.dynamic.identify.METHODS`."""
    R, r, rest = _columns(kept, *weighted.plain)
    if method == "ridge":
        return least_squares.ridge(R, r, ridge, rows=weighted.rows, rest=rest)[0]
    if method == "tsvd":
        return least_squares.truncated_svd(R, r, tolerance)[0]
    R, r, _ = _columns(kept, weighted.R, weighted.r, weighted.rest)
    return most_probable(restricted, method, R, r, tolerance).psi


def _columns(kept: Sequence[int], R: Array, r: Array, rest: float) -> tuple[Array, Array, float]:
    """R, r and rest of ``‖R·ψ − r‖² + rest`` in some of the parameters."""
    short, right, more = split(triangle(np.column_stack([R[:, kept], r])))
    return short, right, rest + more


def _restricted(problem: IdentificationProblem, small: Model, kept: Sequence[int]) -> IdentificationProblem:
    """The problem of the reduced model, without data.

    Raises:
        ProblemError: a statement binds a barrel or rod.
    """
    def row(rows: Array, name: str) -> Array:
        if np.any(np.delete(rows, kept, axis=-1)):
            raise ProblemError("it binds a barrel or rod, which the reduced model has not", where=f"'{name}'",
                               remedy="leave it out")
        return np.asarray(rows[..., kept])

    if not problem.fixed.keys() <= set(small.parameters.names):
        raise ProblemError("a barrel or rod is fixed, which the reduced model has not", where=problem.where,
                           remedy="leave it out")
    return replace(
        problem, model=small, experiments=(), validation=(),
        physics=tuple(Condition(one.name, one.kind, row(one.rows, one.name), one.right) for one in problem.physics),
        priors=tuple(Prior(one.name, row(one.row, one.name), one.value, one.sigma) for one in problem.priors))
