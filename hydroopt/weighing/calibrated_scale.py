"""How a calibrated machine becomes a scale: what its logs say of bodies, friction and noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.linalg import block_diag
from threadpoolctl import threadpool_limits

from hydroopt.errors import ProblemError
from hydroopt.estimation.dynamic.problem import IdentificationProblem
from hydroopt.estimation.dynamic.stored_information import StoredInformation, stored_information
from hydroopt.estimation.inference.whitening import GaussianPosterior, gaussian_posterior
from hydroopt.logs.forces_from_pressures import force_noise
from hydroopt.logs.frames import all_of
from hydroopt.logs.log import Log
from hydroopt.machine.actuators import Cylinder, Motor
from hydroopt.machine.balances import undriven
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import GivenMachine
from hydroopt.model.kinematics import gravity_in_base
from hydroopt.model.model import Model, model_of
from hydroopt.simulation.simulate import Trajectory, random_trajectory
from hydroopt.spatial.inertia import Array
from hydroopt.weighing.equations import Equations, equations
from hydroopt.weighing.scale import CarriedLoad, ForceReadings, Gaussian, Scale, Uncertain, axes_about
from hydroopt.weighing.smoothed_log import actuator_speeds, smoothed_log

NEGLIGIBLE = 1e-3
"""RMS force, per σ of a sensor, below which a direction of the model's uncertainty is left out."""
STEEP = np.radians(5.0)
"""Slope of the base at which it is measured [rad]."""
UNKNOWN_GAIN = 0.1
"""Standard deviation of the relative error of each force reading before a known load determines it, if none is
stated."""
TRIALS, TRIAL_DURATION, TRIAL_RATE = 8, 60.0, 5.0
"""How many random motions stand for a calibration's where its logs are not there, their duration [s] and rate [Hz]."""
FEWEST = 50
"""Number of smoothed samples of a moving joint from which the noise of its force is estimated."""
UNCERTAIN = Uncertain()


def scale(machine: Model | GivenMachine, calibration: Log | Sequence[Log] | str | Path, load: CarriedLoad, *,
          uncertain: Uncertain = UNCERTAIN) -> Scale:
    """A scale of a calibrated machine.

    Args:
        machine: nominal description without load, or its model.
        calibration: logs without load, or the folder that `hydroopt identify` wrote from them. Logs weigh better: they
            tell what friction that grows with the force has done to the parameters, and how large slow errors are.
        load: what is to be weighed.
        uncertain: standard deviations of what the calibration does not tell.

    Raises:
        LogError: a log cannot be used.
        ProblemError: the machine cannot weigh: no link of that name, friction that depends on pressures or is not
            linear, or sensors without a stated accuracy.

    See `weigh` for an example.
    """
    calibrated = model_of(machine, "scale")
    calibrated.refuse_seals("scale")
    model, machine = with_offsets(calibrated), calibrated.machine
    with threadpool_limits(limits=1, user_api="blas"):
        given = None if isinstance(calibration, str | Path) else all_of(calibration, (Log,), "log", machine.name)
        known = stored_information(calibrated, calibration if given is None else given)
        logs = None if given is None else [smoothed_log(calibrated, each) for each in given]
        p = len(calibrated.parameters)
        if len(known.triangles) != len(machine.balances):
            raise ProblemError("this calibration weighted the residuals of all actuators jointly", where=machine.name,
                               remedy="give its logs, or identify without --correlated, --fitted-motion and "
                                      "--instruments")
        rows = known.triangles.reshape(-1, p + 1)
        found = gaussian_posterior(IdentificationProblem(calibrated, ()), rows[:, :p], rows[:, p])
    angle_std = np.array([sensor.std if (sensor := machine.sensor(f"{joint}.q")) else np.nan
                          for joint in machine.joints])
    force_std = force_noise(model)
    force_std[list(undriven(machine.balances))] = np.inf
    if not np.all(np.isfinite(angle_std)) or not np.all(force_std > 0):
        raise ProblemError("a scale needs the accuracy of all sensors", where=machine.name,
                           remedy="state [[sensors]] with 'accuracy' for angles and pressures")
    trials = [random_trajectory(calibrated, duration=TRIAL_DURATION, rate=TRIAL_RATE, seed=seed)
              for seed in range(TRIALS)]
    # the calibrated parameters among those of the model, whose further offsets were zero then
    among = np.eye(len(model.parameters))[:, [model.parameters.index(name) for name in calibrated.parameters.names]]
    psi = among @ found.offset
    K = model.over(model.linearised, trials[0].q, trials[0].qd, trials[0].qdd, psi)[0]
    G = model.over(model.gravity_regressor, trials[0].q)[0].reshape(len(K), 3, *K.shape[1:])
    driven = trials if logs is None else [Trajectory(
        np.concatenate([each.t for each in logs]), np.concatenate([each.q for each in logs]),
        np.concatenate([each.qd for each in logs]), np.concatenate([each.qdd for each in logs]))]
    taken = np.array([_taken_for_friction(calibrated, known, found, motion) for motion in driven])
    scatter = uncertain.load_friction * np.concatenate([*(taken - taken.mean(axis=0))], axis=1) / np.sqrt(len(taken))
    taken = taken.mean(axis=0)
    drifting = drifts(model, uncertain.zero_drift)
    slope = np.hstack([among @ found.slope, drifting, among @ scatter])
    across = axes_about(np.asarray(gravity_in_base(machine)).ravel())[:2]
    tilted = machine.gravity * STEEP * np.einsum("ac,mcrp->amrp", across, G)
    axes = _shown(np.concatenate([K, *tilted]), slope, force_std)
    directions = slope @ axes
    r = len(machine.balances)
    own = Gaussian(np.zeros(directions.shape[1] + r), block_diag(
        np.eye(directions.shape[1]), uncertain.load_friction**2 * np.eye(r)))
    gain = machine.faults.gain if uncertain.gain is None else uncertain.gain
    readings = None if gain == 0 else _readings(known, found, among, gain or UNKNOWN_GAIN)
    made = Scale(machine, model, psi, directions, among @ taken, load, own, uncertain, angle_std, force_std,
                 (*machine.orientation[:2], uncertain.slope), gain or 0.0, readings,
                 axes[p : p + drifting.shape[1]].T, np.zeros(r))
    if logs is None:
        return made
    return replace(made, force_std=_noise([equations(made, each) for each in logs], axes[:p]))


def _noise(lines: Sequence[Equations], calibrated: Array) -> Array:
    """(r,) noise of the forces as a calibration without load shows it, at least that of the sensors.

    Smoothing passes slow errors only. How strong they are there follows from the residuals' products, as far apart as
    smoothing makes them depend on each other: those of white noise of the same strength would be as large. The
    calibration has explained a part of the errors: the covariance of its residuals is that of the errors less that of
    the forces which it predicts. A variance from few samples is uncertain: its mean is taken, as that of a spectrum
    at the frequency zero by as many products (Priestley 1981).

    Args:
        lines: equations of the calibration's logs.
        calibrated: (·, k) of the calibration's uncertain numbers, independent and standard normal, in the k directions
            of the scale.
    """
    std = lines[0].scale.force_std
    seen, white, count = np.zeros(len(std)), np.zeros(len(std)), np.zeros(len(std))
    for each in lines:
        known, by = each.smoothed.kernel.covariance, each.by_motion[..., 0]
        explained = each.K[:, :, 1 : 1 + calibrated.shape[1]] @ calibrated.T
        for lag in range(min(len(known), len(each.t))):
            end, twice = len(each.t) - lag, 1 + (lag > 0)
            both = each.moving[:end] & each.moving[lag:]
            both &= (each.smoothed.stretch[:end] == each.smoothed.stretch[lag:])[:, None]
            angles = np.einsum("mran,ab,mrbn->mr", by[:end], known[lag], by[lag:])
            errors = each.rest[:end] * each.rest[lag:] + np.sum(explained[:end] * explained[lag:], axis=2)
            seen += twice * np.sum(np.where(both, errors - angles, 0.0), axis=0)
            white += twice * known[lag, 0, 0] * both.sum(axis=0)
        count += each.moving.sum(axis=0)
    enough = (count >= FEWEST) & (white > 0)
    freedom = np.maximum(count, FEWEST) / (len(lines[0].smoothed.kernel.covariance) - 1)
    mean = seen / np.where(enough, white, 1.0) * freedom / (freedom - 2)
    return np.where(enough, np.sqrt(np.maximum(std**2, mean)), std)


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
    friction = np.abs(force[:, :, 0]) * np.sign(actuator_speeds(model, motion.q, motion.qd))
    size, p, made = np.max(np.abs(K), axis=(0, 1)), K.shape[2], []
    scale = np.where(size > 0, 1 / np.maximum(size, 1e-300), 0.0)
    for k, (column, triangle) in enumerate(zip(friction.T, known.triangles, strict=True)):
        imitated = scale * np.linalg.lstsq(K[:, k] * scale, column, rcond=1e-6)[0]
        rows = triangle[:, :p]
        made.append(found.slope @ (found.slope.T @ (rows.T @ (rows @ imitated))))
    return np.column_stack(made)


def _readings(known: StoredInformation, found: GaussianPosterior, among: Array, std: float) -> ForceReadings:
    """What errors in scale of the readings, of this standard deviation each, did to the calibration, and what it tells
    of them; `among` (p', p) has the calibrated parameters among those of the scale's model.

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
    covariance, pull = np.asarray(np.linalg.inv(information)), np.sum(predicted * (read - predicted), axis=1)
    return ForceReadings(among @ taken, Gaussian(covariance @ pull, covariance), std)


def with_offsets(model: Model) -> Model:
    """The same model with an offset of each actuator that pressures measure, zero where the machine file states none.

    >>> import hydroopt as ho
    >>> crane = ho.Model("forestry_crane")
    >>> sorted(set(with_offsets(crane).parameters.names) - set(crane.parameters.names))
    ['rotator_motor.tau_offset', 'slewing_racks.tau_offset']
    """
    machine = model.machine
    if all(each.friction.offset is not None for each in _read_by_pressures(machine)):
        return model
    stated = machine.model_copy(update={"cylinders": tuple(map(_with_offset, machine.cylinders)),
                                        "motors": tuple(map(_with_offset, machine.motors))})
    return Model(stated, actuator_inertia=model.actuator_inertia, calibrator=model.calibrator, terms=model.terms)


def drifts(model: Model, std: float) -> Array:
    """(p, a): what drifts of the pressures' zeros [Pa] do to the parameters of a model `with_offsets`, one column an
    actuator, per standard deviation of each zero."""
    read = _read_by_pressures(model.machine)
    made = np.zeros((len(model.parameters), len(read)))
    for k, each in enumerate(read):
        at = model.parameters.index(f"{each.name}.{each.effort_symbol}_offset")
        made[at, k] = std * float(np.linalg.norm([*each.effort_factors.values()]))
    return made


def _read_by_pressures(machine: Machine) -> tuple[Cylinder | Motor, ...]:
    return tuple(each for each in machine.measured_actuators if isinstance(each, Cylinder | Motor))


def _with_offset(actuator: Cylinder | Motor) -> Cylinder | Motor:
    if not actuator.measured or actuator.friction.offset is not None:
        return actuator
    return actuator.model_copy(update={"friction": actuator.friction.model_copy(update={"offset": 0.0})})
