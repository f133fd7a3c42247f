"""All logs cut into blocks, whose whitened columns give one table of inner products: every test is algebra on it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from hydroopt.estimation.dynamic.experiment import Experiment
from hydroopt.estimation.dynamic.misfit.error_covariance import ErrorCovariance, Whitened
from hydroopt.estimation.dynamic.misfit.faults import Fault
from hydroopt.estimation.dynamic.misfit.view import View
from hydroopt.estimation.dynamic.problem import IdentificationProblem
from hydroopt.logs.lag import stretches
from hydroopt.logs.smoothing import Motion
from hydroopt.spatial.inertia import Array

PARTS = 4
"""Blocks of a log: every other one belongs to the same half."""
LONGEST = 2500
"""Samples of a block; of a longer log that many of each of `MANY` blocks are looked at."""
MANY = 8
SHORTEST = 40
"""Samples of the shortest block."""
REACH = 1.5
"""Periods of the lowest bandwidth by which a block's neighbours are felt in its motion."""
COURSES = {"time": 30, "position": 8, "speed": 8}
"""Over what a lack of fit of each reading is looked for, by so many cosines."""
GEOMETRY = 0.03
"""Standard deviation [m] of what pins and dead length add to a length."""


@dataclass(frozen=True)
class Block:
    """Samples `first` to `last` of a view, with those around them from `start` to `stop`; `half` is 0 or 1."""

    view: int
    start: int
    stop: int
    first: int
    last: int
    half: int


def blocks_of(motion: Motion, view: int, before: int) -> list[Block]:
    """The blocks of a log's motion, which is that of a view; `before` them there are so many of other logs."""
    made: list[Block] = []
    pad = int(REACH / (float(np.min(motion.bandwidth)) * float(np.median(np.diff(motion.t))))) + 1
    size = len(motion.t)
    for a, b in stretches(motion.segment):
        count = max(1, round((PARTS if size <= PARTS * LONGEST else MANY) * (b - a) / size))
        cuts = np.linspace(a, b, count + 1).astype(int)
        for first, last in zip(cuts[:-1].tolist(), cuts[1:].tolist(), strict=True):
            end = min(last, first + LONGEST)
            if end - first >= SHORTEST:
                made.append(Block(view, max(a, first - pad), min(b, end + pad), first, end, (before + len(made)) % 2))
    return made


def looked_at(experiment: Experiment, blocks: Sequence[Block]) -> tuple[Experiment, list[Block]]:
    """The samples of an experiment that its blocks need, a stretch each, and the blocks there.

    All of it where they leave few samples out. What a view says of a log, such as its noise, rests on the samples of
    blocks alone then.
    """
    if any(one.stop > other.start for one, other in pairwise(blocks)) or not blocks:
        return experiment, list(blocks)
    rows = np.concatenate([np.arange(one.start, one.stop) for one in blocks])
    edges = np.cumsum([0, *(one.stop - one.start for one in blocks)]).tolist()
    segment, own = np.repeat(np.arange(len(blocks)), np.diff(edges)), np.zeros(len(rows), dtype=bool)
    moved = []
    for one, to in zip(blocks, edges[:-1], strict=True):
        by = to - one.start
        moved.append(replace(one, start=one.start + by, stop=one.stop + by, first=one.first + by, last=one.last + by))
        own[one.first + by : one.last + by] = True
    log, motion = experiment.log, experiment.motion
    part = replace(log, t=log.t[rows], channels={name: x[rows] for name, x in log.channels.items()},
                   sample=log.sample[rows], segment=segment)
    motion = replace(motion, t=motion.t[rows], q=motion.q[rows], qd=motion.qd[rows], qdd=motion.qdd[rows],
                     segment=segment, interior=motion.interior[rows] & own)
    force, known = experiment.force[rows], experiment.known[rows]
    pressure, added, calm = (None if x is None else x[rows]
                             for x in (experiment.pressure, experiment.added, experiment.calm))
    return replace(experiment, log=part, motion=motion, force=force, known=known, pressure=pressure, added=added,
                   calm=calm), moved


class Columns:
    """Readings (N, c, k) of every view as whitened columns of every block."""

    def __init__(self, blocks: Sequence[Whitened]) -> None:
        self.blocks = tuple(blocks)

    def inner(self, other: Columns) -> Array:
        """Inner products (blocks, k, l), block by block."""
        return np.stack([one.inner(two) for one, two in zip(self.blocks, other.blocks, strict=True)])


class Data:
    """The readings of a problem's logs about parameters ψ, cut into blocks; `chosen` faults are taken to be there.

    Attributes:
        views: of the logs that have samples enough.
        prior: (P, P) information about the nuisances: all parameters, then the geometry of measured lengths, then
            constant errors of positions that are not read but fitted.
        pull: (P,) information times the distance of the priors' mean from the nominal parameters.
    """

    def __init__(self, problem: IdentificationProblem, psi: Array, chosen: Sequence[tuple[Fault, float]] = ()) -> None:
        self.views, self.blocks = list[View](), list[Block]()
        for one in problem.experiments:
            data, motion = one.plotted, one.plotted.motion
            part, blocks = looked_at(data, blocks_of(motion, len(self.views), len(self.blocks)))
            view = View.of(part, psi, (float(motion.t[0]), float(motion.t[-1])))
            if not self.views or view.lengths == self.views[0].lengths:
                self.views.append(view)
                self.blocks += blocks
        self._taken = [view.taken & ~np.any([np.zeros_like(view.taken), *(fault.unsteady(view, size) for fault, size
                                                                         in chosen)], axis=0) for view in self.views]
        self._regressors = [_with(view, chosen) for view in self.views]
        self._covariances = [self._covariance(block) for block in self.blocks]
        parameters = problem.parameters
        fitted = any(view.experiment.position_std is not None for view in self.views)
        beside = np.append(np.full(4 * len(self.views[0].lengths), GEOMETRY),
                           np.ones(len(problem.model.machine.joints) if fitted else 0))
        rows, right = problem.prior_rows
        p, extra = len(parameters), len(beside)
        self.prior = np.zeros((p + extra, p + extra))
        self.prior[:p, :p] = rows.T @ rows
        self.prior[p:, p:] = np.diag(1 / beside**2)
        held = list(parameters.select(problem.fixed))
        self.prior[held, held] += 1e8 / parameters.scale[held] ** 2
        self.pull = np.zeros(p + extra)
        self.pull[:p] = rows.T @ (right - rows @ parameters.nominal)
        self.scale = np.append(parameters.scale, beside)
        self._fitted = fitted
        self.problem, self.from_nominal = problem, psi - parameters.nominal

    def about(self, from_nominal: Array, chosen: Sequence[tuple[Fault, float]]) -> Data:
        """The same data about other parameters, given by their distance (p,) from the nominal ones, and faults."""
        parameters = self.problem.parameters
        return Data(self.problem, np.clip(parameters.nominal + from_nominal, parameters.lower, parameters.upper),
                    chosen)

    def _covariance(self, block: Block) -> ErrorCovariance:
        view, span = self.views[block.view], slice(block.start, block.stop)
        taken = np.zeros_like(view.taken[span])
        own = slice(block.first - block.start, block.last - block.start)
        taken[own] = self._taken[block.view][block.first : block.last]
        return ErrorCovariance(view.motion.t[span], view.by_motion[:, span], taken, view.noise, view.angle_noise,
                               view.motion.bandwidth)

    def columns(self, of_views: Sequence[Array]) -> Columns:
        """Columns from readings (N, c, k) of every view."""
        return Columns([covariance.whiten(of_views[block.view][block.start : block.stop])
                        for block, covariance in zip(self.blocks, self._covariances, strict=True)])

    @cached_property
    def nuisances(self) -> Columns:
        """Of all parameters, of the geometry of lengths and of positions that are fitted."""
        parts = [(K, _geometry(view), view.by_position[:, :, : None if self._fitted else 0])
                 for view, K in zip(self.views, self._regressors, strict=True)]
        return Columns([covariance.whiten(np.concatenate([one[block.start : block.stop] for one in parts[block.view]],
                                                         axis=2))
                        for block, covariance in zip(self.blocks, self._covariances, strict=True)])

    @cached_property
    def cosines(self) -> tuple[Columns, ...]:
        """Of each reading slow cosines: over the time of each log, the joint's position and the actuator's speed."""
        made: list[list[Array]] = [[] for _ in self.views]
        for over, count in COURSES.items():
            courses = [_course(view, over) for view in self.views]
            low = np.min([one.min(axis=0) for one in courses], axis=0)
            span = np.maximum(np.max([one.max(axis=0) for one in courses], axis=0) - low, 1e-12)
            for table, course in zip(made, courses, strict=True):
                table.append(_cosines((course - low) / span, count))
        waves = [np.concatenate(one) for one in made]
        return tuple(Columns([covariance.whiten(waves[block.view][:, block.start : block.stop, k].T, k)
                              for block, covariance in zip(self.blocks, self._covariances, strict=True)])
                     for k in range(len(self.views[0].names)))

    def residual(self, effects: Sequence[Array] | None = None) -> Columns:
        """What is measured beyond nominal parameters, and beyond `effects` (N, c) of faults."""
        made = [view.residual + K @ self.from_nominal for view, K in zip(self.views, self._regressors, strict=True)]
        if effects is not None:
            made = [one - effect for one, effect in zip(made, effects, strict=True)]
        return self.columns([one[:, :, None] for one in made])

    @property
    def halves(self) -> Array:
        """Which half (0 or 1) each block belongs to."""
        return np.array([block.half for block in self.blocks])


def _with(view: View, chosen: Sequence[tuple[Fault, float]]) -> Array:
    """The regressor (N, c, p) of a machine that has these faults."""
    changes = (fault.by_parameters(view, size) for fault, size in chosen)
    return np.asarray(sum((change for change in changes if change is not None), start=view.regressor))


def _course(view: View, over: str) -> Array:
    """Part of the log that has gone by, or position or speed of each reading's joint or actuator (N, c)."""
    if over == "time":
        return np.repeat(view.elapsed[:, None], len(view.names), axis=1)
    return view.positions if over == "position" else view.speeds


def _cosines(x: Array, count: int) -> Array:
    """cos(k·π·x) for k = 1 … `count` (count, *x.shape), by Chebyshev's recursion, since a cosine takes as long as ten
    products.
    """
    made = np.empty((count + 1, *x.shape))
    made[0], made[1] = 1.0, np.cos(np.pi * x)
    for k in range(2, count + 1):
        np.subtract(2 * made[1] * made[k - 1], made[k - 2], out=made[k])
    return made[1:]


def _geometry(view: View) -> Array:
    """What errors of pins, dead length and transducer do to lengths (N, c, 4 each): ℓ² = A + B·cos(q + φ)."""
    n, count = len(view.model.machine.balances), len(view.lengths)
    made = np.zeros((*view.predicted.shape, 4 * count))
    for k in range(count):
        length = view.predicted[:, n + k]
        mean = float(np.mean(length))
        arm = np.sum(view.by_motion[0, :, n + k], axis=1)
        made[:, n + k, 4 * k : 4 * k + 4] = np.column_stack(
            [np.ones_like(length), length / mean, mean / length, arm / max(float(np.max(np.abs(arm))), 1e-9)])
    return made
