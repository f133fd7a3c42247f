"""The information of logs about the parameters, ``‖R·ψ − r‖²``: weights of residuals, and treatment of noisy angles."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np

from hydroopt.errors import IdentifiabilityError, LogError
from hydroopt.estimation.dynamic import fitted_motion
from hydroopt.estimation.dynamic.fitted_motion import FittedMotion
from hydroopt.estimation.dynamic.folding import split, triangle
from hydroopt.estimation.dynamic.force_problem import HUBER, ForceProblem
from hydroopt.estimation.dynamic.frequency_bands import ActuatorBands
from hydroopt.estimation.dynamic.holds import Holds
from hydroopt.estimation.dynamic.regressor_qr import (
    CompressedRegressor,
    compress,
    compress_instrumented,
    compress_jointly,
    compressed,
)
from hydroopt.estimation.dynamic.residual_std import noise_of_angles, residual_std, rms_force, smallest
from hydroopt.estimation.dynamic.score_covariance import BetweenLogs, InMotion, SplitHalf, score_covariance
from hydroopt.estimation.inference import least_squares
from hydroopt.estimation.inference.band_variances import ScoreRows
from hydroopt.estimation.inference.nlp import ResidualTerm
from hydroopt.estimation.inference.whitening import gaussian_posterior, whitened
from hydroopt.results.diagnostic import listed
from hydroopt.spatial.inertia import Array

Problem = TypeVar("Problem", bound=ForceProblem)
MostProbable = Callable[[Array, Array], Array]
"""From (R, r) to the parameters ψ (p,) that an estimator takes."""


@dataclass(frozen=True, eq=False)
class WeightedResiduals(Generic[Problem]):
    """``‖R·ψ − r‖² + rest``, the information of the residuals about ψ, and how they were weighted.

    Least squares weigh each actuator's residuals by their variance where the parameters act. The covariance of each
    actuator's score, from the variances by frequency, then makes rows of unit variance of them
    (`hydroopt.estimation.inference.band_variances`). Where rows of actuators or samples are mixed before (correlated
    channels, instruments, a fitted motion), or forces are not linear in ψ, the weight alone accounts for it.

    Attributes:
        problem: whose residuals; with the fitted motion where requested.
        R, r, rest: (p, p) upper triangular, (p,), and what no ψ explains.
        plain: R, r and rest of the weighted least squares alone, which decide what is identifiable.
        samples: (n,) residuals of each actuator.
        triangles: (·, p+1, p+1) of [K, f] with the same sum of squares: one for each actuator, or one of all where
            their rows are mixed.
        scores: information of each actuator with degrees of freedom, where it is from the covariance of its score.
        sigma: (n,) standard deviation of each actuator's residual.
        correlation: (n, n) of the actuators' residuals with one another; the unit matrix unless requested.
        correlation_time: (n,) variance of the residuals where the parameters act over σ², at least 1; in samples.
        between_logs: how much friction and offsets differ from log to log.
        split_half: how much friction and offsets differ between the halves of each log.
        holds: rows (·, p+1) of [K, f] of each actuator at rest (`hydroopt.estimation.dynamic.holds`), whose errors have
            unit variance.
        stated_friction: actuators whose size of dry friction at rest is the machine file's, though its confidences do
            not count otherwise: no sample in motion shows it.
        fit: of motion and parameters together, where requested.
        gain: standard deviation of the relative error of each force reading that R, r and rest contain.
    """

    problem: Problem
    R: Array
    r: Array
    rest: float
    plain: tuple[Array, Array, float]
    samples: Array
    triangles: Array
    scores: tuple[ScoreRows, ...]
    sigma: Array
    correlation: Array
    correlation_time: Array
    between_logs: BetweenLogs
    split_half: tuple[SplitHalf, ...]
    holds: tuple[Array, ...]
    stated_friction: tuple[str, ...] = ()
    fit: FittedMotion | None = None
    gain: float = 0.0

    def problem_at(self, psi: Array) -> Problem:
        """The problem with the motion, and the numbers beside ψ, that are most probable with parameters ψ (p,), where
        motion was fitted."""
        if self.fit is None:
            return self.problem
        fitted = self.fit.motion(psi)
        return self.problem.with_experiments([one.experiment for one in fitted],
                                             [one.beside for one in fitted if one.beside is not None])

    @property
    def terms(self) -> tuple[ResidualTerm, ...]:
        """The weighted squares by actuator, or as one sum where the actuators' rows are mixed."""
        model, std = self.problem.model, self.sigma * np.sqrt(self.correlation_time)
        if len(self.triangles) < len(std):
            return (ResidualTerm("all actuators", "1", self.triangles[0], None),)
        balances = zip(model.machine.balances, model.force_units, self.triangles, std, strict=True)
        return tuple(ResidualTerm(one.name, unit, triangle * sigma, float(sigma))
                     for one, unit, triangle, sigma in balances)

    def stored(self) -> tuple[Array, Array]:
        """Triangles with rows of unit variance, and degrees of freedom (·, p+1): inf where none were estimated."""
        if not self.scores:
            independent = float(np.sum(self.samples / self.correlation_time))
            return self.triangles, np.full(self.triangles.shape[:2], independent)
        freedom = np.full((len(self.scores), len(self.r) + 1), np.inf)
        for own, score in zip(freedom, self.scores, strict=True):
            own[: len(score.freedom)] = score.freedom
        return np.array([score.triangle(widened=False) for score in self.scores]), freedom

    @property
    def rows(self) -> float:
        """Number of residuals of forces."""
        return float(np.sum(self.samples))

    @property
    def notes(self) -> tuple[str, ...]:
        """How angles and channels were treated, in sentences."""
        notes = []
        if self.stated_friction:
            notes.append(f"no sample in motion shows the dry friction of {', '.join(self.stated_friction)}: its size "
                         "at rest is taken from the machine file")
        if self.gain:
            notes.append(f"each force may be read {100 * self.gain:.2g} % (σ) too large or too small, as the machine "
                         "file states; intervals contain it")
        elif self.problem.model.machine.faults.gain:
            notes.append("intervals do not contain the uncertain gains of force readings that the machine file states, "
                         "since rows of actuators are mixed")
        if self.problem.fitted_motion:
            notes.append("motion and parameters are fitted together; the fit of the training data is that of the "
                         "fitted motion, validation data keep their smoothed motion")
        if self.problem.instruments:
            notes.append("two-stage least squares with instruments from a second reading of the motion")
        if self.problem.correlated:
            names = [each.name for each in self.problem.model.machine.balances]
            pairs = [f"{names[j]} and {names[i]} {self.correlation[i, j]:.2f}" for i in range(len(names))
                     for j in range(i)]
            notes.append(f"residuals weighted by their covariance; correlations: {', '.join(pairs)}")
        return tuple(notes)


def weighted_residuals(problem: Problem, tolerance: float, most_probable: MostProbable,
           point: Array | None = None, *, priors: bool = True) -> WeightedResiduals[Problem]:
    """Weight residuals and compress them.

    Args:
        problem: whose.
        tolerance: part of the largest singular value below which a direction is not identifiable.
        most_probable: the estimator with which a motion is fitted.
        point: (p,) parameters at which forces are linearised that are not linear in them; the nominal ones if None.
        priors: whether the machine file's confidences count. Without them, they tell the size of dry friction at rest
            only where no sample in motion does.

    Raises:
        LogError: the machine cannot take some of the postures.
        IdentifiabilityError: no joint moves, and there is a single posture.
        SolverError: a fitted motion does not converge.
    """
    model, experiments = problem.model, problem.experiments
    point = problem.parameters.nominal if point is None else point
    folded = [data.bands(point) for data in experiments]
    together = ActuatorBands.together(folded)
    data, holds = compressed(together), together.holds
    _refuse_impossible_postures(problem, data)
    if not np.any(data.samples) and np.max(holds.counts) < 2:
        names = ", ".join(e.log.path or e.log.name for e in experiments)
        raise IdentifiabilityError("no joint moves in the training logs, and they hold a single posture", where=names,
                                   remedy="record a log in which the joints move, or rest in several postures")
    of_angles = noise_of_angles(problem, together)
    sigma, weights = residual_std(problem, data, tolerance, of_angles), None
    if problem.loss != "squares":
        data, sigma, weights, folded = _robust(problem, data, folded, sigma, point, of_angles)
    mixed = problem.fitted_motion or problem.instruments or problem.correlated
    # for nonlinear forces, least squares without bounds may leave the range in which the linearisation holds
    psi = _least_squares(problem, *data.weighted(sigma)[:2], tolerance) if mixed and model.linear else point
    correlation = _correlation(problem, psi) if problem.correlated else np.eye(len(sigma))
    fit, where = None, f"identification of {model.machine.name}"
    if problem.fitted_motion:
        fit = fitted_motion.fit(model, fitted_motion.initial_guess(model, experiments, problem.beside),
                                _covariance(correlation, sigma), weights, psi, most_probable, where)
        problem, psi = problem.with_experiments(fit.experiments(fit.psi)), fit.psi
        folded = [one.bands(psi) for one in problem.experiments]
    stated = _stated_friction(problem, data, holds) if not priors else ()
    least, wide = smallest(rms_force(problem, data)), sigma
    motion = InMotion(problem, folded, sigma, least)
    if np.any(holds.counts):
        wide = sigma * np.sqrt(motion.correlation_time)
    equations = tuple(holds.equations(_second_moments(problem, data, wide, priors, stated),
                                      np.nan_to_num(problem.force_std)))
    found = score_covariance(motion, equations)
    # correlated residuals carry less information than as many independent ones
    wide = sigma * np.sqrt(found.correlation_time)
    plain = data.weighted(wide)
    if fit is not None:
        fit = fitted_motion.fit(model, fit.motion(psi), _covariance(correlation, wide), weights, psi, most_probable,
                                where)
        plain = fit.R, fit.r, fit.rest
    elif problem.instruments:
        plain = compress_instrumented(model, experiments, problem.instruments, wide, weights, psi=point)
    elif problem.correlated:
        plain = compress_jointly(model, experiments, _covariance(correlation, wide), weights, psi=point)
    R, r, rest = plain = split(triangle(_triangle(*plain), *found.holds))
    scores: tuple[ScoreRows, ...] = ()
    if mixed:
        triangles = _triangle(R, r, rest)[None]
    elif not model.linear:
        triangles = np.array([_triangle(*split(triangle(own, at_rest)))
                              for own, at_rest in zip(data.triangles / wide[:, None, None], found.holds, strict=True)])
    else:
        scores = found.scores
        triangles = np.array([one.triangle(widened=True) for one in scores])
        R, r, rest = split(triangle(*triangles))
    return WeightedResiduals(problem, R, r, rest, plain, data.samples, triangles, scores, sigma, correlation,
                             found.correlation_time, found.between_logs, found.split_half, found.holds, stated, fit)


def with_uncertain_gains(weighted: WeightedResiduals[Problem], psi: Array) -> WeightedResiduals[Problem]:
    """The information of weighted residuals about ψ where each force has the unknown gain that the machine file states.

    A force that is read (1 + g) times too large, with g of standard deviation σ and the same in all logs, adds g·K·ψ to
    the residuals f − K·ψ of its actuator. With g unknown, rows of unit variance [R, r] have the covariance I + σ²·s·sᵀ
    with s = R·ψ, and (I + σ²·s·sᵀ)^(−1/2) makes rows of unit variance of them again.

    What is stored of each actuator stays as it is, since later jobs have unknown gains of their own. The same residuals
    where no gain is stated, or rows of actuators are mixed.

    Args:
        weighted: residuals of exact gains.
        psi: (p,) parameters about which forces are computed.
    """
    model = weighted.problem.model
    gain = model.machine.faults.gain
    if gain is None or len(weighted.triangles) != len(model.machine.balances):
        return weighted
    made = []
    for balance, own in zip(model.machine.balances, weighted.triangles, strict=True):
        force = own[:, :-1] @ psi
        square = float(force @ force)
        part = (1 - 1 / np.sqrt(1 + gain**2 * square)) / square if square and balance.actuators else 0.0
        made.append(own - part * np.outer(force, force @ own))
    R, r, rest = split(triangle(*made))
    return replace(weighted, R=R, r=r, rest=rest, gain=gain)


def _triangle(R: Array, r: Array, rest: float) -> Array:
    """T (p+1, p+1) with ``‖T·[ψ; −1]‖² = ‖R·ψ − r‖² + rest``."""
    return np.block([[R, r[:, None]], [np.zeros((1, R.shape[1])), np.full((1, 1), np.sqrt(rest))]])


def _stated_friction(problem: ForceProblem, data: CompressedRegressor, holds: Holds) -> tuple[str, ...]:
    """Balances with dry friction at rest that no sample in motion shows, so that only the machine file tells it."""
    shown = np.any(data.triangles[:, :, :-1] != 0, axis=(0, 1))
    levers = holds.levers(len(shown))
    return tuple(balance.name for balance, lever in zip(problem.model.machine.balances, levers, strict=True)
                 if np.any(lever[:, ~shown] != 0))


def _second_moments(problem: ForceProblem, data: CompressedRegressor, sigma: Array, priors: bool,
                    stated: Sequence[str]) -> list[Array]:
    """Expectation (p, p) of ψ·ψᵀ for each balance, by the samples in motion and, where they count, the priors."""
    def expected(*, priors: bool) -> Array:
        found = gaussian_posterior(problem, *data.weighted(sigma)[:2], priors=priors)
        return np.asarray(np.outer(found.offset, found.offset) + found.slope @ found.slope.T)

    by = {counts: expected(priors=counts) for counts in {priors, priors or bool(stated)}}
    return [by[priors or balance.name in stated] for balance in problem.model.machine.balances]


def misfit(weighted: WeightedResiduals[Problem], psi: Array) -> float:
    """The loss of all residuals of forces at ψ (p,), weighted in the same way but without linearisation."""
    problem = weighted.problem
    total = float(sum(np.sum((rows @ np.append(psi, -1.0)) ** 2) for rows in weighted.holds))
    wide = weighted.sigma * np.sqrt(weighted.correlation_time)
    for residual, data in zip(_residuals(problem, psi), problem.experiments, strict=True):
        taken = data.inside[:, None] & data.known
        if problem.loss == "squares":
            total += float(np.sum(whitened(residual[:, :, None], taken, _covariance(weighted.correlation, wide)) ** 2))
            continue
        u = np.abs(np.where(taken, residual, 0.0)) / weighted.sigma
        loss = np.where(u < HUBER, u**2, 2 * HUBER * u - HUBER**2) if problem.loss == "huber" else (
            5 * np.log1p(u**2 / 4))
        total += float(np.sum(loss / weighted.correlation_time))
    return total


def _covariance(correlation: Array, sigma: Array) -> Array:
    return correlation * np.outer(sigma, sigma)


def _refuse_impossible_postures(problem: ForceProblem, data: CompressedRegressor) -> None:
    """Refuse logs with samples for which the model has no number, with the joints that may be read wrongly.

    Raises:
        LogError: there are such samples.
    """
    if np.all(np.isfinite(data.triangles)):
        return
    machine = problem.model.machine
    joints = list(dict.fromkeys(joint for name, follows in machine.followed.items() if name not in machine.joints
                                for joint in follows)) or machine.joints
    raise LogError(f"there are postures that {machine.name} cannot take: a linkage does not close, or a cylinder has "
                   "no lever arm", where=", ".join(e.log.path or e.log.name for e in problem.experiments),
                   remedy=f"correct unit, sign or zero of {listed([f'{joint}.q' for joint in joints], 3)}, or lengths "
                          "in the machine file")


def _least_squares(problem: ForceProblem, R: Array, r: Array, tolerance: float) -> Array:
    return least_squares.base_least_squares(R, r, problem.parameters.names, tolerance)[0]


def _robust(problem: ForceProblem, data: CompressedRegressor, folded: Sequence[ActuatorBands], sigma: Array,
            point: Array, of_angles: Array) -> tuple[CompressedRegressor, Array, list[Array], list[ActuatorBands]]:
    """Iteratively reweighted least squares: Huber (95 % efficient at 1.345 σ) or Student-t (4 degrees of freedom).

    The residuals are those of the most probable parameters before constraints, which good data hardly move. At these,
    ordinary least squares on ``K·ψ + σ·ρ'(u)/E[ρ'']`` lead to the same parameters and to their asymptotic covariance
    (Huber 1973): the equations that are returned by frequency.
    """
    floor = np.maximum(1e-6 * sigma, of_angles)
    psi = np.full(len(problem.parameters), np.inf)
    for _ in range(20):
        R, r, _ = data.weighted(sigma)
        before, psi = psi, gaussian_posterior(problem, R, r).offset
        residuals = _residuals(problem, psi)
        taken = np.concatenate(_taken(problem, residuals))
        read, sigma = np.any(np.isfinite(taken), axis=0), sigma.copy()
        sigma[read] = np.maximum(1.4826 * np.nanmedian(np.abs(taken[:, read]), axis=0), floor[read])
        ratios = [np.abs(res) / sigma for res in residuals]
        weights = [np.minimum(1.0, HUBER / np.maximum(u, 1e-12)) if problem.loss == "huber" else 5.0 / (4.0 + u**2)
                   for u in ratios]
        data = compress(problem.experiments, weights, psi=point)
        if np.all(np.abs(psi - before) < 1e-3 * problem.parameters.scale):
            break
    bent = [(u < HUBER).astype(float) if problem.loss == "huber" else 5 * (4 - u**2) / (4 + u**2) ** 2 for u in ratios]
    slopes = np.concatenate(_taken(problem, bent))
    count = np.sum(np.isfinite(slopes), axis=0)
    mean = np.where(count > 0, np.nansum(slopes, axis=0) / np.maximum(count, 1), 1.0)
    pseudo = [replace(e, force=e.force - res + weight * res / mean)
              for e, res, weight in zip(problem.experiments, residuals, weights, strict=True)]
    bands = [one.bands(point) for one in pseudo]
    for one, other in zip(bands, folded, strict=True):
        one.holds = other.holds
    return data, sigma, weights, bands


def _residuals(problem: ForceProblem, psi: Array) -> list[Array]:
    return [e.force - e.predicted(psi) for e in problem.experiments]


def _taken(problem: ForceProblem, residuals: Sequence[Array]) -> list[Array]:
    """Residuals, NaN where they are not used."""
    return [np.where(e.inside[:, None] & e.known, res, np.nan)
            for res, e in zip(residuals, problem.experiments, strict=True)]


def _correlation(problem: ForceProblem, psi: Array) -> Array:
    """Correlation (n, n) of the actuators' residuals with one another in one sample.

    Zero where fewer than 100 samples have both.
    """
    residuals = np.concatenate(_taken(problem, _residuals(problem, psi)))
    n = residuals.shape[1]
    correlation = np.eye(n)
    for i in range(n):
        for j in range(i):
            both = residuals[np.all(np.isfinite(residuals[:, [i, j]]), axis=1)][:, [i, j]]
            if len(both) >= 100:
                centred = both - both.mean(axis=0)
                size = np.linalg.norm(centred, axis=0)
                correlation[i, j] = correlation[j, i] = centred[:, 0] @ centred[:, 1] / np.prod(size)
    # correlations from different samples may not be positive definite: the nearest matrix that is
    values, vectors = np.linalg.eigh(correlation)
    possible = vectors @ np.diag(np.maximum(values, 1e-3)) @ vectors.T
    size = np.sqrt(np.diag(possible))
    return np.asarray(possible / np.outer(size, size))
