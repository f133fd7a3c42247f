"""The information of a log already measured, and the accuracy to expect of a motion before it is driven.

Angles are noisy too, and so are the speeds and accelerations that follow from them. To first order in that noise the
residual of the actuator forces is ``ε − A·S·n``: ε the noise of the forces, n that of the angles, S the smoother, which
is linear once its weight is chosen, and A the derivative of the forces by the motion. Weighted least squares with
weights W, regressor K and prior information Λ then errs by ``H⁻¹·(KᵀW·(ε − A·S·n) + prior's error)`` with
``H = KᵀWK + Λ``, whose covariance stands here. What the smoother takes away from the motion itself is a bias: it puts
parameters off by a bias, ``−H⁻¹·KᵀW·A·(S − 1)·q``. Where no sensor reads the joints, the motion is fitted to IMUs, and
the residuals of one simulated log, by size and correlation time, stand in for the noise of forces and motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from hydroopt.estimation.dynamic.identify import identify
from hydroopt.estimation.dynamic.problem import IdentificationProblem, identification_problem
from hydroopt.estimation.dynamic.stored_information import stored_information
from hydroopt.estimation.inference.identifiability import PREDICTED_TOLERANCE, Identifiability, significant
from hydroopt.estimation.inference.whitening import WIDEST, gaussian_posterior
from hydroopt.excitation.criteria import presumed_noise
from hydroopt.limits.uncertain import UncertainParameters
from hydroopt.logs import spline
from hydroopt.logs.forces_from_pressures import force_noise
from hydroopt.logs.joint_angles import angle_channels, angle_noise, measured_angles
from hydroopt.logs.log import Log
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import GivenMachine
from hydroopt.model.model import Model, model_of
from hydroopt.simulation.simulate import Trajectory, simulate
from hydroopt.spatial.inertia import Array


@dataclass(frozen=True, eq=False)
class ExpectedAccuracy:
    """Standard deviations to expect of an identification; infinite where the data carry no information.

    Attributes:
        base: (r,) of the base parameters by weighted least squares on the motion alone.
        bias: (r,) by how much smoothing puts these off.
        before: (p,) of all parameters by the machine file's confidences and the logs already measured.
        after: (p,) of all parameters by these and the motion.
        sigma: (n,) of the residuals of the actuators' forces [N, N·m].
        rows: (k, p) what the motion alone says about ψ: sums of parameters that it measures with errors that are
            independent and of variance 1.
        by_force: (k, N, n) by how much errors of the N samples' forces [1/N, 1/(N·m)] put these off.
    """

    base: Array
    bias: Array
    before: Array
    after: Array
    sigma: Array
    rows: Array
    by_force: Array


def measured_information(machine: Machine, logs: Sequence[Log]) -> Array:
    """Information (p, p) on ψ of logs already measured, weighted by their residuals.

    Raises:
        LogError: a log that cannot be used.
        IdentifiabilityError: no joint moves in them.
    """
    problem = identification_problem(machine, list(logs)).by_data_alone()
    R = identify(problem, "wls").weighted_residuals.R
    return np.asarray(R.T @ R)


def identified(machine: Model | GivenMachine, source: Log | Sequence[Log] | str | Path) -> UncertainParameters:
    """The parameters after logs, with their covariance; directions that neither logs nor file tell count as exact.

    Args:
        machine: nominal description, or its model.
        source: logs, or the folder that `hydroopt identify` wrote from them.

    Raises:
        LogError: the logs cannot be used.
        ProblemError: the folder cannot be used, or is of another machine description.

    Example:
        >>> import hydroopt as ho
        >>> model = ho.Model(ho.load_machine("patu655_lift"))
        >>> log = ho.simulate(model, ho.random_trajectory(model, duration=20, rate=20, seed=1), seed=1)
        >>> before, after = UncertainParameters.stated(model), identified(model, log)
        >>> force = model.over(model.regressor, *(np.array([[value]]) for value in (0.3, 0.0, 0.0)))[0][0]
        >>> bool(np.linalg.norm(force @ after.root) < 0.5 * np.linalg.norm(force @ before.root))
        True
    """
    model = model_of(machine, "identified")
    with threadpool_limits(limits=1, user_api="blas"):
        known, p = stored_information(model, source), len(model.parameters)
        rows = known.triangles.reshape(-1, p + 1)
        found = gaussian_posterior(IdentificationProblem(model, ()), rows[:, :p], rows[:, p])
    determined = np.linalg.norm(found.slope / model.parameters.scale[:, None], axis=0) < WIDEST / 2
    return UncertainParameters(found.offset, found.slope[:, determined])


def expected_accuracy(model: Model, motion: Trajectory, structure: Identifiability, measured: Array | None = None, *,
                      seed: int = 0) -> ExpectedAccuracy:
    """The accuracy of an identification with smoothing splines from a log of a motion.

    The smoother's weights, the samples left out and the weights of the forces are those that one simulated log leads
    to; parameters are nominal.

    Args:
        model: the machine.
        motion: to be driven.
        structure: base parameters by ideal motion.
        measured: (p, p) information of logs already measured.
        seed: of the simulated log.
    """
    machine, psi = model.machine, model.parameters.nominal
    log = simulate(model, motion, seed=seed, name="expected")
    problem = identification_problem(machine, [log]).by_data_alone()
    estimate, noise = identify(problem, "wls"), presumed_noise(model)
    (data,) = problem.experiments
    stated = np.isfinite(force_noise(model))  # else the simulated log has no noise
    sigma = np.where(stated, estimate.sigma, noise)
    slow = np.where(stated, estimate.correlation_time, 1.0)
    weight = (data.inside[:, None] & data.known) / (sigma**2 * slow)
    scale, basis = model.parameters.scale, np.array(structure.basis)
    K = model.over(model.regressor, motion.q, motion.qd, motion.qdd)[0] * scale
    rows: Array = np.asarray(np.linalg.qr((K * np.sqrt(weight)[:, :, None]).reshape(-1, K.shape[2]), mode="r"))
    pulled = K * weight[:, :, None]
    read = angle_channels(model, log) <= log.channels.keys()
    # what the noise of each force and of each angle adds to KᵀW·residual, a column each; residuals about a motion that
    # is fitted to IMUs contain the errors of that motion
    errors = [(pulled * (noise if read else sigma * np.sqrt(slow))[:, None]).reshape(-1, K.shape[2]).T]
    slopes = model.over(model.force_by_motion, motion.q, motion.qd, motion.qdd, psi)
    off = np.zeros((K.shape[2], 1))
    angles = measured_angles(model, log) if read else motion.q
    for j, std in enumerate(angle_noise(model, log) if read else ()):
        if std > 0:
            splines, chosen = spline.fit(log.t, angles[:, j], float(std), machine.bandwidth)
            weighted = [np.einsum("tia,ti->at", pulled, slope[:, :, j]) for slope in slopes]
            errors.append(std * splines.pull_back(weighted, chosen))
            taken = splines.smoothed(motion.q[:, j], chosen)
            for order, (row, true) in enumerate(zip(weighted, (motion.q, motion.qd, motion.qdd), strict=True)):
                off[:, 0] -= row @ (taken[order] - true[:, j])
    noisy = np.hstack(errors)
    values, axes = np.linalg.eigh((model.parameters.information + (0 if measured is None else measured))
                                  * np.outer(scale, scale))
    prior = np.sqrt(np.maximum(values, 0))[:, None] * axes.T
    alone, both = _LeastSquares(rows[:, basis]), _LeastSquares(np.vstack([rows, prior]))
    measured_by = np.asarray(np.linalg.qr(alone.along(noisy[basis]).T, mode="r")).T
    shown = alone.axes[alone.present] * alone.unit / scale[basis] @ structure.grouping
    by_force = alone.along(pulled[:, :, basis].reshape(-1, len(basis)).T)
    shown, by_force = np.linalg.solve(measured_by, shown), np.linalg.solve(measured_by, by_force)
    return ExpectedAccuracy(
        scale[basis] * alone.std(noisy[basis]), scale[basis] * alone.std(off[basis]),
        scale * _LeastSquares(prior).std(prior.T), scale * both.std(np.hstack([noisy, prior.T])), sigma, shown,
        by_force.reshape(len(shown), *pulled.shape[:2]))


class _LeastSquares:
    """The least squares of rows R (·, p) of a regressor on p parameters."""

    def __init__(self, root: Array) -> None:
        lengths = np.linalg.norm(root, axis=0)
        self.unit = np.where(lengths > 0, lengths, 1.0)
        _, s, self.axes = np.linalg.svd(np.linalg.qr(root / self.unit, mode="r"), full_matrices=True)
        self.present = np.zeros(len(self.axes), dtype=bool)
        self.present[:len(s)] = significant(s, PREDICTED_TOLERANCE)
        self.size = s[self.present[:len(s)]]
        self.undetermined = (lengths == 0) | (np.max(np.abs(self.axes[~self.present]), axis=0, initial=0.0) > 1e-6)

    def std(self, errors: Array) -> Array:
        """Sizes (p,) of ``(RᵀR)⁻¹·E·n`` with n white, for errors E (p, ·); infinite where R has no rank."""
        spread = self.axes[self.present].T @ self.along(errors)
        return np.where(self.undetermined, np.inf, np.linalg.norm(spread, axis=1) / self.unit)

    def along(self, errors: Array) -> Array:
        """What errors E (p, ·) change along the axes that R determines (k, ·), in units of the columns' sizes."""
        return np.asarray(self.axes[self.present] @ (errors / self.unit[:, None]) / self.size[:, None] ** 2)
