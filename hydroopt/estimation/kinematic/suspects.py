"""Suspects: what contradicts the rest of the poses (Section 3.8.2), as alternatives with their evidence.

Every fault is an extension of the model by a few columns; its evidence is the drop of the squared errors that adding
them to the linearised problem brings, in units of the errors' variance (a Lagrange multiplier test: twice the gain of
the log-likelihood). A fault is stated if that gain is no chance, its size is beyond what the file states, all parts of
the poses agree on it, and it beats every other explanation clearly, each charged for its columns and for how many were
tried (Schwarz's criterion). Else all explanations that the data leave are named.
"""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import special  # `stats` takes longer to load than most calibrations

from hydroopt.estimation.kinematic.observability import Linearised, Observability
from hydroopt.estimation.kinematic.pose_faults import SHORTEST, Fault, Suspect, SuspectKind, faults
from hydroopt.estimation.kinematic.problem import CalibrationProblem
from hydroopt.spatial.inertia import Array

FALSE_ALARM = 1e-3
"""Probability that sound data raise one alarm of a kind."""
LARGER = 2.0
"""How many times the others' typical error a stage must show: smaller differences are the model's, not the stage's."""
WILDER = 1.5
"""How many times the errors' variance a pose's must be: tails of real errors are longer than a Gaussian's."""
STATED = 8.0
"""Degrees of freedom that the stated accuracy counts for in the errors' variance: few poses say little of it."""
MEDIAN = 0.64
"""Part of the degrees of freedom that a median keeps of those that a mean has: its efficiency."""
BLOCK = 0.5
"""Degrees of freedom of the poses that the median counts as one: of less, a median is hardly above zero."""
EXACT = 1e-3
"""Least variance of the errors, in units of the stated one, so that nothing is suspect without noise."""
TURNED = 0.05
"""Range of angles [rad] over the poses from which on a joint counts as turning."""
TILTED = 0.05
"""Sine of the angle between two axes below which they count as parallel."""
MARGIN = 9.2
"""Lead in the criterion from which on the data decide between two explanations: a likelihood ratio of 100."""
AGREE = 0.05
"""Chance of the amounts' spread over the parts of the poses, all faults together, above which the parts disagree."""
PARTS = 12
"""Parts of the poses that must agree on a fault."""
UNUSUAL = 6.0
"""How many usual sizes a fault may have."""
BLIND = 0.02
"""Part of a fault's columns that must be left beside the free parameters for it to be seen: of less, errors of second
order of the parameters' own change are larger."""
MANY = 0.25
"""Largest part of all poses, or of a stage or stretch, that can be wrong one by one; more are wrong together."""
DIM = 0.1
"""Part of a fault's columns that must be left for the data to decide: of less, errors of the linearisation decide."""
LINEAR = 0.06
"""Part of what is explained already that a further explanation must add: less may be an error of the linearisation."""
MOST = 8
"""Explanations that are looked for, one after another."""


def find_suspects(problem: CalibrationProblem, q: Array, linearised: Linearised,
                  identified: Observability) -> tuple[Suspect, ...]:
    """All suspects: the best explanation of the errors, then the best one of what it leaves, and so on."""
    misfit, found, wild = _Misfit(problem, linearised, identified), list[Suspect](), np.zeros(len(q), dtype=bool)
    if problem.loss != "squares":  # a robust answer knows wild poses, which least squares would follow
        variance = misfit.variance_of(linearised.pose_square)
        wild |= misfit.chance(linearised.pose_square, variance * WILDER) < FALSE_ALARM / len(q)
        misfit.set_aside(wild)
    candidates, explained = list(faults(problem, q, linearised)), 0.0
    for _ in range(MOST):
        tested = [each for fault in candidates if (each := misfit.tested(fault)) is not None]
        leading, variance = _leading(misfit, tested, len(candidates))
        if leading is not None and leading.drop < LINEAR * explained:
            leading = None
        score = -np.inf if leading is None else leading.score(variance, len(q))
        loose, loose_score = _noisy(problem, misfit, variance)
        single, single_score = _wild(misfit, variance, LINEAR * explained)
        if loose is not None and np.mean(single[loose.poses]) > MANY:
            loose_score = max(loose_score, single_score)
        if max(loose_score, single_score) > score:
            if loose is not None and loose_score >= single_score:
                found.append(loose)
                misfit.set_aside(loose.poses)
            else:
                wild |= single
                misfit.set_aside(single)
        elif leading is None:
            break
        else:
            if leading.beyond_stated:
                found.append(_suspect(problem, misfit, leading, tested, variance, len(candidates)))
                if any(rival.kind is SuspectKind.LACK for rival in found[-1].rivals):
                    break  # what else the model lacks would only be imitated by further faults
            explained += leading.drop
            misfit.explain(leading)
    square = misfit.square
    variance = misfit.variance_of(square)
    # also beside what was found later
    wild &= (misfit.chance(square, variance * WILDER) < FALSE_ALARM / len(q)) & (square > LINEAR * explained)
    return (*_one_plane(problem, q), *found, *_outliers(problem, square / variance, misfit.rank, wild))


class _Explanation(NamedTuple):
    """A fault's most probable amount (d,), the drop of squared errors that it brings, and its change (R,) of the rows.

    `visible` is the part of its columns that the free parameters cannot imitate.
    """

    fault: Fault
    amount: Array
    drop: float
    change: Array
    freedom: int
    visible: float

    @property
    def beyond_stated(self) -> bool:
        """Whether it is larger than what the machine file states."""
        return self.fault.change * self.fault.size(self.amount) > self.fault.least

    def score(self, variance: float, poses: int) -> float:
        """Gain of twice the log-likelihood beyond the cost of columns and of a beginning that is sought."""
        return self.drop / variance - (self.freedom + (self.fault.there is not None)) * float(np.log(poses))


class _Misfit:
    """Whitened residuals of all rows, without what the free parameters and faults found so far can explain.

    Attributes:
        rank: (N,) rows of each pose that tell anything.
        kept: (N,) poses that are not set aside.
        freedom: (N,) degrees of freedom of each pose's residual: its rank less what the free parameters follow of it.
    """

    def __init__(self, problem: CalibrationProblem, linearised: Linearised, identified: Observability) -> None:
        free = np.flatnonzero(problem.free)
        self.shape = linearised.residual.shape
        rows = linearised.jacobian[:, :, free].reshape(-1, len(free))
        stack = np.vstack([rows, linearised.shared[:, free]]) * identified.scale
        self.rank, self.kept = np.maximum(linearised.rank, 1), np.ones(self.shape[0], dtype=bool)
        self._stack = stack
        self._raw = np.concatenate([linearised.residual.ravel(), linearised.shared_residual])
        self._project()

    def _project(self) -> None:
        shared = len(self._raw) - self.shape[0] * self.shape[1]
        rows = np.concatenate([np.repeat(self.kept, self.shape[1]), np.ones(shared, bool)])
        basis, s, _ = np.linalg.svd(self._stack * rows[:, None], full_matrices=False)
        self.basis = basis[:, s > 1e-9 * s[0]] if s.size else basis
        self.rows = rows
        self.residual = self._across(self._raw * rows)
        leverage = np.sum(self.basis[: self.kept.size * self.shape[1]] ** 2, axis=1).reshape(self.shape).sum(axis=1)
        self.freedom = np.where(self.kept, np.maximum(self.rank - leverage, 0.0), self.rank)

    def _across(self, column: Array) -> Array:
        return np.asarray(column - self.basis @ (self.basis.T @ column))

    @property
    def square(self) -> Array:
        """(N,) squared error of each pose; of one that is set aside, as the others predict it."""
        inside = self.residual[: self.shape[0] * self.shape[1]].reshape(self.shape)
        square = np.sum(inside**2, axis=1)
        if not np.all(self.kept):
            rows = self._stack[self.rows]
            amounts = np.linalg.lstsq(rows, self._raw[self.rows], rcond=1e-9)[0]
            left = (self._raw - self._stack @ amounts)[: inside.size].reshape(self.shape)
            square = np.where(self.kept, square, np.sum(left**2, axis=1))
        return np.asarray(square)

    @property
    def variance(self) -> float:
        """Variance of the errors in units of the stated one."""
        return self.variance_of(self.square)

    @property
    def spare(self) -> float:
        """Degrees of freedom of the variance."""
        return STATED + MEDIAN * float(np.sum(self.freedom[self.kept]))

    def variance_of(self, square: Array) -> float:
        """Variance of the errors by the poses' squared ones (N,), few of which leave it near what is stated."""
        typical = _typical(square[self.kept], self.freedom[self.kept])
        return max((STATED + (self.spare - STATED) * typical) / self.spare, EXACT)

    def chance(self, square: Array, variance: float | Array) -> Array:
        """(N,) chance that the poses' squared errors are as large as these (N,), by a variance that is estimated."""
        return np.asarray(special.fdtrc(self.rank, self.spare, square / self.rank / variance))

    @property
    def pose_gain(self) -> Array:
        """(N,) drop of the squared errors by leaving out each pose; zero for one that is."""
        count, u = self.shape
        part = self.basis[: count * u].reshape(count, u, -1)
        inside = self.residual[: count * u].reshape(self.shape)
        away = np.eye(u) - part @ part.transpose(0, 2, 1)
        gain = np.einsum("ni,nij,nj->n", inside, np.linalg.pinv(away, rcond=1e-6, hermitian=True), inside)
        return np.asarray(np.where(self.kept, gain, 0.0))

    def gain_without(self, poses: NDArray[np.bool_]) -> float:
        """Drop of the squared errors by leaving poses (N,) out together."""
        rows = np.flatnonzero(np.repeat(poses & self.kept, self.shape[1]))
        part, error = self.basis[rows], self.residual[rows]
        return float(error @ np.linalg.lstsq(np.eye(len(rows)) - part @ part.T, error, rcond=1e-6)[0])

    def tested(self, fault: Fault) -> _Explanation | None:
        """What a fault explains; nothing where parameters do the same, or where only an absurd size would."""
        column = fault.rows(self.kept, len(self._raw))
        across = self._across(column)
        size = np.linalg.norm(column, axis=0)
        visible = float(np.linalg.norm(across)) / max(float(np.linalg.norm(size)), 1e-300)
        if visible < BLIND:
            return None
        information = across.T @ across
        toward = -across.T @ self.residual
        amount = np.asarray(np.linalg.solve(information + np.diag(fault.information), toward), dtype=np.float64)
        if np.max(np.abs(amount) * np.sqrt(fault.information)) > UNUSUAL:
            return None
        freedom = int(np.sum(np.diag(information) > fault.information))
        return _Explanation(fault, amount, float(toward @ amount), across @ amount, max(freedom, 1), visible)

    def variance_without(self, gain: Array) -> Array:
        """(N,) variance of the errors if one pose is left out, which lowers their squares by its `pose_gain` (N,).

        It is that of the mean of all rows: it follows a wild pose, but not the one that is left out.
        """
        blank = np.sum(self.shape[1] - self.rank[self.kept])
        left = np.maximum(np.count_nonzero(self.rows) - blank - self.basis.shape[1] - self.rank, 0)
        square = np.maximum(float(self.residual @ self.residual) - gain, 0.0)
        return np.asarray((STATED + square) / (STATED + left))

    def variance_after(self, found: _Explanation) -> float:
        """Variance of the errors that is left once a fault is explained."""
        inside = (self.residual + found.change)[: self.shape[0] * self.shape[1]].reshape(self.shape)
        return self.variance_of(np.sum(inside**2, axis=1))

    def chance_of_agreement(self, found: _Explanation) -> float:
        """Chance of a fault by the spread of its evidence over parts of the poses; 0 where these are too few."""
        inside = slice(0, self.shape[0] * self.shape[1])
        evidence = (found.change * (self.residual + found.change))[inside].reshape(self.shape).sum(axis=1)
        weight = (found.change**2)[inside].reshape(self.shape).sum(axis=1)
        share = np.cumsum(weight) / max(float(np.sum(weight)), 1e-300)
        part = np.minimum((share * PARTS * (1 - 1e-12)).astype(int), PARTS - 1)
        sums = np.bincount(part, evidence, PARTS)[np.unique(part)]
        if len(sums) < PARTS // 2 or np.count_nonzero(weight > 1e-12) < 2 * PARTS:
            return 0.0
        spread = float(np.sqrt(np.sum(sums**2) * len(sums) / (len(sums) - 1)))
        return float(2 * special.stdtr(len(sums) - 1, -float(np.sum(weight)) / spread)) if spread else 0.0

    def explain(self, found: _Explanation) -> None:
        """Count a fault among what is explained, its amount free from now on."""
        d = found.fault.columns.shape[2]
        column = found.fault.rows(np.ones(len(self.kept), dtype=bool), len(self._raw) + d)
        column[len(self._raw) :] = np.diag(np.sqrt(found.fault.information))
        self._stack = np.hstack([np.vstack([self._stack, np.zeros((d, self._stack.shape[1]))]),
                                 column / np.linalg.norm(column, axis=0) * np.linalg.norm(self._stack, axis=0).max()])
        self._raw = np.concatenate([self._raw, np.zeros(d)])
        self._project()

    def set_aside(self, poses: NDArray[np.bool_]) -> None:
        """Leave poses out of all tests."""
        self.kept = self.kept & ~poses
        self._project()


def _leading(misfit: _Misfit, tested: list[_Explanation], tried: int) -> tuple[_Explanation | None, float]:
    """The best explanation, if what it explains is no chance, and the errors' variance once it is known."""
    variance, count = misfit.variance, len(misfit.rank)
    best = max(tested, key=lambda found: found.score(variance, count), default=None)
    if best is None:
        return None, variance
    variance = min(variance, misfit.variance_after(best))
    best = max(tested, key=lambda found: found.score(variance, count))
    nearby = [found for fault in best.fault.neighbours() if (found := misfit.tested(fault)) is not None]
    best = max([best, *nearby], key=lambda found: found.score(variance, count))
    chance = float(special.fdtrc(best.freedom, misfit.spare, best.drop / best.freedom / variance))
    return (best if chance < FALSE_ALARM / tried else None), variance


def _wild(misfit: _Misfit, variance: float, least: float) -> tuple[NDArray[np.bool_], float]:
    """Poses that contradict all others one by one, by at least so much, and the criterion of leaving them out."""
    count, gain = len(misfit.rank), misfit.pose_gain
    chance = _chance_of_poses(misfit, gain, variance)
    wild = (chance < FALSE_ALARM / count) & (gain > least)
    if wild.sum() > MANY * misfit.kept.sum():  # among few poses, others that follow one that is far off look wild, too
        wild = np.arange(count) == np.argmin(chance)
        others = copy(misfit)
        others.set_aside(wild)
        if np.any(_chance_of_poses(others, others.pose_gain, others.variance) < FALSE_ALARM / count):
            return np.zeros(count, dtype=bool), -np.inf
    if not np.any(wild):
        return wild, -np.inf
    return wild, misfit.gain_without(wild) / variance - float(np.sum(misfit.rank[wild] + 1)) * float(np.log(count))


def _chance_of_poses(misfit: _Misfit, gain: Array, variance: float) -> Array:
    """(N,) chance of what leaving out each pose alone explains, its gain (N,)."""
    return misfit.chance(gain, np.minimum(variance, misfit.variance_without(gain)) * WILDER)


def _noisy(problem: CalibrationProblem, misfit: _Misfit, variance: float) -> tuple[Suspect | None, float]:
    """The stage or stretch whose errors are larger than the others', and the criterion of a variance of its own."""
    square, freedom = np.where(misfit.kept, misfit.square, 0.0), np.where(misfit.kept, misfit.freedom, 0.0)
    found = _stages(problem, square, freedom) or _stretches(problem, square / variance, freedom, misfit.spare)
    best, score = None, -np.inf
    for suspect in found:
        own = float(freedom[suspect.poses].sum())
        ratio = float(square[suspect.poses].sum()) / own / variance
        gain = own * (ratio - 1 - np.log(ratio)) - 2 * np.log(len(freedom))
        if gain > score:
            best, score = suspect, gain
    return best, score


def _suspect(problem: CalibrationProblem, misfit: _Misfit, leading: _Explanation, tested: list[_Explanation],
             variance: float, tried: int) -> Suspect:
    """The leading explanation with its rivals: the best of each other fault that the data do not rule out."""
    count, score = len(misfit.rank), leading.score(variance, len(misfit.rank))
    best: dict[tuple[SuspectKind, str], _Explanation] = {}
    for found in tested:
        key = found.fault.kind, found.fault.name
        if key not in best or found.score(variance, count) > best[key].score(variance, count):
            best[key] = found
    own = leading.fault.kind, leading.fault.name
    rivals = [found for key, found in best.items() if key != own and found.score(variance, count) > score - MARGIN]
    rivals.sort(key=lambda found: -found.drop)
    others = [_stated(problem, found, variance) for found in rivals]
    if leading.visible < DIM or misfit.chance_of_agreement(leading) > AGREE / tried:
        others.append(Suspect(SuspectKind.LACK, "", np.ones(count, bool), "", float("nan")))
    return replace(_stated(problem, leading, variance), rivals=tuple(others))


def _stated(problem: CalibrationProblem, found: _Explanation, variance: float) -> Suspect:
    fault, first = found.fault, ""
    if fault.there is not None:
        start = np.zeros(len(fault.poses), dtype=bool)
        start[fault.first] = True
        first = _place(problem, start)
    return Suspect(fault.kind, fault.name, fault.poses, first or _place(problem, fault.poses),
                   float(np.sqrt(max(found.drop, 0.0) / variance)), fault.size(found.amount),
                   fault.where or (f"from {first} on" if first else ""), fault.unit)


def _one_plane(problem: CalibrationProblem, q: Array) -> tuple[Suspect, ...]:
    """All that turned between the poses turned about parallel axes."""
    model = problem.model
    closed = problem.layout.held
    chain = model.loop_by_angles.sparsity_out(1)
    moves = [k for k in range(len(model.joints)) if any(chain.has_nz(row, k) for row in range(3))]
    turning = [k for k in moves if np.any(closed) and np.ptp(q[closed, k]) > TURNED]
    if len(turning) < 2:
        return ()
    axes = model.over(model.axes, model.parameters.nominal, q[closed])[0][:, :, turning]
    across = np.linalg.norm(np.cross(axes, axes[:, :, :1], axis=1), axis=1)
    if np.max(across) > TILTED:
        return ()
    return (Suspect(SuspectKind.PLANE, "", closed, _place(problem, closed), float(len(turning))),)


def _typical(square: Array, freedom: Array) -> float:
    """Variance of the errors in units of the stated one, from the median, which a few bad poses do not move.

    Neighbouring poses whose residuals have little freedom each count together.
    """
    block = np.floor((np.cumsum(freedom) - freedom) / BLOCK + 1e-9).astype(int)
    block = np.unique(block, return_inverse=True)[1]
    free, squares = np.bincount(block, freedom), np.bincount(block, square)
    if free.max(initial=0.0) < BLOCK:
        return 1.0  # nothing is left to tell
    enough = free >= BLOCK / 2
    return float(np.median(squares[enough] / special.chdtri(free[enough], 0.5)))


def _place(problem: CalibrationProblem, poses: NDArray[np.bool_]) -> str:
    rows, files = problem.poses.row[poses], problem.poses.file[poses]
    names = dict.fromkeys(str(f) for f in files)
    first, last = int(rows[0]), int(rows[-1])
    span = f"row {first}" if len(rows) == 1 else f"rows {first} to {last}"
    return span if len(names) > 1 or "" in names else f"{span} of {next(iter(names))}"


def _stages(problem: CalibrationProblem, square: Array, freedom: Array) -> tuple[Suspect, ...]:
    groups = {label: there for label in dict.fromkeys(str(s) for s in problem.poses.stage)
              if np.any(there := (problem.poses.stage == label) & (freedom > 0))}
    if len(groups) < 3:
        return ()
    # by medians, so that a few bad poses do not make their whole stage suspect
    size = {label: float(np.sqrt(_typical(square[g], freedom[g]))) for label, g in groups.items()}
    found = []
    for label, poses in groups.items():
        usual = float(np.median([value for other, value in size.items() if other != label]))
        ratio = size[label] / usual if usual else 1.0
        chance = special.fdtrc(MEDIAN * freedom[poses].sum(), MEDIAN * freedom[~poses].sum(), ratio**2)
        if ratio > LARGER and chance < FALSE_ALARM / len(groups):
            found.append(Suspect(SuspectKind.STAGE, label, poses, _place(problem, poses), ratio))
    return tuple(sorted(found, key=lambda s: -s.strength))


def _stretches(problem: CalibrationProblem, square: Array, freedom: Array, spare: float) -> tuple[Suspect, ...]:
    """The worst run of neighbouring poses in every stage, if its errors are too large for chance.

    No single pose counts for more than makes it wild by itself, so that it makes no stretch of its neighbours.
    """
    found = []
    own = np.where(freedom > 0, freedom, 1.0)
    square = np.minimum(square, WILDER * own * special.fdtri(own, spare, 1 - FALSE_ALARM / len(square)))
    for label in dict.fromkeys(str(s) for s in problem.poses.stage):
        rows = np.flatnonzero((problem.poses.stage == label) & (freedom > 0))
        total = np.concatenate([[0], np.cumsum(square[rows])])
        free = np.concatenate([[0], np.cumsum(freedom[rows])])
        # lengths that grow by a quarter: all would take the square of the number of poses
        sizes = np.unique(np.round(SHORTEST * 1.25 ** np.arange(60)).astype(int))
        sizes = sizes[sizes <= len(rows) // 2]
        if not sizes.size:
            continue
        first = np.concatenate([np.arange(len(rows) - size + 1) for size in sizes])
        last = first + np.repeat(sizes, len(rows) - sizes + 1)
        windows = len(first)
        large = total[last] - total[first] > LARGER * (free[last] - free[first])  # others are no alarm
        if not np.any(large):
            continue
        first, last = first[large], last[large]
        inside = free[last] - free[first]
        chance = special.fdtrc(inside, spare, (total[last] - total[first]) / inside / LARGER)
        best = int(np.argmin(chance))
        if chance[best] < FALSE_ALARM / windows:
            poses = np.zeros(len(square), bool)
            poses[rows[first[best] : last[best]]] = True
            size = float(np.sqrt(square[poses].sum() / freedom[poses].sum()))
            found.append(Suspect(SuspectKind.STRETCH, label, poses, _place(problem, poses), size))
    return tuple(found)


def _outliers(problem: CalibrationProblem, square: Array, rank: NDArray[np.int64],
              odd: NDArray[np.bool_]) -> tuple[Suspect, ...]:
    found = []
    for k in np.flatnonzero(odd):
        poses = np.zeros(len(square), bool)
        poses[k] = True
        size = float(np.sqrt(square[k] / rank[k]))
        found.append(Suspect(SuspectKind.POSE, str(problem.poses.pose[k]), poses, _place(problem, poses), size))
    return tuple(sorted(found, key=lambda s: -s.strength))
