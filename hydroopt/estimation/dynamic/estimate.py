"""The answer: parameters with uncertainty, fit on data seen and unseen, and what is in doubt."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from hydroopt.estimation.dynamic.experiment import Experiment
from hydroopt.estimation.dynamic.problem import IdentificationProblem
from hydroopt.estimation.dynamic.regressor_qr import predict
from hydroopt.estimation.dynamic.streamed_experiment import StreamedExperiment
from hydroopt.estimation.dynamic.weighted_residuals import WeightedResiduals
from hydroopt.estimation.inference.identifiability import Confounded, Identifiability
from hydroopt.estimation.inference.posterior import Posterior
from hydroopt.parameters.dynamic import bodies, carried
from hydroopt.results.fit import Fit
from hydroopt.spatial import inertia
from hydroopt.spatial.inertia import Array


class TotalMass(NamedTuple):
    """Mass [kg] of a link with the ends of cylinders that are pinned to it; NaN where that cannot be told."""

    link: str
    bodies: tuple[str, ...]
    value: float
    std: float
    low: float
    high: float


@dataclass(frozen=True, eq=False)
class Estimate:
    """A solved problem.

    Attributes:
        problem: what was solved.
        method: how.
        psi: (p,) parameters that predict. Where base parameters alone are known, the ones nearest to nominal with these
            base parameters; for ridge and truncated SVD whatever these give.
        value, std, ci95: (p,), (p,), (p, 2) per parameter, NaN where the data and the priors cannot tell.
        bound: (p,) name of a constraint that holds the most probable value of each parameter, or "".
        active: names of all constraints that hold the most probable parameters.
        structure: identifiability under ideal motion; `seen` under the motion of the training data.
        base_value, base_std: (r,) of the base parameters of `seen`.
        weighted_residuals: the weights of the residuals, and the information about ψ that they carry.
        confounded: parameters the motion cannot tell apart, though the model could.
        notes: what was done, in plain words.
        posterior: samples of the parameters, where intervals were sampled.
    """

    problem: IdentificationProblem
    method: str
    psi: Array
    value: Array
    std: Array
    ci95: Array
    bound: tuple[str, ...]
    active: tuple[str, ...]
    structure: Identifiability
    seen: Identifiability
    base_value: Array
    base_std: Array
    weighted_residuals: WeightedResiduals[IdentificationProblem]
    confounded: tuple[Confounded, ...]
    notes: tuple[str, ...]
    seed: int = 0
    posterior: Posterior | None = None
    status: str = "ok"

    @property
    def sigma(self) -> Array:
        """Weights used (n,): standard deviation of each actuator's residual."""
        return self.weighted_residuals.sigma

    @property
    def correlation_time(self) -> Array:
        """How many samples in a row the residuals of each actuator repeat themselves (n,); 1 is white noise."""
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

    def __getitem__(self, name: str) -> float:
        """Value of a parameter; NaN if it is not identifiable."""
        return float(self.value[self.problem.parameters.index(name)])

    def predict(self, data: Experiment) -> Array:
        """Actuator forces (N, n) for the motion of an experiment."""
        return predict(self.problem.model, data, self.psi)

    @cached_property
    def predictions(self) -> Mapping[str, list[Array]]:
        """Predicted forces of what is shown of every training and validation experiment."""
        return {"train": [self.predict(e.shown) for e in self.problem.experiments],
                "validation": [self.predict(e.shown) for e in self.problem.validation]}

    @cached_property
    def fit(self) -> dict[str, dict[str, Fit]]:
        """Fit by data set and actuator; the entry ``all`` covers all actuators of one unit or of mixed units."""
        sets = {"train": self.problem.experiments, "validation": self.problem.validation}
        return {name: self._fit(data, self.predictions[name]) for name, data in sets.items() if data}

    def _fit(self, data: tuple[Experiment | StreamedExperiment, ...], predicted: list[Array]) -> dict[str, Fit]:
        moments = sum((e.moments(self.psi) if isinstance(e, StreamedExperiment) else _moments(e, p)
                       for e, p in zip(data, predicted, strict=True)), np.zeros((5, len(self.sigma))))
        units = self.problem.model.force_units
        table = {actuator.name: _fit_of(moments[:, k], units[k])
                 for k, actuator in enumerate(self.problem.model.machine.actuators)}
        if len(set(units)) == 1:
            return table | {"all": _fit_of(moments.sum(axis=1), units[0])}
        # channels of different units are compared in units of their own noise
        scaled = moments / np.array([0 * self.sigma + 1, self.sigma, self.sigma**2, self.sigma, self.sigma**2])
        return table | {"all": _fit_of(scaled.sum(axis=1), "sigma")}

    @cached_property
    def consistency(self) -> dict[str, float]:
        """Smallest eigenvalue of each body's pseudo-inertia at ψ; negative: no such body exists."""
        names = bodies(self.problem.model.machine, actuator_inertia=self.problem.model.actuator_inertia)
        at = {owner: self.problem.parameters.index(f"{owner}.m") for owner in names}
        return {owner: inertia.smallest_eigenvalue(self.psi[k : k + 10]) for owner, k in at.items()}

    def identifiability(self, k: int) -> str:
        """``full``, ``combination``, ``none``, or ``not excited`` if only this motion is to blame."""
        seen, possible = self.seen.category[k], self.structure.category[k]
        return "not excited" if (possible, seen) in (("full", "combination"), ("full", "none"), ("combination", "none")
                                                     ) else seen

    def __str__(self) -> str:
        lines = [f"{self.problem.model.machine.name} by {self.method}: {self.status}"]
        for name, table in self.fit.items():
            for channel, fit in table.items():
                lines.append(f"  {name:<10} {channel:<18} RMS {fit.rms:10.4g} {fit.unit:<5} "
                             f"relative {100 * fit.relative:6.2f} %  VAF {100 * fit.vaf:6.2f} %")
        return "\n".join(lines)


def _moments(data: Experiment, predicted: Array) -> Array:
    """Sums (5, n) over the samples that take part: 1, force, force², error and error²."""
    force = data.force[data.inside]
    error = force - predicted[data.inside]
    return np.array([x.sum(axis=0) for x in (np.ones_like(force), force, force**2, error, error**2)])


def _fit_of(moments: Array, unit: str) -> Fit:
    count, force, squared, error, error_squared = moments
    rms, size = float(np.sqrt(error_squared / count)), float(np.sqrt(squared / count))
    spread = squared - force**2 / count
    vaf = 1 - float((error_squared - error**2 / count) / spread) if spread > 1e-15 * squared else float("nan")
    return Fit(rms, vaf, rms / size if size else float("inf"), unit)
