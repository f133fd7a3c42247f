"""Identification: weights of residuals, compression, the chosen estimator, and its uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Literal, get_args

import numpy as np
from threadpoolctl import threadpool_limits

from hydroopt.errors import IdentifiabilityError, LogError, ProblemError, SolverError
from hydroopt.estimation.dynamic.estimate import Estimate
from hydroopt.estimation.dynamic.identification import Intervals
from hydroopt.estimation.dynamic.misfit.freed import Freed, free
from hydroopt.estimation.dynamic.problem import IdentificationProblem
from hydroopt.estimation.dynamic.reduced_model import WITH_PRIORS, most_probable
from hydroopt.estimation.dynamic.training_logs import contradictions, explained
from hydroopt.estimation.dynamic.weighted_residuals import (
    WeightedResiduals,
    misfit,
    weighted_residuals,
    with_uncertain_gains,
)
from hydroopt.estimation.inference import convex_program, identifiability
from hydroopt.estimation.inference import least_squares as linear
from hydroopt.estimation.inference import posterior as uncertainty
from hydroopt.estimation.inference.band_variances import NORMAL
from hydroopt.estimation.inference.certificate import Certificate
from hydroopt.estimation.inference.identifiability import RANK_TOLERANCE, Identifiability
from hydroopt.estimation.inference.prior_conflict import Refuted, Statement, refuted
from hydroopt.parameters.parameter_set import ParameterKind
from hydroopt.results.diagnostic import listed
from hydroopt.spatial.inertia import Array

Method = Literal["sdp", "qp", "nlp", "wls", "ridge", "tsvd"]
METHODS: tuple[Method, ...] = get_args(Method)
Weighted = WeightedResiduals[IdentificationProblem]
MAX_STEPS, SMALLEST_STEP = 60, 1e-6
"""Largest number of Gauss-Newton steps, and smallest step length as a part of the full step."""
CONVERGED = 1e-7
"""Relative change of parameters below which the steps have converged."""
DECREASE_TOLERANCE, LOOSE_TOLERANCE = 1e-6, 0.1
"""Decrease of the objective, in squared standard deviations, below which the steps have converged; the second one holds
where the line search finds no decrease."""
MOST_SIZES, SAME_SIZE = 6, 0.1
"""How often sizes of freed faults and parameters are estimated in turn, and the change of a size over its standard
deviation below which it has converged."""
NEGLIGIBLE_FORCE = 1e-4
"""Stribeck force, as a part of the standard deviation of residuals, that counts as zero."""


def identify(problem: IdentificationProblem, method: Method = "sdp", *, tolerance: float = RANK_TOLERANCE,
          ridge: float | None = None, intervals: bool = True, seed: int = 0) -> Estimate:
    """Solve an identification problem; the problem itself is not changed.

    Args:
        problem: what to solve.
        method: ``sdp`` priors, bounds and physically possible bodies (default); ``qp`` the same without the bodies;
            ``nlp`` as ``sdp`` but by IPOPT, for constraints that are not convex; ``wls`` weighted least squares on base
            parameters (Eq. 4.58); ``ridge`` (Eq. 4.59); ``tsvd`` truncated singular values (Eq. 4.60). The last three
            know no confidences, and refuse a problem with constraints: bounds, shapes, symmetries, total masses and
            identical parts of the machine file, and all that was added. A log-det distance needs ``sdp`` or ``nlp``.
        tolerance: part of the largest singular value below which a direction counts as not identifiable.
        ridge: strength λ for ``ridge``, relative to the largest eigenvalue; chosen by cross-validation if None.
        intervals: whether to sample the posterior. The estimate is then its mean, otherwise its most probable point;
            the mean of consistent machines is consistent, is nearer to the truth and lies inside its intervals.
        seed: of that sampling.

    Raises:
        ProblemError: unknown method, or constraints the method cannot honour or that contradict each other.
        IdentifiabilityError: no joint moves in the training data.
        SolverError: no trustworthy answer.
    """
    if method not in METHODS:
        raise ProblemError(f"'{method}' is not a method", where="identification",
                           remedy=f"use one of {', '.join(METHODS)}")
    if problem.distance == "log-det" and method not in ("sdp", "nlp"):
        raise ProblemError(f"method '{method}' has no log-det distance", where="identification",
                           remedy="use sdp or nlp")
    if ridge is not None and not 0 < ridge < float("inf"):
        raise ProblemError(f"a ridge strength of {ridge:g} is not positive and finite", where="--ridge",
                           remedy="give a positive one, or method wls for none")
    if method not in WITH_PRIORS and (stated := problem.stated_constraints):
        raise ProblemError(f"method '{method}' cannot honour {listed(stated, 5)}", where="identification",
                           remedy="use qp, sdp or nlp")
    # the matrices are too small for threads
    with threadpool_limits(limits=1, user_api="blas"):
        try:
            solve = _solve_with_faults if problem.freed else _solve
            found = solve(problem, method, tolerance, ridge, intervals, seed)
            if problem.own_statements and found.posterior is not None:
                free = solve(problem.without_statements, method, tolerance, ridge, intervals, seed)
                found = replace(found, refuted_statements=_refuted(problem.own_statements, free))
            return found
        except (IdentifiabilityError, LogError, SolverError) as error:
            raise explained(error, contradictions(problem.model, problem.experiments)) from None


def _refuted(statements: Sequence[Statement], free: Estimate) -> tuple[Refuted, ...]:
    """The statements that an answer without them contradicts."""
    if free.posterior is None:
        return ()
    rows = np.array([one.row for one in statements])
    return refuted(statements, rows @ free.psi, free.posterior.interval(rows)[0])


def _solve_with_faults(problem: IdentificationProblem, method: Method, tolerance: float, ridge: float | None,
                       intervals: bool, seed: int) -> Estimate:
    """Estimate freed faults about the parameters that follow from them, and solve with what remains uncertain."""
    freed = free(problem, problem.parameters.nominal)
    for _ in range(MOST_SIZES):
        psi = _solve(freed.corrected(problem), method, tolerance, ridge, False, seed, freed).psi
        last, freed = freed, free(problem, psi, freed)
        if np.all(np.abs(freed.size - last.size) < SAME_SIZE * freed.std):
            break
    estimate = _solve(freed.corrected(problem), method, tolerance, ridge, intervals, seed, freed)
    beside = freed.given(problem, estimate.psi)
    return replace(estimate, problem=beside.corrected(problem), freed=beside)


def _solve(problem: IdentificationProblem, method: Method, tolerance: float, ridge: float | None, intervals: bool,
           seed: int, freed: Freed | None = None) -> Estimate:
    """Solve at once, or by Gauss-Newton steps where forces are not linear in the parameters.

    Raises:
        SolverError: the steps do not converge.
    """
    parameters = problem.parameters
    if problem.model.linear:
        return _solve_at(problem, parameters.nominal, method, tolerance, ridge, intervals, seed, freed)
    speeds = problem.model.nonlinear
    nonlinear = speeds | np.array([kind is ParameterKind.STRIBECK_FRICTION for kind in parameters.kinds])
    rows = {actuator.name: k for k, balance in enumerate(problem.model.machine.balances)
            for actuator in balance.actuators}
    stribeck_forces = {k: rows[owner] for k in parameters.places(ParameterKind.STRIBECK_FRICTION)
                       if (owner := parameters.owner(parameters.names[k])) in rows}
    final = partial(_solve_at, problem, method=method, tolerance=tolerance, ridge=ridge, intervals=intervals, seed=seed,
                    freed=freed)
    point, negligible = parameters.nominal.copy(), np.full(len(problem.model.machine.balances), np.inf)
    for _ in range(MAX_STEPS):
        for k, row in stribeck_forces.items():  # a speed without force is not identifiable
            point[k] *= abs(point[k]) > negligible[row]
        estimate = _solve_at(problem, point, method, tolerance, ridge, False, seed, freed)
        negligible = NEGLIGIBLE_FORCE * estimate.sigma
        unobserved = speeds & (np.array(estimate.identifiability.category) == identifiability.NONE)
        target = np.where(unobserved, point, np.where(speeds, np.clip(estimate.psi, parameters.lower, parameters.upper),
                                                  estimate.psi))
        step = target - point
        converged = np.all(np.abs(step)[nonlinear] <= CONVERGED * np.abs(point)[nonlinear])
        before = _misfit(estimate, point)
        decrease, part = before - _misfit(estimate, target), 1.0
        within_bounds = np.all((target == estimate.psi)[speeds & ~unobserved])
        if (converged or abs(decrease) <= DECREASE_TOLERANCE) and within_bounds:
            return final(target) if intervals else estimate
        # no line search with instruments, which do not minimise residuals
        while decrease <= 0 and part > SMALLEST_STEP and not problem.instruments:
            part /= 2
            decrease = before - _misfit(estimate, point + part * step)
        if part <= SMALLEST_STEP:
            if abs(before - _misfit(estimate, target)) > LOOSE_TOLERANCE:
                break
            return final(target) if intervals else estimate
        point = point + part * step
    names = ", ".join(np.array(parameters.names)[speeds])
    raise SolverError(f"Gauss-Newton steps did not converge: these data do not determine {names}",
                      where=f"identification of {problem.model.machine.name}",
                      remedy="use a method with bounds and priors (sdp, qp, nlp), start closer, or leave them out")


def _misfit(estimate: Estimate, psi: Array) -> float:
    """The objective of an estimate's method at ψ (p,), with the same weights and without linearisation."""
    weighted, total = estimate.weighted_residuals, 0.0
    if estimate.method in WITH_PRIORS:
        total += weighted.problem.prior_misfit(psi)
    return total + misfit(weighted, psi)


def _solve_at(problem: IdentificationProblem, point: Array, method: Method, tolerance: float, ridge: float | None,
              intervals: bool, seed: int, freed: Freed | None = None) -> Estimate:
    """Solve with forces linearised at the parameters `point` (p,)."""
    where = f"identification of {problem.model.machine.name}"

    weighted = weighted_residuals(problem, tolerance, lambda R, r: most_probable(problem, method, R, r, tolerance).psi,
                                  point, priors=method in WITH_PRIORS)
    names = problem.parameters.names
    if freed is None or not any(fault.group == "gain" for fault in freed.faults):
        for _ in range(2 if problem.model.machine.faults.gain else 0):  # first about what exact gains lead to
            at = most_probable(problem, method, weighted.R, weighted.r, tolerance).psi
            weighted = with_uncertain_gains(weighted, at)
    weighted = weighted if freed is None else freed.widened(weighted)
    from_data = identifiability.analyse(weighted.plain[0], names, tolerance=tolerance)
    psi, _, _ = linear.base_least_squares(weighted.R, weighted.r, names, tolerance, from_data)
    _check_normal_equations(weighted.R, weighted.r, psi, from_data, where)
    if method not in WITH_PRIORS:
        return _linear_estimate(weighted, method, from_data, tolerance, ridge)
    solution = most_probable(problem, method, weighted.R, weighted.r, tolerance)
    return _constrained_estimate(weighted, method, solution, from_data, tolerance, intervals, seed)


def _check_normal_equations(R: Array, r: Array, psi: Array, from_data: Identifiability, where: str) -> None:
    """Check least squares by its normal equations: the residual must be orthogonal to every base column.

    Raises:
        SolverError: it is not, because the tolerance counts rounding errors as information.
    """
    basis = R[:, list(from_data.basis)]
    slope = np.max(np.abs(basis.T @ (r - R @ psi)) / np.linalg.norm(basis, axis=0), initial=0.0)
    Certificate(0.0, float(slope / max(1.0, np.linalg.norm(r)))).trust(where, tolerance=1e-6)
    if from_data.condition_number > 1e12:
        raise SolverError(f"the condition number of the base parameters is {from_data.condition_number:.0e}",
                          where=where, remedy="raise the tolerance above rounding errors, e.g. to 1e-9")


def _linear_estimate(weighted: Weighted, method: str, from_data: Identifiability, tolerance: float,
                     ridge: float | None) -> Estimate:
    problem, R, r = weighted.problem, weighted.R, weighted.r
    names = problem.parameters.names
    psi, covariance, _ = linear.base_least_squares(R, r, names, tolerance, from_data)
    value, std = linear.individual_values(psi, covariance, from_data)
    psi = linear.nearest(problem.parameters, from_data, psi)
    base_std = np.sqrt(np.diag(covariance))
    note, source = "standard deviations of weighted least squares on base parameters", Intervals.LEAST_SQUARES
    strength: linear.RidgeStrength | None = None
    if method == "ridge":
        psi, strength = linear.ridge(*weighted.plain[:2], ridge, rows=weighted.rows, rest=weighted.plain[2],
                                     tolerance=tolerance)
        note = (f"{strength} (Eq. 4.59: nearly optimal if much smaller than 1); a shrunk estimate is biased, so that "
                "it has no valid interval")
    elif method == "tsvd":
        psi, rank = linear.truncated_svd(*weighted.plain[:2], tolerance)
        note = f"{rank} directions kept; those cut off are biased to zero, so that there is no valid interval"
    if method != "wls":
        source = Intervals.BIASED
        value = np.where(np.array(from_data.category) == identifiability.FULL, psi, np.nan)
        std, base_std = np.full_like(std, np.nan), np.full_like(base_std, np.nan)
    ci = value[:, None] + NORMAL * std[:, None] * np.array([-1, 1])
    estimate = _assemble(weighted, method, psi, value, std, ci, (), from_data, base_std, (note,), source, 0)
    return replace(estimate, tolerance=tolerance, ridge=ridge, ridge_strength=strength)


def _constrained_estimate(weighted: Weighted, method: str, solution: convex_program.Optimum,
                          from_data: Identifiability, tolerance: float, intervals: bool, seed: int) -> Estimate:
    problem, R, r = weighted.problem, weighted.R, weighted.r
    p = len(problem.parameters)
    psi, std, ci = solution.psi, np.full(p, np.nan), np.full((p, 2), np.nan)
    base_std = np.full(from_data.rank, np.nan)
    note, source, posterior = "intervals were not requested", Intervals.NOT_REQUESTED, None
    if intervals:
        posterior = uncertainty.sample(problem, R, r, solution.psi,
                                       consistent=method != "qp" and problem.consistent, seed=seed)
        if posterior is None:
            source = Intervals.NOT_SAMPLABLE
            note = "no intervals: a constraint cannot be sampled; values are the most probable ones"
        else:
            source = Intervals.SAMPLED
            std, ci = posterior.interval()
            base_std, _ = posterior.interval(from_data.grouping)
            # the most probable point lies on active constraints, and the posterior on one side of it
            psi = solution.psi if posterior.mean is None else posterior.mean
            kind = "the most probable ones" if posterior.mean is None else "posterior means"
            note = f"values are {kind}; {posterior.note}"
    psi = np.array(_nominal_where_unobserved(problem, from_data, psi))
    for name, fixed in problem.fixed.items():  # to the last digit
        psi[problem.parameters.index(name)] = fixed
    # parameters on which neither data nor an added constraint or prior depends have no estimate, whatever the file says
    rows, _ = problem.prior_rows
    equalities = [one.row * np.max(np.abs(R), initial=1.0) for one in problem.own_statements if not one.at_least]
    with_priors = identifiability.analyse(np.vstack([R, rows, *equalities]), problem.parameters.names,
                                          tolerance=tolerance)
    stated = np.any(np.vstack([np.zeros((1, p)), *equalities]), axis=0)
    unobserved = (np.array(from_data.category) == identifiability.NONE) & ~stated
    ambiguous = np.array(with_priors.category) != identifiability.FULL
    value = psi.copy()
    value[ambiguous | unobserved], std[ambiguous | unobserved], ci[ambiguous | unobserved] = np.nan, np.nan, np.nan
    held = problem.parameters.select(problem.fixed)
    value[held], std[held], ci[held] = psi[held], np.nan, np.nan
    return _assemble(weighted, method, psi, value, std, ci, solution.active, from_data, base_std, (note,), source, seed,
                     posterior)


def _nominal_where_unobserved(problem: IdentificationProblem, from_data: Identifiability, psi: Array) -> Array:
    """ψ with the nominal values of bodies that no residual depends on, unless statements connect them with others.

    The nominal values satisfy the statements about a single body.
    """
    if problem.constraints or problem.priors or problem.stated_priors or problem.physics or problem.fixed:
        return psi
    stated = np.abs(np.vstack([np.zeros((0, len(psi))), *(c.rows for c in problem.conditions)])) > 0
    psi = psi.copy()
    for columns in problem.parameters.bodies.values():
        body = np.isin(np.arange(len(psi)), range(columns.start, columns.stop))
        with_others = stated[:, body].any(axis=1) & stated[:, ~body].any(axis=1)
        if set(from_data.category[columns]) == {identifiability.NONE} and not with_others.any():
            psi[columns] = problem.parameters.nominal[columns]
    return psi


def _assemble(weighted: Weighted, method: str, psi: Array, value: Array, std: Array, ci: Array,
              active: tuple[str, ...], from_data: Identifiability, base_std: Array, notes: tuple[str, ...],
              intervals: Intervals, seed: int, posterior: uncertainty.Posterior | None = None) -> Estimate:
    problem = weighted.problem_at(psi)
    bound = [""] * len(problem.parameters)
    active_ones = [one for one in reversed(problem.requirements(consistent=True)) if one.name in active]
    added = [one for one in problem.physics if one.kind == "zero"]
    for condition in (*active_ones, *added):  # what a user added is named before all others, then the first of several
        for k in np.flatnonzero(np.any(condition.rows, axis=0)):
            bound[k] = condition.name
    return Estimate(
        problem, method, psi, value, std, ci, tuple(bound), active, identifiability.structural(problem.model),
        from_data, from_data.grouping @ psi, base_std, weighted,
        identifiability.confounded(weighted.plain[0], from_data), (*notes, *weighted.notes), intervals, seed, posterior)
