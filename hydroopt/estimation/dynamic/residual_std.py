"""The standard deviation of each actuator's residual."""

from __future__ import annotations

import numpy as np

from hydroopt.estimation.dynamic.force_problem import ForceProblem
from hydroopt.estimation.dynamic.frequency_bands import ActuatorBands
from hydroopt.estimation.dynamic.holds import ROUNDING
from hydroopt.estimation.dynamic.regressor_qr import CompressedRegressor
from hydroopt.estimation.inference import least_squares
from hydroopt.spatial.inertia import Array


def noise_of_angles(problem: ForceProblem, folded: ActuatorBands) -> Array:
    """Standard deviation (n,) that noise of angles gives the residuals of joints that nothing drives, 0 elsewhere.

    It is that of the nominal parameters. Such residuals 0 − K·ψ vanish with ψ, so that those of a fit may say nothing.
    """
    squares, psi = np.zeros(len(folded.samples)), problem.parameters.nominal
    squares[folded.noisy] = np.einsum("i,fij,j->f", psi, folded.noise, psi)
    return np.asarray(np.sqrt(squares / np.maximum(folded.samples, 1.0)))


def residual_std(problem: ForceProblem, data: CompressedRegressor, tolerance: float,
                 of_angles: Array) -> Array:
    """Standard deviation (n,) of each actuator's residual: stated by its sensors, then estimated from the fit.

    None is below that by noise of angles.
    """
    size = rms_force(problem, data)
    stated = np.where(of_angles > 0, of_angles, problem.force_std)
    sigma = np.where(np.isfinite(stated), stated, 0.1 * size)
    sigma = np.where(sigma > 0, sigma, 1.0)
    floor = np.maximum(smallest(size), of_angles)
    for _ in range(3):
        psi, rank = least_squares.fitted(*data.weighted(sigma)[:2], tolerance)
        freedom = np.maximum(data.samples - rank / max(1, int(np.count_nonzero(data.samples))), 1.0)
        estimated = np.maximum(np.sqrt(data.squares(psi) / freedom), floor)
        sigma = np.where(data.samples > 0, estimated, sigma)  # as stated for actuators at rest
    return np.asarray(sigma)


def rms_force(problem: ForceProblem, data: CompressedRegressor) -> Array:
    """Size (r,) of each measured force; where nothing acts, of the largest of the model's terms, which cancel there."""
    total = np.linalg.norm(data.triangles[:, :, -1], axis=1)
    terms = np.linalg.norm(data.triangles[:, :, :-1], axis=1) * np.abs(problem.parameters.nominal)
    passive = np.array([not each.actuators for each in problem.model.machine.balances])
    largest = np.max(terms, axis=1, initial=0.0)
    return np.asarray(np.where(passive, largest, total) / np.sqrt(np.maximum(data.samples, 1.0)))


def smallest(size: Array) -> Array:
    """Standard deviation (r,) of rounding errors of forces of this size (r,)."""
    return ROUNDING * np.maximum(size, 1e-12)
