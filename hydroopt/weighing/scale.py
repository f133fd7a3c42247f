"""A scale: an identified machine with what is uncertain of it, and the load that it is to weigh."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from hydroopt.errors import ProblemError
from hydroopt.estimation.dynamic.problem import IdentificationProblem
from hydroopt.estimation.dynamic.stored_information import StoredInformation, stored_information
from hydroopt.estimation.inference.whitening import GaussianPosterior, gaussian_posterior
from hydroopt.logs.forces_from_pressures import force_noise
from hydroopt.logs.frames import all_of
from hydroopt.logs.log import Log
from hydroopt.machine.actuators import Cylinder, Motor
from hydroopt.machine.given_machine import GivenMachine
from hydroopt.machine.parameter_kind import ParameterKind
from hydroopt.model.carried_load import carried_load
from hydroopt.model.kinematics import gravity_in_base
from hydroopt.model.model import Model, model_of
from hydroopt.simulation.simulate import Trajectory, random_trajectory
from hydroopt.spatial.inertia import Array
from hydroopt.weighing.gaussian import Gaussian
from hydroopt.weighing.smoothed_log import smoothed_log

NEGLIGIBLE = 1e-3
"""RMS force, per σ of a sensor, below which a direction of the model's uncertainty is left out."""
STEEPEST = 0.5
"""Cosine of the angle from the machine file's gravity up to which a slope is taken."""
STEEP = np.radians(5.0)
"""Slope of the base at which it is measured [rad]."""
UNKNOWN_GAIN = 0.1
"""Standard deviation of the relative error of each force reading before a known load determines it, if none is
stated."""
TRIALS, TRIAL_DURATION, TRIAL_RATE = 8, 60.0, 5.0
"""How many random motions stand for a calibration's where its logs are not there, their duration [s] and rate [Hz]."""


@dataclass(frozen=True)
class CarriedLoad:
    """What a scale weighs, in the frame of the link that carries it.

    Attributes:
        link: the name of the link.
        centre: where the centre of mass is expected [m].
        centre_std: standard deviation of its place, each coordinate's or one for all [m].
        full_scale: the largest mass [kg].
        radius: of gyration about the expected centre, about [m].

    See `weigh` for an example.
    """

    link: str
    centre: tuple[float, float, float]
    centre_std: tuple[float, float, float]
    full_scale: float
    radius: float = 0.5

    def __post_init__(self) -> None:
        numbers = (*self.centre, *self.centre_std, self.full_scale, self.radius)
        if not np.all(np.isfinite(numbers)) or min(*self.centre_std, self.full_scale, self.radius) <= 0:
            raise ProblemError("a load needs finite numbers, and standard deviations, full scale and radius above 0",
                               where="load", remedy="state its centre in m, its sigma in m, the full scale in kg")


@dataclass(frozen=True)
class Uncertain:
    """Standard deviations of what no calibration tells.

    Attributes:
        slope: of the base's inclination, in each direction [rad].
        load_friction: of the friction that grows with the force, as a part of it.
        zero_drift: of each pressure's zero since the calibration [Pa].
        gain: of the relative error of force readings, the same in the calibration: of piston areas, torques per
            pressure and sensors' scales. Without a known load it is that of every mass. By default the machine file's
            ``[faults] gain``; if neither is stated, readings are taken as exact, but a known load determines their
            errors from `UNKNOWN_GAIN` on.

    Raises:
        ProblemError: the gain is negative, or not less than 1.

    See `weigh` for an example of a scale, which takes them as `uncertain`.
    """

    slope: float = float(np.radians(3.0))
    load_friction: float = 0.01
    zero_drift: float = 35e3
    gain: float | None = None

    def __post_init__(self) -> None:
        if self.gain is not None and not 0 <= self.gain < 1:
            raise ProblemError(f"a relative error must be at least 0 and less than 1, not {self.gain:g}", where="gain",
                               remedy="give a part of one, such as 0.02")


@dataclass(frozen=True, eq=False)
class ForceReadings:
    """What errors in scale of force readings, the same in the calibration and afterwards, have done to it.

    Attributes:
        taken: (p, r) what each force's readings contribute to the calibrated parameters.
        too_large: (r,) what calibration and known loads tell of the part of each force that is read too much.
        std: of that part before the calibration.
    """

    taken: Array
    too_large: Gaussian
    std: float


@dataclass(frozen=True, eq=False)
class Scale:
    """An identified machine that weighs; `scale` makes one, `learned` refines it.

    Its own unknowns are, in this order: k numbers of the model, in directions that are independent and standard normal
    after the calibration; the friction of r balances per force; while it learns from a known load the part of each of
    the r forces that is read too much; two components of gravity [m/s²] across that of the machine file, along the
    base's x and y where z points up.

    Attributes:
        model: of the machine.
        psi: (p,) identified parameters.
        directions: (p, k) of what is uncertain of them.
        taken: (p, r) what the calibration took for parameters, per friction that grows with the force of each balance;
            while it learns from a known load, (p, 2·r), also per part of each force that is read too much.
        load: what it weighs.
        own: what is known of its own unknowns.
        uncertain: what no calibration tells.
        angle_std: (n,) noise of the joints' positions; force_std: (r,) of forces.
        tilt: roll and pitch of the base as stated, and their standard deviation [rad].
        gain: standard deviation of the relative error that all masses have in common.
        read: (r,) part of each force's readings that is taken off, as known loads tell it.
        known_loads: number of known loads that it has learned from.
        readings: what lets a known load determine errors in scale; None where they are stated to be exact.
        drifts: (k, a) part in the model's numbers of what drifts from session to session.

    See `weigh` for an example.
    """

    model: Model
    psi: Array
    directions: Array
    taken: Array
    load: CarriedLoad
    own: Gaussian
    uncertain: Uncertain
    angle_std: Array
    force_std: Array
    tilt: tuple[float, float, float]
    gain: float
    readings: ForceReadings | None
    drifts: Array
    read: Array
    known_loads: int = 0

    @cached_property
    def carried(self) -> Array:
        """(p, 10): what the load adds to ψ; its ten numbers stand about its expected centre."""
        return carried_load(self.model, self.load.link, self.load.centre)

    @cached_property
    def gravity(self) -> Array:
        """(3,) that of the machine file in the base frame [m/s²]."""
        return np.asarray(gravity_in_base(self.model.machine)).ravel()

    @cached_property
    def axes(self) -> Array:
        """(3, 3): unit vectors in the base frame, two across the machine file's gravity and one along it."""
        return _axes(self.gravity)

    @property
    def count(self) -> int:
        """Number of its own unknowns."""
        return len(self.own.right)

    @property
    def gains(self) -> int:
        """Number of force readings whose error in scale is an own unknown: all or none."""
        return int(self.taken.shape[1]) - len(self.force_std)

    @property
    def exact(self) -> bool:
        """Whether force readings are taken to be right in scale."""
        return not self.known_loads and self.gain == 0

    def on_slope(self, roll: float, pitch: float, std: float | None = None) -> Scale:
        """The same scale on another slope: roll and pitch of the base [rad] as an inclinometer reads them.

        Friction and bodies stay as they were learned; what was learned of the former slope goes.

        Raises:
            ProblemError: gravity is nearly across that of the machine file.
        """
        std = self.uncertain.slope if std is None else std
        size = float(np.linalg.norm(self.gravity))
        down = self.axes @ np.array([np.sin(pitch), -np.sin(roll) * np.cos(pitch), -np.cos(roll) * np.cos(pitch)])
        if not down[2] > STEEPEST:
            raise ProblemError("this slope turns gravity more than 60 degrees from that of the machine file",
                               where="slope", remedy="give roll and pitch of the base as the file's orientation has "
                                                     "them, in rad")
        mean = size * down[:2]
        tilt = slice(self.count - 2, self.count)
        return replace(self, tilt=(roll, pitch, std),
                       own=self.own.without(tilt).and_independent(mean, np.full(2, size * std)))


def with_gains(scale: Scale) -> Scale:
    """The same scale with the errors in scale of force readings among its own unknowns, if there may be any."""
    if scale.readings is None:
        return scale
    own = scale.own.without(slice(scale.count - 2, scale.count)).and_other(scale.readings.too_large)
    own, wrong = own.and_independent(np.zeros(2), np.ones(2)), scale.readings.taken
    made = replace(scale, psi=scale.psi + wrong @ scale.read, read=np.zeros(len(scale.read)), own=own,
                   taken=np.hstack([scale.taken, wrong]), gain=0.0)
    return made.on_slope(*scale.tilt)


def corrected(scale: Scale, known: Gaussian, weights: Array) -> Scale:
    """The scale after a known load: its readings are corrected, and what is left of their errors is that of masses.

    Were these errors unknowns beside a load that is weighed, samples linearised at different loads would seem to tell
    the ones from the other.

    Args:
        scale: with gains.
        known: of its own unknowns after the known load.
        weights: (r,) of the forces in a load's mass, which add up to 1.
    """
    if scale.readings is None:
        return replace(scale, own=known, known_loads=scale.known_loads + 1)
    r, k = len(scale.read), scale.count - 2 - len(scale.read)
    at = slice(k, k + r)
    covariance, read = known.covariance[at, at], known.mean[at]
    root = np.asarray(np.linalg.cholesky(np.linalg.inv(covariance))).T
    own = known.without(slice(k, scale.count)).and_independent(np.zeros(2), np.ones(2))
    return replace(scale, psi=scale.psi - scale.readings.taken @ read, read=read, own=own, taken=scale.taken[:, :r],
                   gain=float(np.sqrt(weights @ covariance @ weights)), known_loads=scale.known_loads + 1,
                   readings=replace(scale.readings, too_large=Gaussian(root, root @ read)))


def in_another_session(scale: Scale) -> Scale:
    """The same scale after pressures' zeros have drifted anew; on the slope as stated."""
    own = scale.own.without(slice(scale.count - 2, scale.count))
    by, k = np.eye(len(own.right)), len(scale.drifts)
    by[:k, :k] -= scale.drifts @ scale.drifts.T
    own = own.changed(by, np.eye(len(by)) - by @ by)
    return replace(scale, own=own.and_independent(np.zeros(2), np.ones(2))).on_slope(*scale.tilt)


def scale(machine: Model | GivenMachine, calibration: Log | Sequence[Log] | str | Path, load: CarriedLoad, *,
          uncertain: Uncertain = Uncertain()) -> Scale:
    """A scale of a calibrated machine.

    Args:
        machine: nominal description without load, or its model.
        calibration: logs without load, or the folder that `hydroopt identify` wrote from them. Logs weigh better: they
            tell what friction that grows with the force has done to the parameters.
        load: what is to be weighed.
        uncertain: standard deviations of what the calibration does not tell.

    Raises:
        LogError: a log cannot be used.
        ProblemError: the machine cannot weigh: no link of that name, friction that depends on pressures or is not
            linear, or sensors without a stated accuracy.

    See `weigh` for an example.
    """
    model = model_of(machine, "scale")
    machine = model.machine
    model.refuse_seals("scale")
    with threadpool_limits(limits=1, user_api="blas"):
        given = None if isinstance(calibration, str | Path) else all_of(calibration, (Log,), "log", machine.name)
        known = stored_information(model, calibration if given is None else given)
        logs = None if given is None else [smoothed_log(model, each) for each in given]
        p = len(model.parameters)
        if len(known.triangles) != len(machine.balances):
            raise ProblemError("this calibration weighted the residuals of all actuators jointly", where=machine.name,
                               remedy="give its logs, or identify without --correlated, --fitted-motion and "
                                      "--instruments")
        rows = known.triangles.reshape(-1, p + 1)
        found = gaussian_posterior(IdentificationProblem(model, ()), rows[:, :p], rows[:, p])
    angle_std = np.array([sensor.std if (sensor := machine.sensor(f"{joint}.q")) else np.nan
                          for joint in machine.joints])
    force_std = force_noise(model)
    if not np.all(np.isfinite(angle_std)) or not np.all(force_std > 0):
        raise ProblemError("a scale needs the accuracy of all sensors", where=machine.name,
                           remedy="state [[sensors]] with 'accuracy' for angles and pressures")
    trials = [random_trajectory(model, duration=TRIAL_DURATION, rate=TRIAL_RATE, seed=seed) for seed in range(TRIALS)]
    K = model.over(model.linearised, trials[0].q, trials[0].qd, trials[0].qdd, found.offset)[0]
    G = model.over(model.gravity_regressor, trials[0].q)[0].reshape(len(K), 3, *K.shape[1:])
    driven = trials if logs is None else [Trajectory(
        np.concatenate([each.t for each in logs]), np.concatenate([each.q for each in logs]),
        np.concatenate([each.qd for each in logs]), np.concatenate([each.qdd for each in logs]))]
    taken = np.array([_taken_for_friction(model, known, found, motion) for motion in driven])
    scatter = uncertain.load_friction * np.concatenate([*(taken - taken.mean(axis=0))], axis=1) / np.sqrt(len(taken))
    taken = taken.mean(axis=0)
    drifts = _drifts(model, uncertain.zero_drift)
    slope = np.hstack([found.slope, drifts, scatter])
    across = _axes(np.asarray(gravity_in_base(machine)).ravel())[:2]
    tilted = machine.gravity * STEEP * np.einsum("ac,mcrp->amrp", across, G)
    axes = _shown(np.concatenate([K, *tilted]), slope, force_std)
    directions = slope @ axes
    r, size = len(machine.balances), machine.gravity
    own = Gaussian.independent(
        np.zeros(directions.shape[1] + r),
        np.concatenate([np.ones(directions.shape[1]), np.full(r, uncertain.load_friction)]))
    own = own.and_independent(np.zeros(2), np.full(2, size * uncertain.slope))
    gain = machine.faults.gain if uncertain.gain is None else uncertain.gain
    readings = None if gain == 0 else _readings(known, found, gain or UNKNOWN_GAIN)
    return Scale(model, found.offset, directions, taken, load, own, uncertain, angle_std, force_std,
                 (*machine.orientation[:2], uncertain.slope), gain or 0.0, readings,
                 axes[p : p + drifts.shape[1]].T, np.zeros(r))


def _axes(gravity: Array) -> Array:
    """(3, 3): unit vectors, two across gravity (3,), near coordinate axes, and one along it."""
    down = gravity / np.linalg.norm(gravity)
    across = np.eye(3)[np.sort(np.argsort(np.abs(down), kind="stable")[:2])]
    first = across[0] - (across[0] @ down) * down
    first /= np.linalg.norm(first)
    second = across[1] - (across[1] @ down) * down - (across[1] @ first) * first
    return np.stack([first, second / np.linalg.norm(second), down])


def acting(model: Model, q: Array, sign: Array) -> Array:
    """Direction (N, r) of each balance's actuator from that of its joint: a cylinder may shorten as the angle grows."""
    machine, made = model.machine, np.array(sign)
    arms = model.over(model.transmission, q)[0]
    for k, (balance, joint) in enumerate(zip(machine.balances, model.dynamics.kept, strict=True)):
        if balance.alone is not None:
            made[:, k] *= np.sign(arms[:, machine.actuators.index(balance.alone), joint])
    return made


def _drifts(model: Model, std: float) -> Array:
    """(p, a): what drifts of the pressures' zeros do to the forces' offsets."""
    machine, names, columns = model.machine, model.parameters.names, []
    for actuator in machine.measured_actuators:
        if not isinstance(actuator, Cylinder | Motor):
            continue
        size = std * float(np.linalg.norm([*actuator.effort_factors.values()]))
        offsets = [k for k, (name, kind) in enumerate(zip(names, model.parameters.kinds, strict=True))
                   if kind is ParameterKind.FORCE_OFFSET and model.parameters.owner(name) in
                   (actuator.name, getattr(actuator, "joint", ""))]
        column = np.zeros(len(names))
        column[offsets] = size
        columns.append(column)
    return np.column_stack(columns) if columns else np.zeros((len(names), 0))


def _shown(K: Array, slope: Array, force_std: Array) -> Array:
    """Axes (z, k), orthonormal, of what forces show of ``slope·z``.

    What predicts the same forces within `NEGLIGIBLE` in a motion with the regressors K (N, r, p) is left out.
    """
    seen = (K @ slope / force_std[:, None]).reshape(-1, slope.shape[1]) / np.sqrt(len(K))
    squares, axes = np.linalg.eigh(seen.T @ seen)
    return np.asarray(axes[:, squares > NEGLIGIBLE**2])


def _taken_for_friction(model: Model, known: StoredInformation, found: GaussianPosterior,
                        motion: Trajectory) -> Array:
    """(p, r): by how much the calibrated ψ are too large per unit of a friction that grows with the force.

    The calibration's model has no such friction; the parameters that imitate it best in the calibration's motion are
    found as far as the calibration's information lets them.
    """
    K, force = model.over(model.linearised, motion.q, motion.qd, motion.qdd, found.offset)
    friction = np.abs(force[:, :, 0]) * acting(model, motion.q, np.sign(motion.qd[:, model.dynamics.kept]))
    size, p, made = np.max(np.abs(K), axis=(0, 1)), K.shape[2], []
    scale = np.where(size > 0, 1 / np.maximum(size, 1e-300), 0.0)
    for k, (column, triangle) in enumerate(zip(friction.T, known.triangles, strict=True)):
        imitated = scale * np.linalg.lstsq(K[:, k] * scale, column, rcond=1e-6)[0]
        rows = triangle[:, :p]
        made.append(found.slope @ (found.slope.T @ (rows.T @ (rows @ imitated))))
    return np.column_stack(made)


def _readings(known: StoredInformation, found: GaussianPosterior, std: float) -> ForceReadings:
    """What errors in scale of the readings, of this standard deviation each, did to the calibration, and what it tells
    of them.

    The estimate is linear in the readings, so that their parts of it hold for errors of any size. The calibration tells
    whether single forces contradict the others, and all together the stated masses. Forces count there as it predicts
    them: readings with their noise would be explained best by an error that takes all of the reading away.
    """
    r, rows, read = len(known.triangles), known.triangles[:, :, :-1], known.triangles[:, :, -1]
    taken = found.slope @ (found.slope.T @ np.einsum("rip,ri->pr", rows, read))
    predicted = rows @ found.offset
    by_error = np.zeros((*predicted.shape, r))
    by_error[range(r), :, range(r)] = predicted
    shown, by_error = (rows @ found.slope).reshape(-1, rows.shape[2]), by_error.reshape(-1, r)
    imitated = shown.T @ by_error
    left = by_error - shown @ imitated
    information = left.T @ left + imitated.T @ (imitated - shown.T @ (shown @ imitated)) + np.eye(r) / std**2
    root = np.asarray(np.linalg.cholesky(information)).T
    pull = np.sum(predicted * (read - predicted), axis=1)
    return ForceReadings(taken, Gaussian(root, np.asarray(np.linalg.solve(root.T, pull))), std)
