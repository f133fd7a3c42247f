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

UNSEEN = 1e-10
"""Part of the greatest singular value of the scaled information's root below which a direction counts as unseen."""


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
    K = model.over(model.regressor, motion.q, motion.qd, motion.qdd)[0] * model.parameters.scale
    pulled = K * weight[:, :, None]
    told = np.einsum("tia,tib->ab", pulled, K)
    # the noise of forces, then of each joint's angle
    spread = np.einsum("tia,i,tib->ab", pulled, noise**2, pulled)
    force = model.dynamics.forces(ca.DM(psi), actuator_inertia=model.actuator_inertia)
    slopes = model.over(program(ca.Function("force_by_motion", [*model.at], [
        ca.densify(ca.jacobian(force, x)) for x in model.at])).function(), motion.q, motion.qd, motion.qdd)
    for j, (joint, std) in enumerate(zip(machine.joints, angle_noise(model, log), strict=True)):
        if std > 0:
            smooth = spline.fit(log.t, log.channel(f"{joint}.q"), float(std), machine.bandwidth)
            by_reading = smooth.pull_back([np.einsum("tia,ti->at", pulled, slope[:, :, j]) for slope in slopes])
            spread += std**2 * by_reading @ by_reading.T
    scale, basis = model.parameters.scale, list(structure.basis)
    prior = model.parameters.information + (0 if known is None else known)
    prior = prior * np.outer(scale, scale)
    own = np.ix_(basis, basis)
    return Expectation(
        scale[basis] * _std(told[own], spread[own]), scale * _std(prior, prior),
        scale * _std(told + prior, spread + prior), sigma)


def _std(information: Array, spread: Array) -> Array:
    """Roots of the diagonal of ``information⁻¹ · spread · information⁻¹``; infinite where directions are unseen."""
    lengths = np.sqrt(np.diag(information))
    unit = np.where(lengths > 0, lengths, 1.0)
    values, axes = np.linalg.eigh(information / np.outer(unit, unit))
    seen = values > UNSEEN**2 * max(values[-1], 0.0)
    inverse = (axes[:, seen] / values[seen]) @ axes[:, seen].T / np.outer(unit, unit)
    blind = (lengths == 0) | (np.max(np.abs(axes[:, ~seen]), axis=1, initial=0.0) > 1e-6)
    return np.where(blind, np.inf, np.sqrt(np.maximum(np.diag(inverse @ spread @ inverse), 0.0)))
