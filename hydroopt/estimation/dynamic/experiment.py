"""An experiment: smoothed motion and actuator forces of one log."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import ProblemError
from hydroopt.estimation.dynamic.frequency_bands import BLOCK, ActuatorBands
from hydroopt.estimation.dynamic.friction_sign import (
    FEW_MOVING,
    WINDOW,
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
from hydroopt.logs.calibrator_angles import calibrator_channels
from hydroopt.logs.forces_from_pressures import force_channels, force_lags, pressures
from hydroopt.logs.joint_angles import angle_channels, angle_noise, measured_angles
from hydroopt.logs.log import Log
from hydroopt.logs.mapped import empty, release
from hydroopt.logs.quality import following, usual_step
from hydroopt.logs.smoothing import Motion, Smoother, Smoothing, SmoothingSpline, condition
from hydroopt.logs.tip_wrench import free_forces, tip_wrench, wrench_channels
from hydroopt.logs.treatment import PIECE
from hydroopt.machine.balances import undriven
from hydroopt.model.model import Model
from hydroopt.spatial.inertia import Array

STARTING = 1e-9
"""Speed [rad/s or m/s] at which dry friction is that of a joint that just begins to move."""
ROWS = 1024
"""Samples whose rows are computed together."""
SHOWN = 500_000
"""Samples of a log beyond which figures and diagnostics look at a block of it."""


@dataclass(frozen=True, eq=False)
class Experiment:
    """Motion (N, n) and measured actuator forces (N, n) [N or N·m] of one log.

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
    `shown` are the first and the end of the samples of a long log that figures show and diagnostics look at.
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
    shown: tuple[int, int] | None = None

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
        """The samples that are shown."""
        return self if self.shown is None else self.part(slice(*self.shown))

    def part(self, span: slice) -> Experiment:
        """Some samples of it."""
        m = self.motion
        motion = replace(m, t=m.t[span], q=m.q[span], qd=m.qd[span], qdd=m.qdd[span], segment=m.segment[span],
                         interior=m.interior[span])
        pressure, added = (None if x is None else x[span] for x in (self.pressure, self.added))
        calm = None if self.calm is None else self.calm[span]
        return replace(self, log=self.log.slice(span.start, span.stop), motion=motion, force=self.force[span],
                       known=self.known[span], pressure=pressure, added=added, calm=calm, shown=None)

    def parts(self) -> Iterator[tuple[slice, Experiment]]:
        """The pieces that it is made of, with their places."""
        spans = self.log.spans
        for span in spans:
            yield span, self if len(spans) == 1 else self.part(span)
            release()

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
        found = empty(self.force.shape)
        for span, part in self.parts():
            made = self.model.over(self.model.inverse_dynamics, *part.inputs(), psi)[0][:, :, 0]
            found[span] = made if part.added is None else made + part.added @ psi
        return found

    def moments(self, psi: Array) -> Array:
        """Sums (4, n) over the samples used: 1, force, force² and error² of the prediction by ψ."""
        sums = np.zeros((4, self.force.shape[1]))
        for _, part in self.parts():
            force, predicted = part.force[part.inside], part.predicted(psi)[part.inside]
            read = np.isfinite(force)
            sums += [np.where(read, x, 0.0).sum(axis=0)
                     for x in (np.ones_like(force), force, force**2, (force - predicted) ** 2)]
        return sums

    def blocks(self) -> Iterator[slice]:
        """The samples in blocks: at most `BLOCK` rows of one stretch, by multiples of it from the first row on."""
        sample, segment = self.log.sample, self.motion.segment
        borders = np.searchsorted(sample, np.arange(sample[0], sample[-1] + 1, BLOCK))
        cuts = following(segment, lambda steps: steps != 0)
        edges = np.unique([*borders, *cuts, len(sample)]).tolist()
        for edge in pairwise(edges):
            release()
            yield slice(*edge)

    def _fold(self, bands: ActuatorBands, block: slice, middle: float, psi: Array | None) -> None:
        """Add a block by frequency; `middle` is the row at which the second half of the log begins."""
        (K, *_), force = self.equations(psi, block)
        step = usual_step(self.motion.t[block]) or 1.0
        if bands.noisy.size:
            bands.noise += self._noise(block, step, bands.noisy, psi)
        if self.calm is not None:
            held = self.inside[block] & self.calm[block].T
            spans = [(i, first, end) for i, marks in enumerate(held) for first, end in _spans(marks)]
            dry = has_dry(self.model)
            for (i, first, end), lever in zip(spans, self._levers(block.start, spans, psi), strict=True):
                own, here = bands.own[i], slice(first, end)
                total = np.append(np.where(dry[own], 0.0, K[here, i, own].sum(axis=0)), force[here, i].sum())
                begin, finish = block.start + first, block.start + end - 1
                bands.holds.append(i, Hold(
                    int(self.log.sample[begin]), int(self.log.sample[finish]), float(self.motion.t[begin]),
                    float(self.motion.t[finish]), end - first, total, lever * dry), step)
        bands.fold(K, force, self.inside[block, None] & self.known[block], self.log.sample[block] >= middle, step)

    def _noise(self, block: slice, step: float, free: NDArray[np.intp], psi: Array | None) -> Array:
        """What noise of the angles is expected to add to KᵀK (f, p, p) of the balances `free` in a block."""
        rows = block.start + np.flatnonzero(self.log.sample[block] % STRIDE == 0)
        motion = self.motion

        def equations(q: Array, qd: Array, qdd: Array) -> Array:
            state = replace(self, motion=replace(motion, q=q, qd=qd, qdd=qdd), force=self.force[rows], added=None,
                            pressure=None if self.pressure is None else self.pressure[rows])
            return state.equations(psi)[0][0]

        errors = angle_errors(self._angle_noise, motion.bandwidth, motion.passes, step)
        return regressor_noise(equations, (motion.q[rows], motion.qd[rows], motion.qdd[rows]), errors,
                               self.inside[rows, None] & self.known[rows], free)

    @cached_property
    def _angle_noise(self) -> Array:
        """Standard deviation (n,) of each joint's reading."""
        return angle_noise(self.model, self.log.sampled(angle_channels(self.model, self.log)))

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
        bands = ActuatorBands(self.model.parameters, self.pattern, undriven(self.model.machine.balances))
        middle = float(np.mean(self.log.rows))
        for block in self.blocks():
            self._fold(bands, block, middle, psi)
        return bands

    @property
    def notes(self) -> tuple[str, ...]:
        """How the log was treated, in sentences."""
        held, unused = (np.zeros(self.force.shape[1], dtype=int) for _ in range(2))
        for _, part in self.parts():
            inside = part.inside[:, None] & np.isfinite(part.force)
            calm = np.zeros_like(part.known) if part.calm is None else part.calm
            held += np.sum(inside & calm, axis=0)
            unused += np.sum(inside & ~part.known & ~calm, axis=0)
        shown = () if self.shown is None else (
            "figures and diagnostics show samples {} to {}".format(*self.plotted.log.rows),)
        return (*shown, *self.motion.notes,
                f"{int(np.sum(~self.inside))} of {len(self.inside)} samples at the ends of stretches left out",
                "samples per joint at standstill, whose dry friction is bounded but not known: "
                f"{held.tolist()}; at reversals, where its sign is not known, left out: {unused.tolist()}",
                *self.remarks)


def _spans(marks: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First and end of the samples in a row that are marked (N,)."""
    changes = (np.flatnonzero(marks[1:] != marks[:-1]) + 1).tolist()
    edges = [*([0] if marks[0] else []), *changes, *([len(marks)] if marks[-1] else [])]
    return list(zip(edges[::2], edges[1::2], strict=True))


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
    smoothing = smoothing or SmoothingSpline(bandwidth=machine.bandwidth)
    where, courses = log.path or log.name, Courses.of(model)
    sample, smoother = log, None
    if calls_for_fit(machine, log):
        log, motion, position_std = sensed(machine, log)
        sample, angles = log, motion.q
    else:
        long = len(log.spans) > 1 and isinstance(smoothing, SmoothingSpline)
        sample = log.sampled(angle_channels(model, log)) if long else log
        angles, noise = measured_angles(model, sample), angle_noise(model, sample)
        if not isinstance(smoothing, SmoothingSpline) or not long:
            motion = condition(log.t, angles, log.segment, smoothing, noise, names=machine.joints, where=where)
        else:
            smoother = Smoother.chosen(sample.t, angles, sample.segment, smoothing, noise, machine.joints, where)
            motion = smoother.motion(sample.t, angles, sample.segment, where)
    limits = SpeedLimits.of(courses.measured(angles), courses.smoothed(motion))
    said, lags = remarks(model, given if sample is log else sample, angles), force_lags(model, log)
    margin = np.inf if smoother is None or np.any(lags) else smoother.margin + WINDOW
    made, often = dict[str, NDArray[Any]](), np.zeros(len(machine.balances))
    for piece, own, inner in log.pieces(margin if margin < PIECE * usual_step(sample.t) else np.inf):
        if smoother is not None:
            angles = measured_angles(model, piece)
            motion = smoother.motion(piece.t, angles, piece.segment, where)
        phases = Phases.of(courses.measured(angles), courses.smoothed(motion), limits)
        motion, (moving, calm) = phases.at_rest(motion), phases.of_balances(courses)
        force = free_forces(model, piece, motion.q)
        read = np.isfinite(force)
        known = dry_friction_known(model, motion, moving, limits.noise[: len(machine.joints)]) & read
        found = {"q": motion.q, "qd": motion.qd, "qdd": motion.qdd, "interior": motion.interior, "force": force,
                 "known": known, "calm": calm & read}
        if (pressed := pressures(model, piece)) is not None:
            found["pressure"] = pressed
        often += np.sum(moving[inner], axis=0)
        for name, x in found.items():
            if piece.size == log.size:
                made[name] = x
            else:
                made.setdefault(name, empty((log.size, *x.shape[1:]), x.dtype))[own] = x[inner]
    motion = replace(motion, t=log.t, segment=log.segment, q=made["q"], qd=made["qd"], qdd=made["qdd"],
                     interior=made["interior"])
    attached = attached_calibrator(model, log, motion, smoothing)
    added = None if attached is None else attached.regressor(motion.q, motion.qd, motion.qdd)
    known = made["known"]
    known[:, ~((often > FEW_MOVING * log.size) | ~has_dry_friction(model))] = False
    if np.any(lags):
        known = known_in_spite_of(lags, known, motion)
    np.logical_and(made["calm"], np.logical_not(known), out=made["calm"])
    release()
    shown = None
    if log.size > SHOWN:
        middle = int(np.searchsorted(log.sample, sample.sample[sample.size // 2 // BLOCK * BLOCK]))
        shown = middle, min(middle + BLOCK, log.size)
    result = Experiment(model, log, motion, made["force"], known, (*said, *calibrator_remark(attached)),
                        made.get("pressure"), added, made["calm"], position_std, shown)
    return result._lagging(lags) if np.any(lags) else result


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


def channels_used(model: Model, log: Log) -> set[str]:
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
