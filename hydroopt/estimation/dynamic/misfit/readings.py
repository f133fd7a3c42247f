"""A problem's logs cut into blocks and bands of frequency, linearised for the engine of hypotheses.

Rows of a reading in a block are turned by an orthonormal cosine transform (DCT-II), so that residuals with a memory are
independent with a variance of each band. No band's variance is below that of the sensors' noise and of what errors of
the smoothed motion add there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct

from hydroopt.estimation.dynamic.experiment import Experiment
from hydroopt.estimation.dynamic.misfit.hypotheses import Fault, one_after_another
from hydroopt.estimation.dynamic.misfit.view import View
from hydroopt.estimation.dynamic.problem import IdentificationProblem
from hydroopt.estimation.inference.hypotheses import Layout, LinearModel
from hydroopt.logs.lag import stretches
from hydroopt.logs.smoothing import Motion
from hydroopt.spatial.inertia import Array

BLOCKS, FEWEST = 8, 2
"""Blocks of a log; of several logs twice as many in all, and at least so many each."""
LONGEST, SHORTEST = 2500, 40
"""Samples of a block that are looked at, and of the shortest block."""
REACH = 1.5
"""Periods of the lowest bandwidth by which a block's neighbours are felt in its motion."""
LOWEST, BANDS = 0.1, 14
"""Upper end of the lowest band [Hz], and the number of bands, each twice as wide as the one before."""
GEOMETRY = 0.03
"""Standard deviation [m] of what pins and dead length add to a length."""


@dataclass(frozen=True, eq=False)
class Block:
    """Samples `first` to `last` of a view, with those around them from `start` to `stop`."""

    view: int
    start: int
    stop: int
    first: int
    last: int


def blocks_of(motion: Motion, view: int, parts: int) -> list[Block]:
    """The blocks of a log's motion, about so many, which is that of a view."""
    made: list[Block] = []
    pad = int(REACH / (float(np.min(motion.bandwidth)) * float(np.median(np.diff(motion.t))))) + 1
    size = len(motion.t)
    for a, b in stretches(motion.segment):
        count = max(1, round(parts * (b - a) / size))
        cuts = np.linspace(a, b, count + 1).astype(int)
        for first, last in zip(cuts[:-1].tolist(), cuts[1:].tolist(), strict=True):
            end = min(last, first + LONGEST)
            if end - first >= SHORTEST:
                made.append(Block(view, max(a, first - pad), min(b, end + pad), first, end))
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


class ForceReadings:
    """The readings of a problem's logs about parameters ψ, for `hypotheses.name`.

    Attributes:
        views: of the logs that have samples enough; `blocks` of them.
        prior: (P, P) information about the nuisances: all parameters, then the geometry of measured lengths, constant
            errors of positions that are not read but fitted, and how much of its own changes smoothing takes from the
            motion of each joint.
        pull: (P,) information times the distance of the priors' mean from the nominal parameters.
    """

    def __init__(self, problem: IdentificationProblem, psi: Array) -> None:
        self.views, self.blocks = list[View](), list[Block]()
        parts = max(FEWEST, min(BLOCKS, 2 * BLOCKS // len(problem.experiments)))
        for one in problem.experiments:
            data, motion = one.plotted, one.plotted.motion
            whole = View.of(data, psi)
            part, blocks = looked_at(whole.experiment, blocks_of(motion, len(self.views), parts))
            view = replace(whole, experiment=part)
            if not self.views or view.lengths == self.views[0].lengths:
                self.views.append(view)
                self.blocks += blocks
        parameters, joints = problem.parameters, len(problem.model.machine.joints)
        self._fitted = any(view.experiment.position_std is not None for view in self.views)
        extra = np.concatenate([np.full(4 * len(self.views[0].lengths), GEOMETRY),
                                 np.ones(joints * (1 + self._fitted))])
        rows, right = problem.prior_rows
        p, P = len(parameters), len(parameters) + len(extra)
        self.prior, self.pull = np.zeros((P, P)), np.zeros(P)
        self.prior[:p, :p], self.prior[range(p, P), range(p, P)] = rows.T @ rows, 1 / extra**2
        fixed = list(parameters.select(problem.fixed))
        self.prior[fixed, fixed] += 1e8 / parameters.scale[fixed] ** 2
        self.pull[:p] = rows.T @ (right - rows @ parameters.nominal)
        self.from_nominal = psi - parameters.nominal
        self._models: dict[tuple[tuple[Fault, float], ...], LinearModel[Fault]] = {}

    @property
    def names(self) -> tuple[str, ...]:
        """The readings."""
        return self.views[0].names

    def model(self, held: Sequence[tuple[Fault, Array]]) -> LinearModel[Fault]:
        """The model about hypotheses that hold; delays add up one after the other."""
        key = tuple((each, float(amount[0])) for each, amount in held)
        if key not in self._models:
            faults = one_after_another([each for each, _ in key], [amount for _, amount in key])
            chosen = [(each, amount) for each, (_, amount) in zip(faults, key, strict=True)]
            taken, regressors = self._taken(key), [_with(view, chosen) for view in self.views]
            effects = [sum((fault.effect(view, size) for fault, size in chosen), start=np.zeros_like(view.residual))
                       for view in self.views]
            extra = [np.concatenate([K, _geometry(view), view.by_position[:, :, : None if self._fitted else 0],
                                      view.smoothed_away], axis=2)
                      for view, K in zip(self.views, regressors, strict=True)]
            left = [(view.residual + K @ self.from_nominal - effect)[:, :, None]
                    for view, K, effect in zip(self.views, regressors, effects, strict=True)]
            model = LinearModel[Fault].of(self._rows(extra, taken), self._rows(left, taken)[:, 0], self._layout(taken),
                                          self.prior, self.pull)
            for (fault, size), (plain, _) in zip(chosen, key, strict=True):
                columns = [fault.columns(view, np.array([size])) for view in self.views]
                model = model.holding(plain, self._rows(columns, taken), np.array([size]))
            self._models[key] = model
        return self._models[key]

    def columns(self, hypotheses: Sequence[Fault], held: Sequence[tuple[Fault, Array]]) -> Array:
        """Columns (R, k) of other hypotheses there, about amounts of zero, side by side."""
        taken = self._taken([(each, float(amount[0])) for each, amount in held])
        return self._rows([np.concatenate([each.columns(view, np.zeros(1)) for each in hypotheses], axis=2)
                           for view in self.views], taken)

    def _taken(self, held: Sequence[tuple[Fault, float]]) -> list[NDArray[np.bool_]]:
        """Readings (N, c) of each view that take part where some hypotheses hold."""
        return [view.taken & ~np.any([view.reverses, *(fault.unsteady(view, size) for fault, size in held)], axis=0)
                for view in self.views]

    def _layout(self, taken: Sequence[NDArray[np.bool_]]) -> Layout:
        """Blocks; groups, a band of a reading each; numbers of coefficients, of which samples left out count none.
        """
        c, sizes = len(self.names), np.array([np.diff(self._edges(block)) for block in self.blocks])
        used = [np.mean(taken[block.view][block.first : block.last], axis=0) for block in self.blocks]
        rows = np.tile(sizes.T.ravel(), c)  # reading by reading, band by band, block by block
        return Layout(np.repeat(np.tile(np.arange(len(self.blocks)), c * BANDS), rows),
                      np.repeat(np.repeat(np.arange(c * BANDS), len(self.blocks)), rows),
                      np.ravel(np.transpose(used) @ sizes))

    def _edges(self, block: Block) -> NDArray[np.intp]:
        """First coefficient of each band, and one after the last: coefficient k has k half waves."""
        motion, count = self.views[block.view].motion, block.last - block.first
        time = count * float(np.median(np.diff(motion.t[block.first : block.last])))
        ends = np.ceil(2 * time * LOWEST * 2.0 ** np.arange(BANDS - 1)).astype(int)
        return np.concatenate([[0], np.clip(ends, 0, count), [count]])

    def _turned(self, values: Array, block: Block, taken: NDArray[np.bool_]) -> Array:
        own = slice(block.first, block.last)
        return np.asarray(dct(values[own] * taken[own, :, None], axis=0, norm="ortho"))

    @cached_property
    def floor(self) -> Array:
        """Standard deviation (c, bands) of a reading's coefficients by its noise and by errors of the motion."""
        squares, count = np.zeros((len(self.names), BANDS)), np.zeros((len(self.names), BANDS))
        noise = np.sqrt(np.mean([view.noise**2 for view in self.views], axis=0))
        for block in self.blocks:
            view = self.views[block.view]
            turned = self._turned(view.motion_errors[:, :, None], block, view.taken)[:, :, 0] ** 2
            for b, (first, end) in enumerate(pairwise(self._edges(block).tolist())):
                squares[:, b] += turned[first:end].sum(axis=0)
                count[:, b] += (end - first) * np.mean(view.taken[block.first : block.last], axis=0)
        return np.asarray(np.sqrt(noise[:, None] ** 2 + squares / np.maximum(count, 1.0)))

    def _rows(self, of_views: Sequence[Array], taken: Sequence[NDArray[np.bool_]]) -> Array:
        """Whitened rows (R, k) of readings (N, c, k) of every view, in the order of the layout."""
        turned = [self._turned(of_views[block.view], block, taken[block.view]) for block in self.blocks]
        edges = [self._edges(block) for block in self.blocks]
        return np.vstack([one[at[b] : at[b + 1], k] / self.floor[k, b] for k in range(len(self.names))
                          for b in range(BANDS) for one, at in zip(turned, edges, strict=True)])

    def excess(self, model: LinearModel[Fault]) -> dict[str, tuple[float, float]]:
        """By reading: RMS of residuals as a multiple of what noise and the motion explain, and the frequency [Hz] about
        which most of what is beyond stands."""
        variance = model.fit.variance.reshape(len(self.names), BANDS)
        count = model.layout.count.reshape(variance.shape)
        expected = count * self.floor**2
        ratio = np.sqrt(np.sum(expected * variance, axis=1) / np.maximum(np.sum(expected, axis=1), 1e-300))
        hertz = 0.75 * LOWEST * 2.0 ** np.argmax(expected * (variance - 1), axis=1)
        return dict(zip(self.names, zip(ratio.tolist(), hertz.tolist(), strict=True), strict=True))


def _with(view: View, chosen: Sequence[tuple[Fault, float]]) -> Array:
    """The regressor (N, c, p) of a machine that has these faults."""
    changes = (fault.by_parameters(view, size) for fault, size in chosen)
    return np.asarray(sum((change for change in changes if change is not None), start=view.regressor))


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
