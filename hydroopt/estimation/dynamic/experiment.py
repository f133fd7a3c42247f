"""An experiment: smoothed motion and actuator forces of one log."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import ProblemError
from hydroopt.estimation.dynamic.column_basis import ColumnBasis
from hydroopt.estimation.dynamic.folding import ROWS, ActuatorTriangles
from hydroopt.estimation.dynamic.frequency_bands import BLOCK, ActuatorBands
from hydroopt.estimation.dynamic.friction_sign import (
    FEW_MOVING,
    Courses,
    Phases,
    SpeedLimits,
    dry_friction_known,
    has_dry,
    has_dry_friction,
)
from hydroopt.estimation.dynamic.holds import Hold
from hydroopt.estimation.dynamic.lagging_forces import added_by_lags, known_in_spite_of
from hydroopt.estimation.dynamic.regressor_noise import STRIDE, angle_errors, regressor_noise
from hydroopt.estimation.dynamic.with_calibrator import attached_calibrator, calibrator_remark
from hydroopt.estimation.motion.observations import motion_channels
from hydroopt.estimation.motion.sensed import calls_for_fit, sensed
from hydroopt.kernels.native import FEW
from hydroopt.logs.any_log import AnyLog
from hydroopt.logs.calibrator_angles import calibrator_channels
from hydroopt.logs.forces_from_pressures import force_channels, force_lags, pressures
from hydroopt.logs.joint_angles import angle_channels, angle_noise, measured_angles
from hydroopt.logs.log import Log
from hydroopt.logs.quality import usual_step
from hydroopt.logs.smoothing import Motion, Smoothing, SmoothingSpline, condition
from hydroopt.logs.tip_wrench import free_forces, tip_wrench, wrench_channels
from hydroopt.machine.balances import undriven
from hydroopt.model.model import Model
from hydroopt.spatial.inertia import Array

STARTING = 1e-9
"""Speed [rad/s or m/s] at which dry friction is that of a joint that just begins to move."""


class AnyExperiment(Protocol):
    """What estimation needs of an experiment, whether its samples are in memory or streamed from a file."""

    @property
    def model(self) -> Model:
        """What relates its motion to forces."""

    @property
    def log(self) -> AnyLog:
        """The log that it was made of."""

    @property
    def sample_count(self) -> int:
        """Number of samples used."""

    @property
    def pattern(self) -> NDArray[np.bool_]:
        """Which parameters the equations of each actuator have (n, p)."""

    @property
    def plotted(self) -> Experiment:
        """The part that is plotted."""

    @property
    def notes(self) -> tuple[str, ...]:
        """How the log was treated, in sentences."""

    def loaded(self, purpose: str) -> Experiment:
        """The experiment with all samples in memory, which `purpose` needs.

        Raises:
            ProblemError: the log is read in pieces.
        """

    def fold_into(self, triangles: ActuatorTriangles, psi: Array | None = None, weights: Array | None = None) -> None:
        """Add the equations, linearised at `psi` (p,); `weights` (N, n) multiply squared residuals."""

    def moments(self, psi: Array) -> Array:
        """Sums (4, n) over the samples used: 1, force, force² and error² of the prediction by ψ."""

    def bands(self, psi: Array | None = None) -> ActuatorBands:
        """The equations, linearised at `psi` (p,), by frequency."""


@dataclass(frozen=True, eq=False)
class Experiment:
    """Motion (N, n) and measured actuator forces (N, n) [N or N·m] of one log, all samples in memory.

    Where the log states a wrench at the tip, what it adds is taken out of the forces.
    `inside` (N,) is False near the ends of a stretch, where derivatives of noisy angles are worse: those samples are
    not used for estimation and validation. `known` (N, n) is False where an actuator's dry friction is not known, since
    the sign of its joint's velocity is not (Eq. 4.51, see `friction_sign`): those samples are not used one by one.
    Where the joint is `calm` (N, n) then, each hold is one equation (`holds`); None stands for nowhere. `force` is NaN
    where the log does not tell it; it is neither `known` nor `calm` there. `remarks`
    state which channels were not used and how measured lengths compare with the geometry. `pressure` (N, n) [Pa] is
    p_head + p_rod of each cylinder whose seals' friction depends on it and 0 for all other actuators; None where no
    friction does. `added` (N, n, p) is what an attached calibrator, lags or faults of instruments add to the regressor.
    `position_std` (n,) is the standard deviation of the joints' positions where the motion is fitted to other sensors.
    """

    model: Model
    log: Log
    motion: Motion
    force: Array
    known: NDArray[np.bool_]
    remarks: tuple[str, ...] = ()
    pressure: Array | None = None
    added: Array | None = None
    calm: NDArray[np.bool_] | None = None
    position_std: Array | None = None

    def inputs(self, rows: slice | NDArray[np.intp] = slice(None)) -> tuple[Array, ...]:
        """Inputs of the model's regressor and inverse dynamics: q, qd, qdd and, where needed, pressure (·, n)."""
        motion = (self.motion.q[rows], self.motion.qd[rows], self.motion.qdd[rows])
        return motion if self.pressure is None else (*motion, self.pressure[rows])

    @property
    def pattern(self) -> NDArray[np.bool_]:
        """Which parameters the equations of each actuator have (n, p)."""
        own = self.model.regressor_pattern
        return own if self.added is None else np.asarray(own | np.any(self.added != 0, axis=0))

    @property
    def inside(self) -> NDArray[np.bool_]:
        """Samples that are used (N,)."""
        return self.motion.interior

    @property
    def sample_count(self) -> int:
        """Number of samples used."""
        return int(np.sum(self.inside))

    @property
    def plotted(self) -> Experiment:
        """The part that is plotted: all of it."""
        return self

    def loaded(self, purpose: str) -> Experiment:
        """The experiment itself; one that is streamed raises an error."""
        return self

    def equations(self, psi: Array | None = None, rows: slice | NDArray[np.intp] = slice(None),
                  out: list[Array] | None = None) -> tuple[list[Array], Array]:
        """K (m, n, p), first of a list that `out` may reuse, and f (m, n) of ``K·ψ = f``.

        Forces that are not linear in the parameters are linearised at `psi` (p,), by default at the nominal ones.
        """
        model = self.model
        force = self.force[rows]
        if model.linear:
            made = model.over(model.regressor, *self.inputs(rows), out=out)
        else:
            psi = model.parameters.nominal if psi is None else psi
            made = model.over(model.linearised, *self.inputs(rows), psi, out=out)
            force = force - made[1][:, :, 0] + made[0] @ psi
        if self.added is not None:
            made[0] = made[0] + self.added[rows]
        return made, force

    def chunks(self, psi: Array | None = None) -> Iterator[tuple[NDArray[np.intp], Array, Array]]:
        """Sample indices, K (m, n, p) and f (m, n) of samples used; the next chunk may overwrite K."""
        used = np.flatnonzero(self.inside)
        reused: list[Array] | None = None
        for start in range(0, len(used), ROWS):
            rows = used[start : start + ROWS]
            reused = reused if reused is not None and len(reused[0]) == len(rows) else None
            reused, force = self.equations(psi, rows, reused)
            yield rows, reused[0], force

    def fold_into(self, triangles: ActuatorTriangles, psi: Array | None = None, weights: Array | None = None) -> None:
        """Add the equations, linearised at `psi`; `weights` (N, n) multiply squared residuals."""
        for rows, K, force in self.chunks(psi):
            if weights is None:
                triangles.fold(K, force, self.known[rows])
            else:
                root = np.sqrt(weights[rows])
                triangles.fold(K * root[:, :, None], force * root, self.known[rows])

    def _lagging(self, lags: Array) -> Experiment:
        """With forces that are predicted with the lags (r,) [s] of their readings.

        Raises:
            ProblemError: forces are not linear in the parameters.
        """
        if not self.model.linear:
            raise ProblemError("lags of forces cannot be combined with friction that is not linear",
                               where=self.log.path or self.log.name,
                               remedy="leave out the 'lag' of pressures and forces, and free it: --free lag")
        made = added_by_lags(self.equations()[0][0], lags, self.motion)
        return replace(self, added=made if self.added is None else self.added + made)

    def predicted(self, psi: Array) -> Array:
        """Actuator forces (N, n) that the parameters ψ predict for the motion."""
        made = self.model.over(self.model.inverse_dynamics, *self.inputs(), psi)[0][:, :, 0]
        return made if self.added is None else np.asarray(made + self.added @ psi)

    def moments(self, psi: Array) -> Array:
        """Sums (4, n) over the samples used: 1, force, force² and error² of the prediction by ψ."""
        force, predicted = self.force[self.inside], self.predicted(psi)[self.inside]
        read = np.isfinite(force)
        return np.array([np.where(read, x, 0.0).sum(axis=0)
                         for x in (np.ones_like(force), force, force**2, (force - predicted) ** 2)])

    def blocks(self, origin: int, span: tuple[int, int]) -> Iterator[slice]:
        """The samples `span` (first, end) in blocks: at most `BLOCK` rows of one stretch, by multiples of it from the
        row `origin` on.
        """
        place = (self.log.sample[slice(*span)] - origin) // BLOCK
        new = (np.diff(place, prepend=-1) != 0) | (np.diff(self.motion.segment[slice(*span)], prepend=-1) != 0)
        for a, b in pairwise([*np.flatnonzero(new).tolist(), len(new)]):
            yield slice(span[0] + a, span[0] + b)

    def fold_block(self, bands: ActuatorBands, block: slice, middle: float, psi: Array | None = None,
                   rows: Sequence[Array] | None = None) -> None:
        """Add a block by frequency; `middle` is the row at which the second half of the log begins.

        `rows` are those that the bands take, which are written over, if they are known.
        """
        if rows is None:
            (K, *_), force = self.equations(psi, block)
            rows = [basis.rows(K, force, i) for i, basis in enumerate(bands.bases)]
        t = self.motion.t[block]
        step = usual_step(t) or 1.0
        if bands.noisy.size:
            bands.noise += self._noise(block, step, bands.noisy, psi)
        if self.calm is not None:
            held = self.inside[block] & self.calm[block].T
            spans = [(i, first, end) for i, marks in enumerate(held) for first, end in _spans(marks)]
            dry = has_dry(self.model) if spans else np.zeros(0, dtype=bool)
            for (i, first, end), lever in zip(spans, self._levers(block.start, spans, psi), strict=True):
                basis, sums = bands.bases[i], rows[i][:, first:end].sum(axis=1)
                total = np.append(basis.spread(sums[:-1]), sums[-1])
                total[:-1][dry[basis.own]] = 0.0
                begin, finish = block.start + first, block.start + end - 1
                bands.holds.append(i, Hold(
                    int(self.log.sample[begin]), int(self.log.sample[finish]), float(self.motion.t[begin]),
                    float(self.motion.t[finish]), end - first, total, lever * dry), step)
        bands.fold(rows, self.inside[block, None] & self.known[block], self.log.sample[block] >= middle, step)

    def _noise(self, block: slice, step: float, free: NDArray[np.intp], psi: Array | None) -> Array:
        """What noise of the angles is expected to add to KᵀK (f, p, p) of the balances `free` in a block."""
        rows = block.start + np.flatnonzero(self.log.sample[block] % STRIDE == 0)
        motion = self.motion

        def equations(q: Array, qd: Array, qdd: Array) -> Array:
            state = replace(self, motion=replace(motion, q=q, qd=qd, qdd=qdd), force=self.force[rows], added=None,
                            pressure=None if self.pressure is None else self.pressure[rows])
            return state.equations(psi)[0][0]

        errors = angle_errors(angle_noise(self.model, self.log), motion.bandwidth, motion.passes, step)
        return regressor_noise(equations, (motion.q[rows], motion.qd[rows], motion.qdd[rows]), errors,
                               self.inside[rows, None] & self.known[rows], free)

    def _levers(self, origin: int, spans: Sequence[tuple[int, int, int]], psi: Array | None) -> Array:
        """Sizes (h, p) of an actuator's columns just before its joint moves that rests in the spans (actuator, first
        sample, end) of a block that begins at `origin`."""
        if not spans:
            return np.zeros((0, len(self.model.parameters)))
        actuators, first, _ = np.array(spans).T
        which = np.arange(max(len(spans), FEW)) % len(spans)  # as many as the compiled kernel takes
        rows = origin + first[which]
        starts = np.zeros_like(self.motion.qd[rows])
        starts[np.arange(len(which)), np.array(self.model.dynamics.kept)[actuators[which]]] = STARTING
        state = replace(self, motion=replace(self.motion, q=self.motion.q[rows], qd=starts, qdd=0 * starts),
                        force=self.force[rows], added=None,
                        pressure=None if self.pressure is None else self.pressure[rows])
        return np.asarray(np.abs(state.equations(psi)[0][0][np.arange(len(spans)), actuators]))

    def bands(self, psi: Array | None = None) -> ActuatorBands:
        """The equations, linearised at `psi` (p,), by frequency."""
        bases, middle = [ColumnBasis.whole(np.flatnonzero(row)) for row in self.pattern], float(np.mean(self.log.rows))
        bands = ActuatorBands(self.model.parameters, bases, undriven(self.model.machine.balances))
        for block in self.blocks(self.log.rows[0], (0, len(self.force))):
            self.fold_block(bands, block, middle, psi)
        return bands

    @property
    def notes(self) -> tuple[str, ...]:
        """How the log was treated, in sentences."""
        left_out = f"{int(np.sum(~self.inside))} of {len(self.inside)} samples at the ends of stretches left out"
        inside = self.inside[:, None] & np.isfinite(self.force)
        calm = np.zeros_like(self.known) if self.calm is None else self.calm
        held, unused = inside & calm, inside & ~self.known & ~calm
        return (*self.motion.notes, left_out, standstill_note(np.sum(held, axis=0), np.sum(unused, axis=0)),
                *self.remarks)


def _spans(marks: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First and end of the samples in a row that are marked (N,)."""
    changes = (np.flatnonzero(marks[1:] != marks[:-1]) + 1).tolist()
    edges = [*([0] if marks[0] else []), *changes, *([len(marks)] if marks[-1] else [])]
    return list(zip(edges[::2], edges[1::2], strict=True))


def standstill_note(held: NDArray[np.intp], unused: NDArray[np.intp]) -> str:
    """How many samples of each joint (n,) stand still and bound their dry friction only, and how many are left out."""
    return (f"samples per joint at standstill, whose dry friction is bounded but not known: {held.tolist()}; "
            f"at reversals, where its sign is not known, left out: {unused.tolist()}")


def experiment(model: Model, log: Log, smoothing: Smoothing | None = None) -> Experiment:
    """Make an experiment of a log: smooth its motion and compute its forces.

    Joint angles are read from ``<joint>.q`` or, where a log lacks them, from the length of the cylinder that moves the
    joint. Forces are those of the pressures (Eq. 4.33, 4.61) or, where a log lacks one of them, ``<cylinder>.force`` or
    ``<joint>.tau``; where it lacks these too, the equations of other actuators remain. A log with angles of the
    calibrator's joints was recorded with the calibrator attached, see `attached_calibrator`. Channels that are not used
    are named in the notes.

    Raises:
        LogError: a channel is missing or in a unit that does not suit its joint, or a length at which a triangle is
            open.
        ProblemError: the machine has no parameters that forces depend on, or the attached calibrator cannot have moved
            as the log says.
    """
    machine, given, position_std = model.machine, log, None
    refuse_nothing_to_determine(model)
    if calls_for_fit(machine, log):
        log, motion, position_std = sensed(machine, log)
        angles = motion.q
    else:
        angles = measured_angles(model, log)
        motion = condition(log.t, angles, log.segment, smoothing or SmoothingSpline(bandwidth=machine.bandwidth),
                           angle_noise(model, log), names=machine.joints, where=log.path or log.name)
    courses = Courses.of(model)
    positions, followed = courses.measured(angles), courses.smoothed(motion)
    limits = SpeedLimits.of(positions, followed)
    phases = Phases.of(positions, followed, limits)
    motion, (moving, calm) = phases.at_rest(motion), phases.of_balances(courses)
    often = np.mean(moving, axis=0) > FEW_MOVING
    attached = attached_calibrator(model, log, motion, smoothing or SmoothingSpline(bandwidth=machine.bandwidth))
    added = None if attached is None else attached.regressor(motion.q, motion.qd, motion.qdd)
    lags, force = force_lags(model, log), free_forces(model, log, motion.q)
    read = np.isfinite(force)
    known = dry_friction_known(model, motion, moving, limits.noise[: len(machine.joints)])
    known &= (often | ~has_dry_friction(model)) & read
    made = Experiment(model, log, motion, force, known_in_spite_of(lags, known, motion),
                      (*remarks(model, given, angles), *calibrator_remark(attached)), pressures(model, log), added,
                      calm & ~known & read, position_std)
    return made._lagging(lags) if np.any(lags) else made


def refuse_nothing_to_determine(model: Model) -> None:
    """Refuse a machine whose forces depend on no parameters.

    Raises:
        ProblemError: it has neither bodies nor friction.
    """
    if not len(model.parameters):
        raise ProblemError("the machine file states neither bodies nor friction, so that no log determines anything",
                           where=model.machine.name, remedy=(
                               "state m, com and inertia_com in the 'body' of its links, and the 'friction' of its "
                               "drives"))


def channels_used(model: Model, log: AnyLog) -> set[str]:
    """The channels that angles, forces and pressures are read from."""
    machine = model.machine
    motion = {*motion_channels(machine, log.channels)} if calls_for_fit(machine, log) else angle_channels(model, log)
    return (motion | force_channels(model, log) | wrench_channels(log)
            | (calibrator_channels(model.machine, log) if model.calibrator else set()))


def remarks(model: Model, log: Log, angles: Array) -> tuple[str, ...]:
    """Which channels are not used, and how measured lengths compare with the geometry."""
    used = channels_used(model, log)
    return (*_wrench(log), *_unused(log, used), *_length_check(model, log, used, angles))


def _wrench(log: Log) -> Iterator[str]:
    wrench = tip_wrench(log)
    if wrench is not None:
        largest = np.max(np.linalg.norm(wrench[:, :3], axis=1))
        yield (f"a wrench at the tip is measured, with forces of up to {largest:.4g} N: what it adds to the actuator "
               "forces is taken out of them")


def _unused(log: Log, used: set[str]) -> tuple[str, ...]:
    rest = [channel for channel in log.channels if channel not in used]
    return (f"not used: {', '.join(rest)}",) if rest else ()


def _length_check(model: Model, log: Log, used: set[str], angles: Array) -> Iterator[str]:
    """Differences of measured cylinder lengths from the geometry, for lengths that angles were not computed from."""
    lengths = [(k, f"{c.name}.length") for k, c in enumerate(model.machine.cylinders)
               if f"{c.name}.length" in log.channels and f"{c.name}.length" not in used]
    if not lengths:
        return
    expected = model.over(model.cylinder_kinematics, angles, 0 * angles, 0 * angles)[0][:, :, 0]
    for k, channel in lengths:
        off = 1e3 * (log.channel(channel) - expected[:, k])
        yield f"{channel} differs from the geometry by {np.mean(off):.1f} mm mean, {np.std(off):.1f} mm std"
