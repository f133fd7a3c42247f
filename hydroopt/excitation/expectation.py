"""What a log tells of the parameters: of one already measured, and of a motion before it is driven.

Angles are noisy too, and so are the speeds and accelerations that follow from them. To first order in that noise the
residual of the actuator forces is ``ε − A·S·n``: ε the noise of the forces, n that of the angles, S the smoother, which
is linear once its weight is chosen, and A the derivative of the forces by the motion. Weighted least squares with
weights W, regressor K and prior information Λ then errs by ``H⁻¹·(KᵀW·(ε − A·S·n) + prior's error)`` with
``H = KᵀWK + Λ``, whose covariance stands here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from hydroopt.estimation.compression import compress
from hydroopt.estimation.experiment import angle_noise, force_noise
from hydroopt.estimation.problem import identification_problem
from hydroopt.estimation.solve import solve
from hydroopt.excitation.criteria import presumed_noise
from hydroopt.identifiability import Identifiability
from hydroopt.inertia import Array
from hydroopt.machine import Machine
from hydroopt.model.build import Model
from hydroopt.model.program import program
from hydroopt.signals import spline
from hydroopt.signals.log import Log
from hydroopt.synthetic import Trajectory, simulate

UNSEEN = 1e-9
"""Part of the greatest singular value of the scaled regressor below which a direction counts as unseen."""


@dataclass(frozen=True, eq=False)
class Expectation:
    """Standard deviations to expect of an identification; infinite where nothing is told.

    Attributes:
        base: (r,) of the base parameters by weighted least squares on the motion alone.
        before: (p,) of all parameters by the machine file's confidences and the logs already measured.
        after: (p,) of all parameters by these and the motion.
        sigma: (n,) of the residuals of the actuators' forces [N, N·m].
    """

    base: Array
    before: Array
    after: Array
    sigma: Array


def measured(machine: Machine, logs: Sequence[Log]) -> Array:
    """Information (p, p) on ψ of logs already measured, by what their residuals turn out to be.

    Raises:
        LogError: a log that cannot be used.
        IdentifiabilityError: no joint moves in them.
    """
    problem = identification_problem(machine, list(logs))
    estimate = solve(problem, "wls")
    R, _, _ = compress(problem.model, problem.experiments).weighted(
        estimate.sigma * np.sqrt(estimate.correlation_time))
    return np.asarray(R.T @ R)


def expected(model: Model, motion: Trajectory, structure: Identifiability, known: Array | None = None, *,
             seed: int = 0) -> Expectation:
    """What identification with smoothing splines will tell after a motion was driven.

    The smoother's weights, the samples left out and the weights of the forces are those that one simulated log leads
    to; parameters are nominal.

    Args:
        model: the machine.
        motion: what it will do.
        structure: base parameters by ideal motion.
        known: (p, p) information of logs already measured.
        seed: of the simulated log.
    """
    machine, psi = model.machine, model.parameters.nominal
    log = simulate(model, motion, seed=seed, name="expected")
    problem = identification_problem(machine, [log])
    estimate, data, noise = solve(problem, "wls"), problem.experiments[0], presumed_noise(model)
    stated = np.isfinite(force_noise(model))  # else the simulated log has no noise
    sigma = np.where(stated, estimate.sigma, noise)
    weight = (data.inside[:, None] & data.moving) / (sigma**2 * np.where(stated, estimate.correlation_time, 1.0))
    scale, basis = model.parameters.scale, np.array(structure.basis)
    K = model.over(model.regressor, motion.q, motion.qd, motion.qdd)[0] * scale
    told: Array = np.asarray(np.linalg.qr((K * np.sqrt(weight)[:, :, None]).reshape(-1, K.shape[2]), mode="r"))
    pulled = K * weight[:, :, None]
    # what the noise of each force and of each angle adds to KᵀW·residual, a column each
    errors = [(pulled * noise[:, None]).reshape(-1, K.shape[2]).T]
    force = model.dynamics.forces(ca.DM(psi), actuator_inertia=model.actuator_inertia)
    slopes = model.over(program(ca.Function("force_by_motion", [*model.at], [
        ca.densify(ca.jacobian(force, x)) for x in model.at])).function(), motion.q, motion.qd, motion.qdd)
    for j, (joint, std) in enumerate(zip(machine.joints, angle_noise(model, log), strict=True)):
        if std > 0:
            smooth = spline.fit(log.t, log.channel(f"{joint}.q"), float(std), machine.bandwidth)
            errors.append(std * smooth.pull_back([np.einsum("tia,ti->at", pulled, slope[:, :, j]) for slope in slopes]))
    noisy = np.hstack(errors)
    values, axes = np.linalg.eigh((model.parameters.information + (0 if known is None else known))
                                  * np.outer(scale, scale))
    prior = np.sqrt(np.maximum(values, 0))[:, None] * axes.T
    return Expectation(
        scale[basis] * _std(told[:, basis], noisy[basis]), scale * _std(prior, prior.T),
        scale * _std(np.vstack([told, prior]), np.hstack([noisy, prior.T])), sigma)


def _std(root: Array, errors: Array) -> Array:
    """Standard deviations (p,) of ``(RᵀR)⁻¹·E·n`` with n white, R (·, p), E (p, ·); infinite where R sees nothing."""
    lengths = np.linalg.norm(root, axis=0)
    unit = np.where(lengths > 0, lengths, 1.0)
    _, s, axes = np.linalg.svd(np.linalg.qr(root / unit, mode="r"), full_matrices=True)
    seen = np.zeros(len(axes), dtype=bool)
    seen[:len(s)] = s > UNSEEN * s[0]
    spread = axes[seen].T @ (axes[seen] @ (errors / unit[:, None]) / s[seen[:len(s)], None] ** 2)
    blind = (lengths == 0) | (np.max(np.abs(axes[~seen]), axis=0, initial=0.0) > 1e-6)
    return np.where(blind, np.inf, np.linalg.norm(spread, axis=1) / unit)
