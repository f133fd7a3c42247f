"""All logs cut into blocks, whose whitened columns give one table of inner products: every test is algebra on it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hydroopt.estimation.dynamic.misfit.error_covariance import ErrorCovariance, Whitened
from hydroopt.estimation.dynamic.misfit.faults import Fault
from hydroopt.estimation.dynamic.misfit.view import View
from hydroopt.estimation.dynamic.problem import IdentificationProblem
from hydroopt.logs.lag import stretches
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


def blocks_of(views: Sequence[View]) -> list[Block]:
    """The blocks of all logs."""
    made: list[Block] = []
    for k, view in enumerate(views):
        motion = view.motion
        pad = int(REACH / (float(np.min(view.motion.bandwidth)) * float(np.median(np.diff(motion.t))))) + 1
        size = len(motion.t)
        for a, b in stretches(motion.segment):
            count = max(1, round(PARTS * (b - a) / size)) if size <= PARTS * LONGEST else max(
                1, round(MANY * (b - a) / size))
            cuts = np.linspace(a, b, count + 1).astype(int)
            for first, last in zip(cuts[:-1].tolist(), cuts[1:].tolist(), strict=True):
                end = min(last, first + LONGEST)
                if end - first >= SHORTEST:
                    made.append(Block(k, max(a, first - pad), min(b, end + pad), first, end, len(made) % 2))
    return made


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
        made = [View.of(one.plotted, psi) for one in problem.experiments]
        self.views = [view for view in made if view.lengths == made[0].lengths]
        self._taken = [view.taken & ~np.any([np.zeros_like(view.taken), *(fault.unsteady(view, size) for fault, size
                                                                         in chosen)], axis=0) for view in self.views]
        self._regressors = [_with(view, chosen) for view in self.views]
        self.blocks = blocks_of(self.views)
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
        return self.columns([np.concatenate([K, _geometry(view), view.by_position[:, :, : None if self._fitted else 0]],
                                            axis=2) for view, K in zip(self.views, self._regressors, strict=True)])

    @cached_property
    def cosines(self) -> tuple[Columns, ...]:
        """Of each reading slow cosines: over the time of each log, the joint's position and the actuator's speed."""
        made: list[list[Array]] = [[] for _ in self.views]
        for over, count in COURSES.items():
            courses = [_course(view, over) for view in self.views]
            low = np.min([one.min(axis=0) for one in courses], axis=0)
            span = np.maximum(np.max([one.max(axis=0) for one in courses], axis=0) - low, 1e-12)
            for table, course in zip(made, courses, strict=True):
                table.append(np.cos(np.pi * ((course - low) / span)[:, :, None] * np.arange(1, count + 1)))
        waves = [np.concatenate(one, axis=2) for one in made]
        return tuple(Columns([covariance.whiten(waves[block.view][block.start : block.stop, k], k)
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
    t = view.motion.t
    if over == "time":
        return np.repeat(((t - t[0]) / (t[-1] - t[0]))[:, None], len(view.names), axis=1)
    return view.positions if over == "position" else view.speeds


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
