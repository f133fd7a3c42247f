"""Accuracy of the machine's end over its workspace, as the uncertainty of the geometry leaves it."""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca
import numpy as np

from hydroopt.estimation.kinematic.observability import spread
from hydroopt.estimation.kinematic.solution import KinematicSolution
from hydroopt.model.closed_chain import KinematicModel
from hydroopt.simulation import postures
from hydroopt.spatial.inertia import Array

SAMPLES = 8000
"""Postures that stand for the workspace."""


class WorkspaceAccuracy(NamedTuple):
    """Positions (K, 3) [m] of a named `point` and their standard deviations (K,) [m]; `measured` (N, 3) in the poses.

    The standard deviation is the root of the sum of three directions' variances; NaN where a parameter that moves the
    point is not identifiable.
    """

    point: str
    position: Array
    std: Array
    measured: Array

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
    low, high = postures.limits(model)
    q = np.random.default_rng(solution.seed).uniform(low, high, (SAMPLES, len(low)))
    name, function = machine_end(model)
    geometry = solution.theta[: len(model.parameters)]
    position, by_g = model.over(function, geometry, q)
    std = spread(model, solution.observability, by_g) * max(1.0, solution.noise_scale)
    return WorkspaceAccuracy(name, position[:, :, 0], std, model.over(function, geometry, solution.q)[0][:, :, 0])


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
