"""What readings in candidate postures say about a geometry, as whitened rows, and how well the tip is then known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hydroopt.estimation.kinematic.accuracy import machine_end
from hydroopt.estimation.kinematic.observability import linearise
from hydroopt.estimation.kinematic.problem import CalibrationProblem
from hydroopt.excitation.poses.problem import PoseLabels, PoseProblem, calibration_of
from hydroopt.excitation.poses.readings import Reading
from hydroopt.simulation import postures
from hydroopt.spatial.inertia import Array

FAINT_INFORMATION = 1e-6
"""Information of every parameter in units of its scale, beside what is known of it: keeps every variance finite."""
WORKSPACE = 500
"""Postures that stand for the workspace."""


class PostureReadings:
    """R kinds of readings in N candidate postures, and what they say about the f free parameters of a calibration.

    Attributes:
        calibration: the problem of all readings in all postures.
        there: (N, R) which reading a posture offers.
        free: (f,) places of the free parameters; `scale` (f,) makes them comparable.
        prior: (f, f) information on them before anything is read.
    """

    def __init__(self, poses: PoseProblem, readings: Sequence[Reading], q: Array, labels: PoseLabels) -> None:
        self.q = q
        self.calibration = calibration_of(poses, q, labels)
        present, channels = self.calibration.layout.present, self.calibration.model.channels
        self._rows = [np.array([channels.index(channel) for channel in each.channels if channel in channels], dtype=int)
                      for each in readings]
        self.there = np.array([present[:, each].any(axis=1) for each in self._rows]).reshape(len(readings), len(q)).T
        self.free = np.flatnonzero(self.calibration.free)
        self.scale = self.calibration.parameters.scale[self.free]
        self.prior = np.diag(self.calibration.known[self.free] ** 2 + FAINT_INFORMATION / self.scale**2)

    @property
    def names(self) -> tuple[str, ...]:
        """Of the free parameters."""
        return tuple(self.calibration.parameters.names[k] for k in self.free)

    def rows_of(self, places: NDArray[np.intp], read: NDArray[np.bool_]) -> Array:
        """Whitened Jacobian (K, u, f) of postures (K,) in which some readings (K, R) are taken."""
        problem = self.calibration.without(~np.isin(np.arange(len(self.q)), places))
        part = self.reading(problem, read)
        return linearise(part, part.parameters.nominal, self.q[places]).jacobian[:, :, self.free]

    def reading(self, problem: CalibrationProblem, read: NDArray[np.bool_]) -> CalibrationProblem:
        """The problem of postures (K,) in which some readings (K, R) are taken, beside what belongs to none."""
        layout = problem.layout
        present = layout.present.copy()
        for r, rows in enumerate(self._rows):
            present[:, rows] &= read[:, r, None]
        return replace(problem, layout=replace(layout, present=present))


def gains(rows: Array, covariance: Array, task: Array, own: slice = slice(None)) -> Array:
    """By how much (K,) the rows (K, u, f) of each candidate, on `own` parameters among all, lower the sum of the
    variances of a task (s, P)."""
    core = np.eye(rows.shape[1]) + rows @ covariance[own, own] @ rows.transpose(0, 2, 1)
    across = rows @ (covariance[own] @ task.T)
    return np.asarray(np.einsum("kus,kus->k", across, np.linalg.solve(core, across)))


def tip_rows(calibration: CalibrationProblem) -> Array:
    """Rows (s, P) whose squares sum up to the mean square displacement of the tip [m²] by parameters."""
    model = calibration.model
    low, high = postures.limits(model)
    q = np.random.default_rng(0).uniform(low, high, (WORKSPACE, len(low)))
    _, function = machine_end(model)
    by_g = model.over(function, model.parameters.nominal, q)[1] / np.sqrt(WORKSPACE)
    rows = np.linalg.qr(by_g.reshape(by_g.shape[0] * by_g.shape[1], by_g.shape[2]), mode="r")
    return np.asarray(np.pad(rows, ((0, 0), (0, len(calibration.parameters) - by_g.shape[2]))))
