"""The solution of a kinematic calibration: parameters with uncertainty, joint vectors, fit and suspects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hydroopt.estimation.kinematic.observability import Linearised, Observability
from hydroopt.estimation.kinematic.problem import CalibrationProblem
from hydroopt.estimation.kinematic.stage_result import StageResult
from hydroopt.estimation.kinematic.suspect import Suspect
from hydroopt.estimation.kinematic.uniqueness import Uniqueness
from hydroopt.results.fit import Fit
from hydroopt.spatial.inertia import Array

JOINT, HIERARCHICAL = "joint", "hierarchical"
METHODS = (JOINT, HIERARCHICAL)

CORRELATED = 0.95
"""Correlation from which on two estimates count as hardly separated."""


@dataclass(frozen=True, eq=False, repr=False)
class KinematicSolution:
    """A solved kinematic calibration.

    Attributes:
        problem: what was solved.
        algorithm: one of `METHODS`.
        theta: (P,) all parameters [SI]; `q` (N, n) joint vectors of the poses [rad, m].
        observability: which of the free parameters the data identify, and how well.
        linearised: the rows about the solution.
        noise_scale: root of the squared errors over the degrees of freedom; 1 where the stated σ are right. Intervals
            are widened by it where it is larger than 1, never narrowed.
        fits: by ``nominal``, ``train`` and ``validation``, then by channel: RMS and VAF (Eq. 3.44-3.46).
        suspects: joints, stages and poses that contradict the rest.
        uniqueness: what solving from several initial guesses showed.
        seed: of these, and of the postures that stand for the workspace.
        stages: what each stage gave by the method ``hierarchical``, with its iterations and truncation.
    """

    problem: CalibrationProblem
    algorithm: str
    theta: Array
    q: Array
    observability: Observability
    linearised: Linearised
    noise_scale: float
    fits: Mapping[str, Mapping[str, Fit]]
    suspects: tuple[Suspect, ...]
    uniqueness: Uniqueness
    seed: int = 0
    stages: tuple[StageResult, ...] = ()

    @cached_property
    def std(self) -> Array:
        """(P,) standard deviations; NaN where neither data nor priors determine a value, at a bound, or if it is held.

        All are NaN for the link-by-link method, which weighs nothing and whose errors add up from stage to stage.
        """
        std = np.full(len(self.theta), np.nan)
        if self.algorithm != JOINT:
            return std
        std[self.problem.free] = self.observability.std * max(1.0, self.noise_scale)
        std[~np.isfinite(std) | self.at_bound] = np.nan
        return std

    @cached_property
    def determined(self) -> NDArray[np.bool_]:
        """(P,) which parameters have a value: data, priors or the user determine it."""
        determined = np.ones(len(self.theta), dtype=bool)
        determined[self.problem.free] = np.isfinite(np.diag(self.observability.covariance))
        return determined

    @property
    def at_bound(self) -> NDArray[np.bool_]:
        """(P,) which parameters are held back by a bound, where a symmetric interval would be wrong."""
        parameters = self.problem.parameters
        near = 1e-6 * parameters.scale
        bound: NDArray[np.bool_] = (self.theta < parameters.lower + near) | (self.theta > parameters.upper - near)
        return bound & self.problem.free

    @property
    def ci95(self) -> Array:
        """(P, 2) intervals."""
        return np.asarray(self.theta[:, None] + 1.959964 * self.std[:, None] * np.array([-1.0, 1.0]))

    def category(self, name: str) -> str:
        """``full``, ``combination`` or ``none`` by the data alone, or ``fixed``."""
        if name in self.problem.fixed:
            return "fixed"
        return self.observability.category[self.observability.names.index(name)]

    @cached_property
    def suspicious(self) -> NDArray[np.bool_]:
        """(N,) training poses that contradict the others: those of suspects that can be left out."""
        named = [suspect.poses for suspect in self.suspects if suspect.kind.is_poses]
        return np.any(named, axis=0) if named else np.zeros(len(self.problem.poses), dtype=bool)

    @cached_property
    def combinations(self) -> tuple[tuple[str, ...], ...]:
        """Groups of parameters that the poses identify only together, without stages that were left out."""
        gone = self.without_poses
        return tuple(group for group in self.observability.combinations if not gone.issuperset(group))

    @cached_property
    def without_poses(self) -> frozenset[str]:
        """Parameters of stages that were left out."""
        problem = self.problem
        there = {*range(len(problem.model.parameters)), *problem.layout.place.ravel().tolist(),
                 *problem.layout.locked[1].tolist()}
        return frozenset(name for k, name in enumerate(problem.parameters.names) if k not in there)

    @cached_property
    def correlations(self) -> dict[str, tuple[str, float]]:
        """For each free parameter the one with the strongest correlation to it, and that correlation."""
        found = {name: self.observability.strongest(k) for k, name in enumerate(self.observability.names)}
        return {name: pair for name, pair in found.items() if np.isfinite(pair[1])}

    @cached_property
    def correlated_pairs(self) -> dict[tuple[str, str], float]:
        """Pairs that are hardly separated, at least one of them geometry, with their correlations, strongest first."""
        geometry = self.problem.model.parameters.positions
        pairs = {(min(name, other), max(name, other)): r for name, (other, r) in self.correlations.items()
                 if abs(r) > CORRELATED and (name in geometry or other in geometry)}
        return dict(sorted(pairs.items(), key=lambda item: -abs(item[1])))
