"""The exchange algorithm of pose planning: the poses with the most information about the geometry.

Of many random closed postures those are chosen that are best by one of the criteria that also serve motions: D, A or E
of the covariance of all parameters or of those in focus, or the condition number. All stages share their parameters and
are chosen together. Directions that no posture identifies (ball.y with the locked swing of the CAT 215B) are projected
out. All postures keep the reserves of the machine's limits. Section 5.3 of the thesis leaves pose planning open.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import ProblemError
from hydroopt.estimation.kinematic.observability import SHARE, Linearised, Observability, observability
from hydroopt.estimation.kinematic.problem import CalibrationProblem
from hydroopt.excitation.poses.order import in_passes, in_safe_order
from hydroopt.excitation.poses.plan import PosePlan
from hydroopt.excitation.poses.problem import PoseGroup, PoseProblem, linearised, measured_along
from hydroopt.limits.postures import LeftOut, PostureLimits
from hydroopt.model.closed_chain import KinematicModel
from hydroopt.progress import Progress, silent
from hydroopt.simulation import postures
from hydroopt.spatial.inertia import Array

FAINT_INFORMATION = 1e-6
"""Prior information, in units of the information of an average pose: makes every determinant positive."""
HELPS = 1e-9
"""Relative gain of the criterion from which on an exchange of two poses helps."""
PROMISING = 64
"""Candidates whose eigenvalues are computed."""
TRIES, RARE = 30, 200
"""Random postures of which at least one must close within its limits; of those that close one must keep the reserves.
"""
DRAWN, CHOSEN, EXCHANGED = 0.4, 0.6, 0.95
"""Parts of the work that are done once postures are drawn, once the first poses are chosen, and once none is exchanged.
"""
PASSES = (2, 3, 4, 6, 8)
"""Ways there or back that are tried where locked joints drift."""
BATCH = 500
"""Random postures tried at once, at least."""


def fedorov_exchange(problem: PoseProblem, *, candidates: int = 2000, seed: int = 0,
                     progress: Progress = silent) -> PosePlan:
    """Choose poses: a greedy start, then exchanges of single poses until none helps. No posture is chosen twice.

    The exchanges are those of Fedorov (1972), in the order of Cook and Nachtsheim (1980).

    Args:
        problem: how many poses of which groups, by which criterion.
        candidates: random postures of each group to choose from.
        seed: of the random postures.
        progress: receives the steps, see `hydroopt.progress`.

    Raises:
        ProblemError: no posture lies within the limits, a parameter in focus is not identifiable, or there are too few
            poses or candidates.
    """
    model, groups, count = problem.model, problem.groups, problem.count
    if count > candidates:
        raise ProblemError(f"{count} poses cannot be chosen from {candidates} candidates", where="pose plan",
                           remedy="ask for fewer poses or more candidates")
    rng = np.random.default_rng(seed)
    drawn, left_out = [], LeftOut()
    for k, group in enumerate(groups):
        progress(f"drawing postures for {group}", DRAWN * k / len(groups))
        postures_of_group, out = candidate_postures(problem, group, candidates, rng)
        drawn.append(postures_of_group)
        left_out = left_out.with_more(out)
    found = np.array(drawn)
    chosen, log_det = best_poses(problem, found, progress)
    progress("finding the order of measuring", EXCHANGED)
    labels = problem.labels(count)
    q, log_det = ordered(problem, found[chosen], log_det)
    return PosePlan(problem, candidates, seed, labels, q, lengths(model, q),
                    observability(*linearised(problem, q, labels)), log_det, left_out)


def best_poses(problem: PoseProblem, found: Array, progress: Progress = silent,
               units: Mapping[str, float] | None = None) -> tuple[NDArray[np.bool_], float]:
    """Which of the closed postures (G, C, n) of each group to measure, (G, C), in their order; and the logarithm of the
    determinant of the scaled information.

    `units` are those [SI] in which the criterion counts parameters in focus; by default their scales.
    """
    count = found.shape[1]
    design = _Design(*linearised(problem, np.concatenate(found), problem.labels(count)), problem.criterion,
                     problem.focus, len(problem.groups), units)
    chosen = design.best(problem.count, progress)
    return chosen, design.log_det(chosen)


def ordered(problem: PoseProblem, q: Array, log_det: float,
            units: Mapping[str, float] | None = None) -> tuple[Array, float]:
    """Chosen postures (G·count, n) in a better order of measuring, and the logarithm of the determinant, given that of
    the present order.

    Where locked joints drift, they are driven through there and back as often as serves the criterion best. Elsewhere
    as few straight moves as possible use a reserve.
    """
    groups = np.reshape(q, (len(problem.groups), -1, q.shape[1]))
    drifting = [k for k, group in enumerate(problem.groups) if group.drift]
    first = [measured_along(problem.model, group) for group in problem.groups]
    best = groups.copy()
    for k, group in enumerate(problem.groups):
        if not group.drift:
            best[k] = groups[k][in_safe_order(problem.limits, group, groups[k])]
    if drifting:
        labels, tried = problem.labels(groups.shape[1]), []
        for count in PASSES:
            for k in drifting:
                best[k] = groups[k][in_passes(groups[k][:, first[k]], count)]
            design = _Design(*linearised(problem, np.concatenate(best), labels), problem.criterion, problem.focus,
                             len(groups), units)
            whole = np.ones(groups.shape[:2], dtype=bool)
            tried.append((design.value(whole), design.log_det(whole), best.copy()))
        _, log_det, best = min(tried, key=lambda each: each[0])
    return np.concatenate(best), log_det


def lengths(model: KinematicModel, q: Array) -> Array:
    """(N, c) of all cylinders [m]."""
    return model.over(model.lengths, model.parameters.nominal, q)[0][:, :, 0]


def candidate_postures(problem: PoseProblem, group: PoseGroup, count: int,
                       rng: np.random.Generator) -> tuple[Array, LeftOut]:
    """Random closed postures (count, n) within all limits and their reserves, in the order of measuring, and how many
    reserves have left out.

    They stay away from the ends of strokes as far as the uncertain geometry may shift these, so that the machine
    reaches them.

    That order is that of `measured_along`, so that there is little driving. Where locked joints drift, every second
    posture waits for the way back: otherwise drift and moving joint could not be separated.

    Raises:
        ProblemError: too few postures close, or keep the reserves.
    """
    model, sieve = problem.model, Sieve(problem.limits, group)
    sigma = np.where([name in problem.fixed for name in model.parameters.names], 0.0, model.parameters.scale)
    moving = [model.joints.index(joint) for joint in dict.fromkeys((*group.moves, *model.machine.base_joints))
              if joint not in group.locked]
    held = {model.joints.index(joint) for joint in group.locked}
    turning = [k for k in postures.read_joints(model) if k not in held and k not in moving]
    if group.touch:  # the machine itself drives there
        turning += [model.joints.index(joint) for joint in group.moves]
    fixture = next((each for each in model.machine.fixtures if each.name == group.fixture), None)
    batch = max(count, BATCH)
    found, tried = postures.closed_postures(
        model, count, rng, geometry=model.parameters.nominal, turning=turning, within_limits=turning + moving,
        locked=group.locked, fixture=fixture, touch=group.touch, within_strokes=sigma, batch=batch,
        sieve=sieve, give_up=lambda found, tried: tried > 3 * batch and (
            sieve.left_out.drawn * TRIES < tried or found * RARE < sieve.left_out.drawn))
    if len(found) < count and len(found) * RARE < sieve.left_out.drawn:
        raise ProblemError(f"only {len(found)} of {sieve.left_out.drawn} random postures that close keep the reserves; "
                           f"left out by {sieve.left_out.limits}", where=f"{group}",
                           remedy="lock joints elsewhere, or move the fixture or the machine, or keep smaller reserves "
                           "with --reserve")
    if len(found) < count:
        raise ProblemError(f"only {len(found)} of {tried} random postures close within their limits",
                           where=f"{group}", remedy="move the fixture, widen limits and strokes, or lock joints "
                           "elsewhere")
    order = in_passes(found[:, measured_along(model, group)], 2 if group.drift else 1)
    return np.asarray(found[order]), sieve.left_out


class Sieve:
    """Lets postures of a group pass that keep the reserves, passive joints hanging, and counts the others."""

    def __init__(self, limits: PostureLimits, group: PoseGroup) -> None:
        self.limits = limits.while_resting((*group.locked, *limits.machine.base_joints))
        self.left_out = LeftOut()
        self.held, self.closed = group.held(limits.machine), group.closed(limits.machine)

    def __call__(self, q: Array, geometry: Array) -> Array:
        """Of postures (N, n) those (K, n) that keep them."""
        if not len(q):
            return q
        q = q if self.closed else self.limits.hung(q)
        broken = self.limits.broken(q, held=self.held, closed=self.closed, geometry=geometry)
        out = np.any([*broken.values(), np.zeros(len(q), dtype=bool)], axis=0)
        counts = {name: int(np.sum(each)) for name, each in broken.items() if np.any(each)}
        self.left_out = self.left_out.with_more(LeftOut(len(q), int(np.sum(out)), counts))
        return np.asarray(q[~out])


class _Design:
    """The information of the candidates, in coordinates w (r,) of the identifiable directions.

    They are chosen so that an average candidate has the same information in every direction.

    Attributes:
        rows: (G, C, m, r) whitened Jacobians of C candidates in each of G groups; `rank` (G,) independent rows of one.
        prior: (r, r) information of known distances and priors, and a faint one of everything; `open` is the number of
            directions that need poses.
        focus: (s, r) parameters in focus by w, in units of their scales; none for the D criterion of all.
    """

    def __init__(self, problem: CalibrationProblem, linear: Linearised, criterion: str, focus: Sequence[str],
                 groups: int, units: Mapping[str, float] | None = None) -> None:
        self.criterion = criterion
        free = np.flatnonzero(problem.free)
        if not np.any(linear.jacobian[:, :, free]):
            raise ProblemError("no pose identifies any of the free parameters", where="pose plan",
                               remedy="fix fewer, or state the confidence of lengths and angles in the machine file")
        data = observability(problem, linear)
        # poses need not identify what priors determine
        total = Observability(data.names, data.scale, data.information + data.prior, 0 * data.prior)
        hidden = total.null_space.shape[1]
        basis = data.scale[:, None] * np.linalg.qr(total.null_space, mode="complete")[0][:, hidden:]
        factor = np.linalg.cholesky(basis.T @ total.information @ basis / len(linear.rank))
        self.offset = 2 * float(np.log(np.diag(factor)).sum())
        to_w = basis @ np.linalg.inv(factor).T
        # only as many rows as a pose has independent ones
        _, size, turned = np.linalg.svd(linear.jacobian[:, :, free] @ to_w, full_matrices=False)
        rows = (size[:, :, None] * turned)[:, : linear.rank.max()]
        shared = linear.shared[:, free] @ to_w
        self.rows: Array = rows.reshape(groups, -1, *rows.shape[1:])
        self.rank = linear.rank.reshape(groups, -1).max(axis=1)
        self.prior = shared.T @ shared + FAINT_INFORMATION * np.eye(len(factor))
        self.open = len(factor) - (int(np.linalg.matrix_rank(shared)) if len(shared) else 0)
        places = _places(problem, total, focus)
        unit = data.scale[places] if units is None else np.array([units[name] for name in focus])
        self.focus = to_w[places] / unit[:, None]
        if not focus and criterion != "D":
            self.focus = np.linalg.inv(factor).T

    def information(self, chosen: NDArray[np.bool_]) -> Array:
        """(r, r) of chosen candidates (G, C) and the prior."""
        rows = self.rows[chosen].reshape(-1, len(self.prior))
        return np.asarray(self.prior + rows.T @ rows)

    def log_det(self, chosen: NDArray[np.bool_]) -> float:
        """Of the scaled information."""
        return float(np.linalg.slogdet(self.information(chosen))[1]) + self.offset

    def value(self, chosen: NDArray[np.bool_]) -> float:
        """The criterion of chosen candidates (G, C); less is better."""
        if not len(self.focus):
            return -self.log_det(chosen)
        size = np.linalg.eigvalsh(self.focus @ np.linalg.solve(self.information(chosen), self.focus.T))
        match self.criterion:
            case "A":
                return float(np.sum(size))
            case "D":
                return float(np.sum(np.log(np.maximum(size, 1e-300))))
        return float(size[-1] / (max(size[0], 1e-300) if self.criterion == "condition" else 1.0))

    def score(self, information: Array, group: int, pose: int = 0) -> Array:
        """Criterion (C,), up to a constant, after each candidate of a group is added to an information (r, r).

        It is −∞ for those that improve the worst direction little, except `pose`.
        """
        rows, inverse = self.rows[group], np.linalg.inv(information)
        spread = rows @ inverse
        core = np.eye(rows.shape[1]) + spread @ rows.transpose(0, 2, 1)
        if not len(self.focus):
            return np.asarray(np.linalg.slogdet(core)[1])
        across = spread @ self.focus.T
        covariance = self.focus @ inverse @ self.focus.T
        after = covariance - across.transpose(0, 2, 1) @ np.linalg.solve(core, across)
        match self.criterion:
            case "A":
                return np.asarray(-np.log(np.trace(after, axis1=1, axis2=2)))
            case "D":
                return np.asarray(-np.linalg.slogdet(after)[1])
        # eigenvalues take long: only of those that improve the worst direction most
        worst = np.linalg.eigh(covariance)[1][:, -1]
        promising = np.append(np.argsort((after @ worst) @ worst)[:PROMISING], pose)
        values = np.maximum(np.linalg.eigvalsh(after[promising]), 1e-300)
        score = np.full(len(rows), -np.inf)
        score[promising] = -np.log(values[:, -1] / (values[:, 0] if self.criterion == "condition" else 1.0))
        return score

    def best(self, count: int, progress: Progress) -> NDArray[np.bool_]:
        """The chosen candidates (G, C), `count` of each group."""
        if count * self.rank.sum() < self.open:
            raise ProblemError(f"{count} poses of each stage have {count * self.rank.sum()} rows for {self.open} "
                               "parameters", where="pose plan",
                               remedy=f"ask for {-(-self.open // self.rank.sum())} poses or more, or fix parameters")
        chosen = np.zeros(self.rows.shape[:2], dtype=bool)
        for k in range(count):
            progress(f"choosing pose {k + 1} of {count}", DRAWN + (CHOSEN - DRAWN) * k / count)
            for group, taken in enumerate(chosen):
                score = self.score(self.information(chosen), group)
                taken[np.argmax(np.where(taken, -np.inf, score))] = True
        progress("exchanging poses until none helps", CHOSEN)
        helped = True
        while helped:
            helped = False
            for group, taken in enumerate(chosen):
                for pose in np.flatnonzero(taken):
                    taken[pose] = False
                    score = np.where(taken, -np.inf, self.score(self.information(chosen), group, int(pose)))
                    better = np.max(score) > score[pose] + HELPS
                    taken[np.argmax(score) if better else pose] = True
                    helped |= bool(better)
        if np.linalg.eigvalsh(self.information(chosen))[0] < 2 * FAINT_INFORMATION:
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
