"""The solution of a kinematic calibration: parameters with uncertainty, joint vectors, fit, suspects, machine."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import HydrooptError
from hydroopt.estimation.inference.band_variances import NORMAL
from hydroopt.estimation.inference.certificate import AT_BOUND
from hydroopt.estimation.kinematic.link_by_link import StageResult
from hydroopt.estimation.kinematic.observability import Linearised, Observability
from hydroopt.estimation.kinematic.pose_faults import Suspect
from hydroopt.estimation.kinematic.problem import CalibrationProblem
from hydroopt.machine.calibrated_numbers import with_calibrated
from hydroopt.machine.joint_limits import NarrowedLimits, within_strokes
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import dump_machine, read_machine
from hydroopt.results.fit import Fit
from hydroopt.results.tables import number
from hydroopt.spatial.inertia import Array

SAME = 0.1
"""Distance in standard deviations within which two solutions are the same."""


@dataclass(frozen=True)
class Uniqueness:
    """What is known about other solutions.

    Attributes:
        null_directions: combinations that neither data nor priors determine.
        starts: initial guesses solved from.
        same: how many of them lead to the same solution, `failed` to none, and `worse` to one with larger cost.
        next_cost: cost of the best worse solution above that of the solution; NaN where there is none.
    """

    null_directions: int
    starts: int
    same: int
    failed: int = 0
    worse: int = 0
    next_cost: float = float("nan")

    @property
    def examined(self) -> bool:
        """Whether there was more than one initial guess."""
        return self.starts > 1

    def __str__(self) -> str:
        if self.null_directions:
            return f"not unique, {self.null_directions} combinations are not identifiable"
        if not self.examined:
            return "not examined, solved from one initial guess"
        parts = [f"{self.same} of {self.starts} initial guesses lead to the same solution"]
        parts += [f"{self.failed} to none"] * bool(self.failed)
        parts += [f"{self.worse} to worse ones (the next by {self.next_cost:.3g} in squared errors)"] * bool(self.worse)
        return ", ".join(parts)

    def as_dict(self) -> dict[str, Any]:
        """The entry of a JSON file."""
        return {"null_directions": self.null_directions, "starts": self.starts, "same": self.same,
                "failed": self.failed, "worse": self.worse, "next_cost": number(self.next_cost), "text": str(self)}


def uniqueness(observability: Observability, solutions: list[tuple[float, Array]], failed: int,
               free: NDArray[np.bool_]) -> Uniqueness:
    """Compare solutions, each cost and parameters (P,), the best first, in units of the best one's standard deviations.

    Args:
        observability: at the best solution.
        solutions: one for each initial guess that led to one.
        failed: how many led to none.
        free: (P,) which parameters are estimated.
    """
    null = 0 if np.any(observability.prior) else int(observability.null_space.shape[1])
    std = np.where(np.isfinite(observability.std), observability.std, np.inf)
    least, best = solutions[0]
    same = [bool(np.all(np.abs(theta - best)[free] < SAME * std)) for _, theta in solutions]
    other = [cost - least for (cost, _), equal in zip(solutions, same, strict=True) if not equal]
    return Uniqueness(null, len(solutions) + failed, sum(same), failed, len(other), min(other, default=float("nan")))


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
        near = AT_BOUND * parameters.scale
        bound: NDArray[np.bool_] = (self.theta < parameters.lower + near) | (self.theta > parameters.upper - near)
        return bound & self.problem.free

    @property
    def ci95(self) -> Array:
        """(P, 2) intervals."""
        return np.asarray(self.theta[:, None] + NORMAL * self.std[:, None] * np.array([-1.0, 1.0]))

    @cached_property
    def written(self) -> CalibratedMachine:
        """The calibrated machine and its file."""
        return _calibrated_machine(self)

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


class WidenedLimits(NamedTuple):
    """Limits (lower, upper) [rad, m] of a joint before, and after poses that lie beyond them."""

    joint: str
    before: tuple[float, float]
    after: tuple[float, float]


class CalibratedMachine(NamedTuple):
    """The machine with the calibrated geometry, and joint limits that gave way, to strokes and to poses. Without a
    machine the `reason` why none can have this geometry."""

    machine: Machine | None = None
    reason: str = ""
    narrowed: tuple[NarrowedLimits, ...] = ()
    widened: tuple[WidenedLimits, ...] = ()


def _calibrated_machine(solution: KinematicSolution) -> CalibratedMachine:
    """The machine with the calibrated geometry and its confidences.

    Joint limits beyond the ends of a stroke give way to it, and those short of poses to these, since limits are often
    assumed or rounded. Angles of locked joints belong to the poses and are not written, nor is a number of a
    combination alone: it is arbitrary.
    """
    problem = solution.problem
    machine, widened, found = problem.model.machine, tuple(_widened(solution)), {}
    for k, name in enumerate(problem.parameters.names):
        std, category = float(solution.std[k]), solution.category(name)
        if solution.at_bound[k] or category == "full" or (category == "combination" and np.isfinite(std)):
            found[name] = float(solution.theta[k]), std
    try:
        reached = machine.with_joint_limits({each.joint: each.after for each in widened}) if widened else machine
        made, narrowed = within_strokes(with_calibrated(
            reached, found, f"calibrated by {solution.algorithm} from {problem.poses.name}", problem.fixed))
        read_machine(dump_machine(made), where="the calibrated machine")
    except (HydrooptError, ValueError) as error:
        return CalibratedMachine(reason=str(error).splitlines()[0])
    return CalibratedMachine(made, "", narrowed, widened)


def _widened(solution: KinematicSolution) -> Iterator[WidenedLimits]:
    """Limits of the machine's joints that poses exceed, without the poses that contradict the others."""
    problem = solution.problem
    for link in problem.model.machine.links:
        if link.name not in problem.model.joints or link.joint.type == "locked":
            continue
        k = problem.model.joints.index(link.name)
        angles = solution.q[problem.layout.sensed[:, k] & ~solution.suspicious, k]
        lower, upper = link.joint.range
        after = min(lower, float(np.min(angles, initial=lower))), max(upper, float(np.max(angles, initial=upper)))
        if after != (lower, upper):
            yield WidenedLimits(link.name, (lower, upper), after)
