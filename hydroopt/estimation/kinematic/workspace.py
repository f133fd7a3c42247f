"""Accuracy of the machine's end over its workspace, as the uncertainty of the geometry leaves it."""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca
import numpy as np

from hydroopt.estimation.kinematic.observability import spread
from hydroopt.estimation.kinematic.solution import KinematicSolution
from hydroopt.machine.description import BASE
from hydroopt.model.closed_chain import KinematicModel
from hydroopt.simulation import postures
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
    low, high = postures.limits(model)
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
