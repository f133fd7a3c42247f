"""An experiment of a log that does not fit in memory: smoothed and folded piece by piece."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property, singledispatch
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from hydroopt.errors import LogError, ProblemError
from hydroopt.estimation.dynamic.column_basis import ColumnBasis, KeptRows, column_bases
from hydroopt.estimation.dynamic.experiment import (
    AnyExperiment,
    Experiment,
    channels_used,
    experiment,
    remarks,
    standstill_note,
)
from hydroopt.estimation.dynamic.folding import ActuatorTriangles
from hydroopt.estimation.dynamic.frequency_bands import BLOCK, ActuatorBands
from hydroopt.estimation.dynamic.friction_sign import (
    FEW_MOVING,
    WINDOW,
    Courses,
    Phases,
    SpeedLimits,
    dry_friction_known,
    has_dry_friction,
)
from hydroopt.estimation.motion.sensed import calls_for_fit
from hydroopt.kernels.native import threads
from hydroopt.logs import streamed_smoothing
from hydroopt.logs.any_log import AnyLog
from hydroopt.logs.calibrator_angles import calibrator_channels
from hydroopt.logs.forces_from_pressures import force_lags, pressures
from hydroopt.logs.joint_angles import angle_channels, angle_noise, measured_angles
from hydroopt.logs.log import Log, missing
from hydroopt.logs.quality import Finding
from hydroopt.logs.smoothing import Motion, Smoothing, SmoothingSpline
from hydroopt.logs.stream import BLOCK as SAMPLED
from hydroopt.logs.stream import PIECE, LogStream
from hydroopt.logs.streamed_smoothing import Smoother
from hydroopt.logs.tip_wrench import free_forces
from hydroopt.logs.treatment import Samples
from hydroopt.machine.balances import undriven
from hydroopt.model.model import Model
from hydroopt.spatial.inertia import Array

WORKERS = 4
"""Largest number of threads; each holds a piece in memory, and reading the file limits the speed with more."""

Rows = tuple[int, int]
Given = TypeVar("Given")
Made = TypeVar("Made")


class Totals:
    """Totals over all samples: rows whose dry friction is known, with the holds, triangles of all others, how often
    each joint moves, numbers of samples and of samples used, and findings of data quality.
    """

    def __init__(self, model: Model, bases: Sequence[ColumnBasis]) -> None:
        parameters = model.parameters
        self.known = ActuatorBands(parameters, bases, undriven(model.machine.balances))
        self.others = ActuatorTriangles(bases, len(parameters))
        self.moving = np.zeros(len(model.machine.balances))
        self.samples = self.sample_count = 0
        self.findings: tuple[Finding, ...] = ()

    def add(self, other: Totals, step: float) -> None:
        """Add what a later piece of the log holds; `step` [s] is that between samples."""
        self.known.add(other.known, step)
        self.others.add(other.others)
        self.moving += other.moving
        self.samples, self.sample_count = self.samples + other.samples, self.sample_count + other.sample_count
        self.findings += other.findings


@dataclass(frozen=True, eq=False)
class StreamedExperiment:
    """An experiment of a log that is read in pieces, on each access.

    One smoothing weight for each joint serves all pieces. It, and how slow counts as standing still, are chosen by a
    sample of the log, from where the joints move, or by all of it if it is short. Pieces overlap so far that their
    borders leave no trace. Threads work at some pieces at once; how many of them changes no bit of the result, since
    pieces are added up in their order.
    """

    model: Model
    stream: LogStream
    smoothing: SmoothingSpline
    workers: int = field(default_factory=lambda: min(WORKERS, threads()))

    @cached_property
    def _sample(self) -> tuple[Smoother, SpeedLimits, Experiment]:
        """The smoothing of all pieces, how slow counts as what, and a sample of the log with both."""
        model, log = self.model, self.stream.sample(self._angle_channels)
        angles, where = measured_angles(model, log), self.stream.path
        edges = np.flatnonzero(np.diff(log.segment)) + 1
        pieces = list(zip(np.split(log.t, edges), np.split(angles, edges), strict=True))
        chosen = streamed_smoothing.choose(pieces, self.stream.grid, self.smoothing, angle_noise(model, log),
                                 model.machine.joints, where)
        if chosen.margin > PIECE * self.stream.survey.step:
            raise LogError(f"a motion of {np.min(chosen.bandwidth):.2g} Hz is too slow to be smoothed in pieces",
                           where=where, remedy="keep every tenth sample, or state a higher --bandwidth")
        motion = chosen.motion(log.t, angles, log.segment, np.ones(log.size, bool), where)
        limits = SpeedLimits.of(self._courses.measured(angles), self._courses.smoothed(motion))
        return chosen, limits, _experiment(model, log, angles, motion, limits, remarks(model, log, angles))

    @cached_property
    def _courses(self) -> Courses:
        """What dry friction follows."""
        return Courses.of(self.model)

    @property
    def _angle_channels(self) -> list[str]:
        return sorted(angle_channels(self.model, self.stream))

    @cached_property
    def totals(self) -> Totals:
        """Totals of all pieces: one pass over the log.

        Raises:
            LogError: a piece cannot be used, with its rows.
        """
        margin = self._margin
        beyond = 0 if self.stream.piece % BLOCK == 0 else BLOCK  # where blocks cross the borders of pieces
        totals = Totals(self.model, self._bases)
        for part in self._over(lambda window: self._folded(*window), self.stream.windows((margin, beyond + margin))):
            totals.add(part, self.stream.survey.step)
        totals.known, totals.others = totals.known.expanded(), totals.others.expanded()
        return totals

    @cached_property
    def _bases(self) -> list[ColumnBasis]:
        """Columns that are folded: half of them, and the others follow."""
        return column_bases(self.model)

    @cached_property
    def _rows(self) -> KeptRows:
        """Computes the rows that are folded."""
        return KeptRows(self.model, [basis.kept for basis in self._bases])

    @property
    def moves(self) -> np.ndarray:
        """Which balances' joints (r,) move in more samples than noise explains, or drive without dry friction."""
        return (self.totals.moving > FEW_MOVING * self.totals.samples) | ~has_dry_friction(self.model)

    @property
    def folded(self) -> ActuatorTriangles:
        """The samples whose dry friction is known."""
        return self.bands().triangles

    @property
    def sample_count(self) -> int:
        """Number of samples used."""
        return self.totals.sample_count

    @property
    def pattern(self) -> NDArray[np.bool_]:
        """Which parameters the equations of each actuator have (n, p)."""
        return self.model.regressor_pattern

    @property
    def plotted(self) -> Experiment:
        """What figures show of it: a block from the middle of the sample, or all of a short log."""
        sample = self._sample[2]
        if self.stream.size <= sample.log.size:
            return sample
        middle = sample.log.size // 2 // SAMPLED * SAMPLED
        return _cut(sample, middle, min(middle + SAMPLED, sample.log.size))

    @cached_property
    def log(self) -> LogStream:
        """The log, with all that was found in it."""
        return self.stream.with_findings(_joined(self.totals.findings))

    @property
    def notes(self) -> tuple[str, ...]:
        """How the log was treated, in sentences."""
        chosen, _, sample = self._sample
        totals, plotted = self.totals, self.plotted.log
        bands, left_out = self.bands(), totals.samples - totals.sample_count
        held = bands.holds.samples
        unused = (totals.sample_count - bands.samples - held).astype(int)
        return (f"read in pieces of {self.stream.piece} samples; {sample.log.size} samples chose the smoothing, and "
                f"figures show samples {plotted.rows[0]} to {plotted.rows[1]}", *chosen.notes,
                f"{left_out} of {totals.samples} samples at the ends of stretches left out",
                standstill_note(held, unused), *sample.remarks)

    def moments(self, psi: Array) -> Array:
        """Sums (4, n) over the samples that take part: 1, force, force² and error² of the prediction by ψ."""
        v, last = np.append(psi, -1.0), np.append(0.0 * psi, -1.0)
        both = (self.totals.known.triangles, self.totals.others)
        return np.array([sum(some.samples for some in both), sum(some.forces for some in both),
                         sum(some.squares(last) for some in both), sum(some.squares(v) for some in both)])

    def loaded(self, purpose: str) -> Experiment:
        """Refuse what needs all samples at once.

        Raises:
            ProblemError: always.
        """
        return experiment(self.model, self.stream.loaded(purpose), self.smoothing)

    def fold_into(self, triangles: ActuatorTriangles, psi: Array | None = None,
                  weights: Array | None = None) -> None:
        """Add the samples whose dry friction is known: forces are linear in ψ, and squares have no weights."""
        assert weights is None
        triangles.add(self.folded)

    def bands(self, psi: Array | None = None) -> ActuatorBands:
        """The equations of the samples whose dry friction is known, by frequency; forces are linear in ψ."""
        return self.totals.known.only(self.moves)

    @property
    def _margin(self) -> int:
        """Number of rows by which pieces overlap."""
        return int(np.ceil((self._sample[0].margin + WINDOW) / self.stream.survey.step)) + 1

    def _over(self, work: Callable[[Given], Made], given: Iterable[Given]) -> Iterator[Made]:
        """Results of `work` on all inputs, in their order, computed in parallel with few results in memory."""
        # created before threads use them
        _ = self._sample, self._rows, self.model.regressor, self.model.inverse_dynamics, self.model.wrench_forces
        waiting: deque[Future[Made]] = deque()
        with threadpool_limits(limits=1, user_api="blas"), ThreadPoolExecutor(self.workers) as pool:
            try:
                for one in given:
                    waiting.append(pool.submit(work, one))
                    if len(waiting) > self.workers:
                        yield waiting.popleft().result()
                while waiting:
                    yield waiting.popleft().result()
            finally:
                for left in waiting:
                    left.cancel()

    def _prepared(self, log: Log, needed: Rows) -> Experiment:
        """A piece as an experiment, whose motion is right in the rows `needed`, first and last."""
        beside = int(np.ceil(WINDOW / self.stream.survey.step))
        rows = (log.sample >= needed[0] - beside) & (log.sample <= needed[1] + beside)
        angles = measured_angles(self.model, log)
        motion = self._sample[0].motion(log.t, angles, log.segment, rows,
                                        f"{log.path}, rows {needed[0]} to {needed[1]}")
        return _experiment(self.model, log, angles, motion, self._sample[1])

    def _folded(self, samples: Samples, core: Rows) -> Totals:
        """The totals of the blocks that begin in one piece, so that no border of pieces cuts a block."""
        totals, origin = Totals(self.model, self._bases), self.stream.rows[0]
        log = self.stream.treated(samples, core)
        totals.findings = log.findings
        first, last = (origin + -(-(row - origin) // BLOCK) * BLOCK for row in (core[0], core[1] + 1))
        a, b = np.searchsorted(log.sample, [first, last])
        if a == b:
            return totals
        data = self._prepared(log, (first, last - 1))
        slow = np.abs(self._courses.speeds(data.motion.q[a:b], data.motion.qd[a:b])) <= self._sample[1].slow
        totals.samples, totals.moving = int(b - a), np.sum(~self._courses.in_any(slow), axis=0).astype(float)
        totals.sample_count = int(np.sum(data.inside[a:b]))
        memory: list[Array] | None = None
        for block in data.blocks(origin, (int(a), int(b))):
            memory = memory if memory is not None and len(memory[0]) == block.stop - block.start else None
            rows, memory = self._rows(data.inputs(block), data.force[block], memory)
            others = data.inside[block, None] & ~data.known[block] & np.isfinite(data.force[block])
            for i, (some, own) in enumerate(zip(rows, np.ascontiguousarray(others.T), strict=True)):
                if (places := np.flatnonzero(own)).size:
                    totals.others.fold_rows(i, some.T, places)
            data.fold_block(totals.known, block, float(np.mean(self.stream.rows)), rows=rows)
        return totals


def streamed_experiment(model: Model, stream: LogStream, smoothing: Smoothing | None = None) -> StreamedExperiment:
    """Make a log ready that is read in pieces; nothing is read yet.

    Raises:
        LogError: a channel is missing.
        ProblemError: another way to smooth than by splines.
    """
    smoothing = smoothing or SmoothingSpline(bandwidth=model.machine.bandwidth)
    if not isinstance(smoothing, SmoothingSpline):
        raise ProblemError("the log is read in pieces, which only a smoothing spline joins", where=stream.path,
                           remedy="leave out --smoothing, or give shorter logs")
    zones = [actuator.name for actuator in model.machine.actuators if actuator.friction.dead_zone is not None]
    if zones or not model.linear:
        what = f"a dead zone in the friction of {', '.join(zones)}" if zones else "friction that is not linear"
        stream.loaded(what)
    if model.calibrator and calibrator_channels(model.machine, stream):
        stream.loaded("an attached calibrator")
    if calls_for_fit(model.machine, stream):
        stream.loaded("a fit of the motion to rates, or to positions that lag,")
    if np.any(force_lags(model, stream)):
        stream.loaded("a lag of forces")
    for channel in sorted(channels_used(model, stream) - set(stream.channels)):
        raise missing(channel, stream.channels, stream.path)
    return StreamedExperiment(model, stream, smoothing)


@singledispatch
def prepared(log: AnyLog, model: Model, smoothing: Smoothing | None = None) -> AnyExperiment:
    """The experiment of a log, in memory or streamed.

    Raises:
        LogError: a channel is missing, or a log is too short.
        ProblemError: it is no log, or it cannot be smoothed in this way.
    """
    raise ProblemError(f"a {type(log).__name__} is no log", where="logs", remedy="read one by read_log or open_log")


prepared.register(Log, lambda log, model, smoothing=None: experiment(model, log, smoothing))
prepared.register(LogStream, lambda log, model, smoothing=None: streamed_experiment(model, log, smoothing))


def _cut(data: Experiment, start: int, stop: int) -> Experiment:
    """Samples `start` to `stop` of an experiment."""
    m, span = data.motion, slice(start, stop)
    motion = Motion(m.t[span], m.q[span], m.qd[span], m.qdd[span], m.segment[span], m.interior[span], m.bandwidth,
                    m.passes, m.notes)
    return replace(data, log=data.log.slice(start, stop), motion=motion, force=data.force[span],
                   known=data.known[span], pressure=None if data.pressure is None else data.pressure[span],
                   calm=None if data.calm is None else data.calm[span])


def _experiment(model: Model, log: Log, angles: Array, motion: Motion, limits: SpeedLimits,
                remarks: tuple[str, ...] = ()) -> Experiment:
    """An experiment of a piece: how often a joint moves in all of the log is not known yet."""
    courses = Courses.of(model)
    phases = Phases.of(courses.measured(angles), courses.smoothed(motion), limits)
    motion, (moving, calm) = phases.at_rest(motion), phases.of_balances(courses)
    force = free_forces(model, log, motion.q)
    read = np.isfinite(force)
    known = dry_friction_known(model, motion, moving, limits.noise[: len(model.machine.joints)]) & read
    return Experiment(model, log, motion, force, known, remarks, pressures(model, log),
                      calm=calm & ~known & read)


def _joined(findings: Iterable[Finding]) -> Iterator[Finding]:
    """Findings of one kind in one channel as one."""
    groups: dict[tuple[str, str], list[Finding]] = {}
    for one in findings:
        groups.setdefault((one.kind, one.channel), []).append(one)
    for (kind, channel), some in groups.items():
        if len(some) == 1:
            yield some[0]
            continue
        count = sum(one.count for one in some)
        yield Finding(kind, channel, some[0].first, some[-1].last, count,
                      f"{some[0].text}; {count} samples in all, the last of them {some[-1].last}")
