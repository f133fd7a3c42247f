"""The exchange algorithm of pose planning: the poses with the most information about the geometry.

Of many random closed postures those are chosen that are best by one of the criteria that also serve motions: D, A or E
of the covariance of all parameters or of those in focus, or the condition number. All stages share their parameters and
are chosen together. Directions that no posture identifies (ball.y with the locked swing of the CAT 215B) are projected
out. All postures keep the reserves of the machine's limits. Section 5.3 of the thesis leaves pose planning open.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import ProblemError
from hydroopt.estimation.kinematic.observability import SHARE, Observability, observability
from hydroopt.estimation.kinematic.problem import CalibrationProblem
from hydroopt.excitation.criteria import FAINT, scores
from hydroopt.excitation.selection.candidate_postures import in_passes, in_safe_order, random_candidates
from hydroopt.excitation.selection.pose_plan import PosePlan
from hydroopt.excitation.selection.pose_problem import PoseProblem, Postures, measured_along
from hydroopt.spatial.inertia import Array
from hydroopt.support.progress import Progress, silent

HELPS = 1e-6
"""Relative gain of the criterion from which on an exchange helps."""
PASSES = (2, 3, 4, 6, 8)
"""Ways there or back that are tried where locked joints drift."""


Chosen = NDArray[np.bool_]
"""Which candidates are taken: (G, C) of C postures in each of G groups, or (N, R) of R readings in N postures."""


def exchanged(chosen: Chosen, removable: Callable[[Chosen], Iterable[NDArray[np.intp]]],
              refilled: Callable[[Chosen, NDArray[np.intp]], Chosen | None]) -> Chosen:
    """A choice in which no exchange helps: a few candidates after another are taken away, and others put in their
    place, over and over again.

    Args:
        chosen: to begin with: candidates that were the best ones one after another.
        removable: the places of a few candidates each, in turn.
        refilled: a choice and such places -> the choice with others there; None where that is no better.
    """
    helped = True
    while helped:
        helped = False
        for some in removable(chosen):
            if (better := refilled(chosen, some)) is not None:
                chosen, helped = better, True
    return chosen


def fedorov_exchange(problem: PoseProblem, *, candidates: int = 2000, seed: int = 0,
                     progress: Progress = silent) -> PosePlan:
    """Choose poses: a greedy start, then exchanges of single poses until none helps. No posture is chosen twice.

    The exchanges are those of Fedorov (1972), in the order of Cook and Nachtsheim (1980).

    Args:
        problem: how many poses of which groups, by which criterion.
        candidates: random postures of each group to choose from.
        seed: of the random postures.
        progress: receives the steps, see `hydroopt.support.progress`.

    Raises:
        ProblemError: no posture lies within the limits, a parameter in focus is not identifiable, or there are too few
            poses or candidates.
    """
    if problem.count > candidates:
        raise ProblemError(f"{problem.count} poses cannot be chosen from {candidates} candidates", where="pose plan",
                           remedy="ask for fewer poses or more candidates")
    found, left_out = random_candidates(problem, candidates, np.random.default_rng(seed), progress)
    q = best_poses(problem, found.q.reshape(len(problem.groups), candidates, -1), progress)
    return PosePlan(Postures(problem, q), candidates, seed, left_out)


def best_poses(problem: PoseProblem, found: Array, progress: Progress = silent,
               units: Mapping[str, float] | None = None) -> Array:
    """The postures (G·count, n) to measure of the closed ones (G, C, n) of each group, in the order of measuring.

    Where locked joints drift, they are driven through there and back as often as serves the criterion best. Elsewhere
    as few straight moves as possible use a reserve. `units` are those [SI] in which the criterion counts parameters in
    focus; by default their scales.
    """
    chosen = _Design(problem, found, units).best(problem.count, progress)
    progress("finding the order of measuring", 0.95)
    groups = found[chosen].reshape(len(found), -1, found.shape[2])
    drifting = [k for k, group in enumerate(problem.groups) if group.drift]
    best = groups.copy()
    for k, group in enumerate(problem.groups):
        if not group.drift:
            best[k] = groups[k][in_safe_order(problem.limits, group, groups[k])]
    tried = []
    for count in PASSES if drifting else ():
        for k in drifting:
            along = measured_along(problem.model, problem.groups[k])
            best[k] = groups[k][in_passes(groups[k][:, along], count)]
        design = _Design(problem, best, units)
        tried.append((design.value(np.ones(best.shape[:2], dtype=bool)), best.copy()))
    return np.concatenate(min(tried, key=lambda each: each[0])[1] if tried else best)


class _Design:
    """The information of candidate postures (G, C, n), in coordinates w (r,) of the identifiable directions.

    They are chosen so that an average candidate has the same information in every direction.

    Attributes:
        rows: (G, C, m, r) whitened Jacobians of C candidates in each of G groups; `rank` (G,) independent rows of one.
        prior: (r, r) information of known distances and priors, and a faint one of everything; `open` is the number of
            directions that need poses.
        focus: (s, r) parameters in focus by w, in units of their scales; without a focus all identifiable directions.
    """

    def __init__(self, poses: PoseProblem, found: Array, units: Mapping[str, float] | None) -> None:
        problem, linear = Postures(poses, np.concatenate(found)).linearised()
        self.criterion, groups = poses.criterion, len(found)
        free = np.flatnonzero(problem.free)
        if not np.any(linear.jacobian[:, :, free]):
            raise ProblemError("no pose identifies any of the free parameters", where="pose plan",
                               remedy="fix fewer, or state the confidence of lengths and angles in the machine file")
        data = observability(problem, linear)
        total = data.priors_as_data  # poses need not identify what priors determine
        basis = total.identifiable
        factor = np.linalg.cholesky(basis.T @ total.information @ basis / len(linear.rank))
        to_w = basis @ np.linalg.inv(factor).T
        # only as many rows as a pose has independent ones
        _, size, turned = np.linalg.svd(linear.jacobian[:, :, free] @ to_w, full_matrices=False)
        rows = (size[:, :, None] * turned)[:, : linear.rank.max()]
        shared = linear.shared[:, free] @ to_w
        self.rows: Array = rows.reshape(groups, -1, *rows.shape[1:])
        self.rank = linear.rank.reshape(groups, -1).max(axis=1)
        self.prior = shared.T @ shared + FAINT * np.eye(len(factor))
        self.open = len(factor) - (int(np.linalg.matrix_rank(shared)) if len(shared) else 0)
        places = _places(problem, total, poses.focus)
        unit = data.scale[places] if units is None else np.array([units[name] for name in poses.focus])
        self.focus = to_w[places] / unit[:, None] if places else np.linalg.inv(factor).T

    def information(self, chosen: Chosen) -> Array:
        """(r, r) of chosen candidates (G, C) and the prior."""
        rows = self.rows[chosen].reshape(-1, len(self.prior))
        return np.asarray(self.prior + rows.T @ rows)

    def covariance(self, chosen: Chosen) -> Array:
        """(r, r) that they leave."""
        return np.asarray(np.linalg.inv(self.information(chosen)))

    def value(self, chosen: Chosen) -> float:
        """The criterion of chosen candidates (G, C); less is better."""
        nothing = np.zeros((1, *self.rows.shape[2:]))
        return -float(scores(self.criterion, nothing, self.covariance(chosen), self.focus)[0])

    def score(self, chosen: Chosen, group: int, pose: int = 0) -> Array:
        """(C,) of each candidate of a group after it is added to the chosen ones; −∞ if it is one of them. That of
        `pose` is exact, see `scores`."""
        found = scores(self.criterion, self.rows[group], self.covariance(chosen), self.focus, pose)
        return np.where(chosen[group], -np.inf, found)

    def refilled(self, chosen: Chosen, which: NDArray[np.intp]) -> Chosen | None:
        """The best candidate of its group in place of a chosen one (group, pose); None where that is itself."""
        group, pose = which.tolist()
        other = chosen.copy()
        other[group, pose] = False
        found = self.score(other, group, pose)
        other[group, np.argmax(found)] = True
        return other if np.max(found) > found[pose] + HELPS else None

    def best(self, count: int, progress: Progress) -> Chosen:
        """The chosen candidates (G, C), `count` of each group."""
        if count * self.rank.sum() < self.open:
            raise ProblemError(f"{count} poses of each stage have {count * self.rank.sum()} rows for {self.open} "
                               "parameters", where="pose plan",
                               remedy=f"ask for {-(-self.open // self.rank.sum())} poses or more, or fix parameters")
        chosen = np.zeros(self.rows.shape[:2], dtype=bool)
        for k in range(count):
            progress(f"choosing pose {k + 1} of {count}", 0.5 + 0.4 * k / count)
            for group, taken in enumerate(chosen):
                taken[np.argmax(self.score(chosen, group))] = True
        progress("exchanging poses until none helps", 0.9)
        chosen = exchanged(chosen, np.argwhere, self.refilled)
        if np.linalg.eigvalsh(self.information(chosen))[0] < 2 * FAINT:
            raise ProblemError(f"{count} poses of each stage do not identify all combinations that more poses would",
                               where="pose plan", remedy="ask for more poses, or fix parameters")
        return chosen


def _places(problem: CalibrationProblem, identifiability: Observability, focus: Sequence[str]) -> list[int]:
    """Positions of the parameters in focus among the free ones."""
    for name in focus:
        problem.parameters.index(name)
        if name not in identifiability.names:
            raise ProblemError("it is fixed", where=f"focus '{name}'", remedy="leave it out")
        if np.linalg.norm(identifiability.null_space[identifiability.names.index(name)]) > SHARE:
            together = next((", ".join(group) for group in identifiability.combinations if name in group), "")
            raise ProblemError("no pose identifies it", where=f"focus '{name}'",
                               remedy=f"fix one of {together}" if together else "leave it out")
    return [identifiability.names.index(name) for name in focus]
