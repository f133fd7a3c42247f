"""How accurate a calibrated geometry is: over its workspace, and in held-out poses."""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy import special

from hydroopt.estimation.inference.identifiability import INFORMATION_TOLERANCE, significant
from hydroopt.estimation.kinematic.observability import linearise, spread
from hydroopt.estimation.kinematic.residuals import predicted
from hydroopt.estimation.kinematic.solution import KinematicSolution
from hydroopt.logs.poses import Poses
from hydroopt.machine.description import BASE
from hydroopt.model.closed_chain import KinematicModel
from hydroopt.spatial.inertia import Array

SAMPLES = 8000
"""Postures that stand for the workspace."""


class WorkspaceAccuracy(NamedTuple):
    """Positions (K, 3) [m] of a named `point` and their standard deviations (K,) [m]; `measured` (N, 3) in the poses.

    The standard deviation is the root of the sum of three directions' variances; NaN where a parameter that moves the
    point is not identifiable, and where none moves it. `exact` are lengths of the links up to the point of which the
    machine file states no sigma: they are taken to be without error.
    """

    point: str
    position: Array
    std: Array
    measured: Array
    exact: tuple[str, ...] = ()
    moved: bool = True
    """Whether any parameter moves the point."""

    @property
    def median_std(self) -> float:
        """Median of the standard deviation [m]; NaN where there is none."""
        known = self.std[np.isfinite(self.std)]
        return float(np.median(known)) if known.size else float("nan")

    @property
    def largest_std(self) -> float:
        """Largest standard deviation [m]; NaN where there is none."""
        return float(np.max(self.std[np.isfinite(self.std)], initial=-np.inf)) if np.any(np.isfinite(self.std)) else (
            float("nan"))


def workspace_accuracy(solution: KinematicSolution) -> WorkspaceAccuracy:
    """At the tip of a rigid tool or of the machine, or where the calibrator's links begin, in random postures."""
    model = solution.problem.model
    low, high = model.ranges.T
    q = np.random.default_rng(solution.seed).uniform(low, high, (SAMPLES, len(low)))
    name, function = machine_end(model)
    geometry = solution.theta[: len(model.parameters)]
    position, by_g = model.over(function, geometry, q)
    moved = bool(np.any(by_g))
    std = (spread(model, solution.observability, by_g) * max(1.0, solution.noise_scale) if moved
           else np.full(len(q), np.nan))
    return WorkspaceAccuracy(name, position[:, :, 0], std, model.over(function, geometry, solution.q)[0][:, :, 0],
                             exact_lengths(model), moved)


def exact_lengths(model: KinematicModel) -> tuple[str, ...]:
    """Lengths of the links from the base to the machine's end that are not zero and that no sigma makes uncertain."""
    machine, numbers = model.machine, model.machine.numbers
    name, names = machine.calibrator.parent if machine.calibrator else machine.tip, list[str]()
    while name != BASE:
        names.insert(0, name)
        name = machine.link(name).parent
    return tuple(address for name in names for address in (f"{name}.d", f"{name}.a")
                 if address in numbers and numbers[address].value and address not in model.parameters.positions)


def machine_end(model: KinematicModel) -> tuple[str, ca.Function]:
    """Name of the machine's end, and (g, q) -> its place (3,) [m] and Jacobian by g (3, p)."""
    g, q = ca.SX.sym("g", len(model.parameters)), ca.SX.sym("q", len(model.joints))
    calibrator = model.machine.calibrator
    if calibrator is None or not calibrator.links:
        name, point = "tip", model.end(g, q)
    else:
        name = f"end of {calibrator.parent}"
        point = model.far_ends(g, q)[:, [link.name for link in model.machine.chain].index(calibrator.parent)]
    return name, ca.Function("end", [g, q], [point, ca.jacobian(point, g)])


NORMAL_95 = 1.959964
"""Standard deviations on each side of a 95 % interval."""
LEAST = 1e-6
"""Part of a row's variance below which a fit to the poses themselves has taken it all."""


class PredictionTest(NamedTuple):
    """How held-out poses agree with the error that is stated for their prediction.

    Attributes:
        standardised: (k,) whitened residuals, each in standard deviations of its prediction.
        ratio: size of all of them together, correlations included, relative to what is expected.
        chance: probability of this ratio or a larger one if the stated errors hold, with the noise as uncertain as the
            training poses leave it.
    """

    standardised: Array
    ratio: float
    chance: float

    @property
    def inside(self) -> NDArray[np.bool_]:
        """Which of the residuals (k,) lie within their 95 % intervals."""
        return np.abs(self.standardised) < NORMAL_95

    @property
    def coverage(self) -> float:
        """Part of the residuals that lie within their 95 % intervals."""
        return float(np.mean(self.inside)) if self.standardised.size else float("nan")


def prediction_test(solution: KinematicSolution, poses: Poses) -> PredictionTest:
    """Test the stated error of a calibrated geometry with held-out poses.

    The noise is that of the training poses, smaller or larger than stated; the geometry is as uncertain as this noise
    and the priors leave it. What held-out poses tell alone, such as where a fixture stood, is fitted to them, as is
    what neither training poses nor priors determine: their share of noise and of wrong geometry is taken out.

    Args:
        solution: the calibration.
        poses: that took no part in it.

    Raises:
        ProblemError: the poses do not fit the machine.
    """
    fresh, theta, q = predicted(solution.problem, solution.theta, poses)
    rows, known = linearise(fresh, theta, q), solution.observability
    measured = np.isfinite(solution.noise_scale)
    noise = solution.noise_scale**2 if measured else 1.0
    information = known.information / noise + known.prior
    size = np.sqrt(np.maximum(np.diag(information), 1e-300))
    values, vectors = np.linalg.eigh(information / np.outer(size, size))
    vectors, determined = vectors / size[:, None], significant(values, INFORMATION_TOLERANCE)
    shared = [k for k, name in enumerate(fresh.parameters.names) if name in known.names and not fresh.free[k]]
    order = [known.names.index(fresh.parameters.names[k]) for k in shared]
    free, count = np.flatnonzero(fresh.free), rows.residual.size
    slope = rows.jacobian[:, :, shared].reshape(count, -1) @ vectors[order]
    fitted = np.column_stack([
        np.vstack([rows.jacobian[:, :, free].reshape(count, len(free)), rows.shared[:, free]])
        * fresh.parameters.scale[free],
        np.vstack([slope[:, ~determined], np.zeros((len(rows.shared), int(np.sum(~determined))))])])
    left, s, _ = np.linalg.svd(fitted, full_matrices=False)
    left = left[:count, s > 1e-9 * s[0]] if s.size else np.zeros((count, 0))
    by_geometry = slope[:, determined] / np.sqrt(values[determined])
    by_geometry -= left @ (left.T @ by_geometry)
    residual = rows.residual.ravel() - left @ (left.T @ rows.residual.ravel())
    variance = noise * (rows.kept.ravel() - np.sum(left**2, axis=1)) + np.sum(by_geometry**2, axis=1)
    there = variance > LEAST * noise
    turned = by_geometry.T @ residual
    explained = turned @ np.linalg.solve(by_geometry.T @ by_geometry + noise * np.eye(len(turned)), turned)
    square = max(float(residual @ residual - explained), 0.0) / noise
    standardised, freedom = residual[there] / np.sqrt(variance[there]), int(rows.rank.sum()) - left.shape[1]
    if freedom <= 0:
        return PredictionTest(standardised, float("nan"), 1.0)
    trained = int(solution.linearised.rank.sum()) - known.rank
    chance = (special.fdtrc(freedom, trained, square / freedom) if measured and trained > 0
              else special.chdtrc(freedom, square))
    return PredictionTest(standardised, float(np.sqrt(square / freedom)), float(chance))
