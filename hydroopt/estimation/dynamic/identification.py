"""The result of an estimator: parameters with uncertainty, and their fit to training and validation data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from typing import NamedTuple

import numpy as np

from hydroopt.estimation.dynamic.experiment import Experiment
from hydroopt.estimation.dynamic.friction_candidates import FrictionChoice
from hydroopt.estimation.dynamic.left_out import left_out
from hydroopt.estimation.dynamic.problem import IdentificationProblem
from hydroopt.estimation.dynamic.reduced_model import WITH_PRIORS, reduced_parameters
from hydroopt.estimation.dynamic.regressor_qr import predict
from hydroopt.estimation.dynamic.weighted_residuals import WeightedResiduals
from hydroopt.estimation.inference.identifiability import (
    COMBINATION,
    FULL,
    NONE,
    RANK_TOLERANCE,
    Confounded,
    Identifiability,
)
from hydroopt.estimation.inference.least_squares import RidgeStrength, deviations
from hydroopt.estimation.inference.left_out import LeftOut
from hydroopt.estimation.inference.posterior import Posterior
from hydroopt.estimation.inference.prior_conflict import PriorTest, Refuted, prior_test
from hydroopt.estimation.inference.priors import prior_squares
from hydroopt.machine.machine import Machine
from hydroopt.parameters.dynamic import bodies, carried, owners_with_confidence
from hydroopt.parameters.parameter_set import ParameterSet
from hydroopt.results.fit import Fit
from hydroopt.spatial import inertia
from hydroopt.spatial.inertia import Array

NOMINAL, REDUCED, COMPLETE = "nominal", "reduced", "complete"
"""Models whose predictions stand side by side."""


class TotalMass(NamedTuple):
    """Mass [kg] of a link with the ends of cylinders that are pinned to it; NaN where it is not identifiable."""

    link: str
    bodies: tuple[str, ...]
    value: float
    std: float
    low: float
    high: float


class Intervals(StrEnum):
    """Origin of standard deviations and intervals, or the reason why there are none."""

    LEAST_SQUARES = "weighted least squares"
    SAMPLED = "sampled posterior"
    BIASED = "none: the method is biased"
    NOT_REQUESTED = "none: not requested"
    NOT_SAMPLABLE = "none: a constraint cannot be sampled"


@dataclass(frozen=True, eq=False, repr=False)
class Identification:
    """A solved identification problem, without diagnostics and files.

    Attributes:
        problem: the problem.
        algorithm: one of `hydroopt.estimation.dynamic.identify.METHODS`.
        psi: (p,) parameters that predict forces. Where only base parameters are identifiable, those nearest to nominal
            with these base parameters; for ridge and truncated SVD the solution of the method.
        value, std, ci95: (p,), (p,), (p, 2) per parameter, NaN where it is not identifiable.
        bound: (p,) name of a constraint that is active at the most probable value of each parameter, or "".
        active: names of all constraints that are active at the most probable parameters.
        structural: identifiability under ideal motion; `identifiability` with the motion of the training data.
        base_value, base_std: (r,) of the base parameters of `identifiability`.
        weighted_residuals: weights of the residuals, and the information about ψ that they carry.
        confounded: base parameters that this motion can hardly separate.
        notes: how the solution was computed, in sentences.
        intervals: where standard deviations and intervals come from.
        posterior: samples of the parameters, where intervals were sampled.
        friction_choice: how its friction terms were chosen, if they were.
        tolerance, ridge: of a method without priors, as `identify` took them.
        ridge_strength: λ of ridge regression, for that method.
        refuted_statements: constraints, priors and fixed values of the user that machine file and data contradict.
    """

    problem: IdentificationProblem
    algorithm: str
    psi: Array
    value: Array
    std: Array
    ci95: Array
    bound: tuple[str, ...]
    active: tuple[str, ...]
    structural: Identifiability
    identifiability: Identifiability
    base_value: Array
    base_std: Array
    weighted_residuals: WeightedResiduals[IdentificationProblem]
    confounded: tuple[Confounded, ...]
    notes: tuple[str, ...]
    intervals: Intervals
    seed: int = 0
    posterior: Posterior | None = None
    friction_choice: FrictionChoice | None = None
    tolerance: float = RANK_TOLERANCE
    ridge: float | None = None
    ridge_strength: RidgeStrength | None = None
    refuted_statements: tuple[Refuted, ...] = ()

    @cached_property
    def prior_test(self) -> PriorTest:
        """Whether the data agree with the priors of the machine file, as a whole and by body."""
        weighted, parameters = self.weighted_residuals, self.problem.parameters
        groups = body_groups(parameters, self.problem.model.machine)
        return prior_test(weighted.R, weighted.r, self.problem.file_prior_rows, parameters.scale, parameters.nominal, {
            name: np.concatenate([np.arange(len(parameters))[parameters.bodies[owner]] for owner in owners])
            for name, owners in groups.items()})

    @cached_property
    def left_out(self) -> LeftOut | None:
        """Errors of forces in blocks of the logs that are predicted without them, and in held-out logs."""
        return left_out(self.problem, self.weighted_residuals, self.algorithm, self.psi, self.tolerance)

    @property
    def uses_priors(self) -> bool:
        """Whether the method uses the machine file's priors, bounds and statements."""
        return self.algorithm in WITH_PRIORS

    @property
    def prior_std(self) -> Array:
        """Standard deviation (p,) of the priors that the method used, NaN where it used none."""
        stated = self.problem.parameters.prior_std
        if not self.uses_priors:
            return np.full_like(stated, np.nan)
        if not self.problem.priors:
            return stated
        parameters = self.problem.parameters
        rows, _ = prior_squares(parameters.information, parameters.nominal, self.problem.priors)
        std = deviations(rows, parameters.scale)
        return np.where(np.isfinite(std), std, np.nan)

    @property
    def sigma(self) -> Array:
        """Weights used (n,): standard deviation of each actuator's residual."""
        return self.weighted_residuals.sigma

    @property
    def correlation_time(self) -> Array:
        """Correlation time (n,) of each actuator's residuals in samples; 1 is white noise."""
        return self.weighted_residuals.correlation_time

    @cached_property
    def total_masses(self) -> tuple[TotalMass, ...]:
        """Masses of the links, each with what is pinned to it, as a scale would weigh them."""
        model, parameters = self.problem.model, self.problem.parameters
        found = []
        for link, owners in carried(model.machine, actuator_inertia=model.actuator_inertia).items():
            at = parameters.select(f"{owner}.m" for owner in owners)
            value, std, interval = float(np.sum(self.value[at])), np.nan, np.full(2, np.nan)
            if self.posterior is not None and np.isfinite(value):
                row = np.zeros((1, len(parameters)))
                row[0, at] = 1.0
                spread, limits = self.posterior.interval(row)
                std, interval = float(spread[0]), limits[0]
            found.append(TotalMass(link, owners, value, std, float(interval[0]), float(interval[1])))
        return tuple(found)

    @cached_property
    def variants(self) -> Mapping[str, Array]:
        """Parameters ψ (p,) of the models that stand side by side, the identified one last (Figure 37): ``nominal`` by
        the machine file, ``reduced`` without barrels and rods, and ``complete``."""
        nominal, complete = {NOMINAL: self.problem.parameters.nominal}, self.problem.model.actuator_inertia
        reduced = reduced_parameters(self.weighted_residuals, self.algorithm, self.tolerance, self.ridge)
        between = {} if reduced is None else {REDUCED: reduced}
        return nominal | between | {COMPLETE if complete else REDUCED: self.psi}

    def predict(self, data: Experiment, psi: Array | None = None) -> Array:
        """Actuator forces (N, n) for the motion of an experiment, by other parameters `psi` (p,) if given."""
        return predict(self.problem.model, data, self.psi if psi is None else psi)

    @cached_property
    def predictions(self) -> Mapping[str, list[Array]]:
        """Predicted forces (N, n) of the shown part of every training and validation experiment."""
        return {"train": [self.predict(e.plotted) for e in self.problem.experiments],
                "validation": [self.predict(e.plotted) for e in self.problem.validation]}

    @property
    def fit(self) -> dict[str, dict[str, Fit]]:
        """Fit by data set and balance that is measured there; the entry ``all`` covers all, of one unit or mixed units.
        """
        return self.fit_by_model[[*self.fit_by_model][-1]]

    @cached_property
    def fit_by_model(self) -> dict[str, dict[str, dict[str, Fit]]]:
        """The same of each of the `variants`."""
        sets = {"train": self.problem.experiments, "validation": self.problem.validation}
        return {name: {which: self._fit(data, psi) for which, data in sets.items() if data}
                for name, psi in self.variants.items()}

    def _fit(self, data: tuple[Experiment, ...], psi: Array) -> dict[str, Fit]:
        count, force, squared, error = sum((e.moments(psi) for e in data), np.zeros((4, len(self.sigma))))
        sums = np.array([count, error, squared, squared - force**2 / np.maximum(count, 1)])
        units = self.problem.model.force_units
        table = {balance.name: Fit.of_sums(sums[:, k], units[k])
                 for k, balance in enumerate(self.problem.model.machine.balances) if count[k]}
        if len({units[k] for k in np.flatnonzero(count)}) == 1:
            return table | {"all": Fit.of_sums(sums.sum(axis=1), units[int(np.argmax(count > 0))])}
        # channels of different units are compared in units of their own noise
        sums[1:] /= self.sigma**2
        return table | {"all": Fit.of_sums(sums.sum(axis=1), "sigma")}

    @cached_property
    def consistency(self) -> dict[str, float]:
        """Smallest eigenvalue of each body's pseudo-inertia at ψ; negative: no such body exists."""
        at = {owner: self.problem.parameters.index(f"{owner}.m") for owner in self.problem.model.bodies}
        return {owner: inertia.smallest_eigenvalue(self.psi[k : k + 10]) for owner, k in at.items()}

    def category(self, k: int) -> str:
        """Of parameter k: ``full``, ``combination``, ``none``, ``not excited`` where only this motion prevents more,
        ``stated`` where a constraint or prior that was added gives the value, or ``fixed``.
        """
        if self.problem.parameters.names[k] in self.problem.fixed:
            return "fixed"
        if self.identifiability.category[k] == NONE and np.isfinite(self.value[k]):
            return "stated"
        found, possible = self.identifiability.category[k], self.structural.category[k]
        less = (possible, found) in ((FULL, COMBINATION), (FULL, NONE), (COMBINATION, NONE))
        return "not excited" if less else found


def body_groups(parameters: ParameterSet, machine: Machine) -> dict[str, tuple[str, ...]]:
    """Owners of bodies that may be wrong together: each alone, all links, all barrels and rods, those of the
    calibrator, and all. Bodies of which the file states no confidence are left out: they cannot be wrong."""
    stated = owners_with_confidence(machine, bodies(machine, calibrator=True))
    owners = tuple(owner for owner in parameters.bodies if owner in stated)
    links = tuple(owner for owner in owners if owner in {link.name for link in machine.links})
    ends = tuple(owner for owner in owners if "." in owner)
    rest = tuple(owner for owner in owners if owner not in {*links, *ends})
    several = {"all links": links, "barrels and rods": ends, "the calibrator's": rest, "all bodies": owners}
    return {owner: (owner,) for owner in owners} | {
        name: some for name, some in several.items() if len(some) > 1 and (name != "all bodies" or some != links)}
