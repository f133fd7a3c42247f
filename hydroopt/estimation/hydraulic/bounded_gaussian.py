"""A Gaussian distribution of parameters within bounds: intervals, and what the data do not determine."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import truncnorm

from hydroopt.parameters.parameter_set import ParameterSet
from hydroopt.spatial.inertia import Array

UNKNOWN = 0.5
"""Part of the prior's information below which the data's counts as telling less than the prior."""
SHARE = 0.3
"""Component of a direction from which on a parameter belongs to it."""


class WeakDirection(NamedTuple):
    """A direction of the parameters on which the data carry little information.

    Attributes:
        direction: (p,) change of the parameters, as long as one standard deviation of their priors.
        members: positions of the parameters that belong to it, the largest component first.
        information: of the data on it, 1 where they carry as much as the prior.
    """

    direction: Array
    members: NDArray[np.intp]
    information: float


@dataclass(frozen=True, eq=False)
class BoundedGaussian:
    """The most probable parameters and how probability falls around them.

    Attributes:
        parameters: with priors and bounds.
        theta: (p,) most probable values.
        data: (p, p) information of the data on them.
        gradient: (p,) of half the squared errors, priors included: zero but where a bound holds.
        residual_scale: root of the squared errors over the degrees of freedom; 1 where the stated σ are right.
    """

    parameters: ParameterSet
    theta: Array
    data: Array
    gradient: Array
    residual_scale: float

    def __getitem__(self, name: str) -> float:
        """Value of a parameter."""
        return float(self.theta[self.parameters.index(name)])

    @cached_property
    def covariance(self) -> Array:
        """(p, p), infinite variances where neither data nor priors inform; widened where residuals exceed σ."""
        scale = self.parameters.scale
        values, vectors = np.linalg.eigh((self.data + self.parameters.information) * np.outer(scale, scale))
        informed = values > 1e-12 * max(float(values[-1]), 1e-300)
        root = vectors[:, informed] / np.sqrt(values[informed])
        covariance = root @ root.T * max(1.0, self.residual_scale) ** 2 * np.outer(scale, scale)
        undetermined = np.linalg.norm(vectors[:, ~informed], axis=1) > 1e-5
        covariance[undetermined, :] = covariance[:, undetermined] = 0.0
        covariance[undetermined, undetermined] = np.inf
        return np.asarray(covariance)

    @property
    def at_bound(self) -> NDArray[np.bool_]:
        """(p,) which parameters are held back by a bound, where a symmetric interval would be wrong."""
        parameters, near = self.parameters, 1e-6 * self.parameters.scale
        return np.asarray((self.theta < parameters.lower + near) | (self.theta > parameters.upper - near))

    @cached_property
    def std(self) -> Array:
        """(p,) standard deviations; NaN at a bound and where neither data nor priors inform."""
        std = np.sqrt(np.diag(self.covariance))
        return np.where(np.isfinite(std) & ~self.at_bound, std, np.nan)

    @cached_property
    def ci95(self) -> Array:
        """(p, 2) intervals of the Gaussian within the bounds; from a bound on where it holds a parameter.

        There the Gaussian's middle lies beyond the bound, as far as a step without bounds would lead.
        """
        parameters, std = self.parameters, np.sqrt(np.diag(self.covariance))
        inner = np.where(np.isfinite(std)[:, None] & np.isfinite(std), self.covariance, 0.0)
        middle = np.where(self.at_bound, self.theta - inner @ self.gradient, self.theta)
        low, high = (parameters.lower - middle) / std, (parameters.upper - middle) / std
        part = np.where(self.at_bound, np.where(self.gradient > 0, 0.0, 0.05), 0.025)
        interval = middle[:, None] + std[:, None] * truncnorm.ppf(
            np.column_stack([part, part + 0.95]), low[:, None], high[:, None])
        return np.where(np.isfinite(std)[:, None], interval, np.nan)

    @cached_property
    def weak_directions(self) -> tuple[WeakDirection, ...]:
        """Directions on which the data carry less information than `UNKNOWN`."""
        parameters = self.parameters
        prior = np.sqrt(np.diag(parameters.information))
        size = np.maximum(np.abs(self.theta), parameters.scale)
        unit = np.where(prior > 0, 1 / np.where(prior > 0, prior, 1.0), size)
        values, vectors = np.linalg.eigh(self.data * np.outer(unit, unit))
        found = []
        for k in np.flatnonzero(values < UNKNOWN):
            weight = np.abs(vectors[:, k])
            belong = np.flatnonzero(weight > SHARE * np.max(weight))
            found.append(WeakDirection(vectors[:, k] * unit, belong[np.argsort(-weight[belong])], float(values[k])))
        return tuple(found)

    def category(self, name: str) -> str:
        """``full``, ``combination`` or ``none``, by the data alone."""
        k = self.parameters.index(name)
        sizes = [len(each.members) for each in self.weak_directions if k in each.members]
        return "full" if not sizes else "none" if min(sizes) == 1 else "combination"
