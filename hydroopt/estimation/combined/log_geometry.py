"""The geometry as numbers beside ψ: what the samples of one log say of it, about the motion that is being fitted.

At each sample the rows of `KinematicModel.observed` must vanish: the gap of the loop, and predicted less read lengths.
The machine's joints follow the fitted motion, whose own readings count there. The calibrator's joints belong to the
sample alone. With rows r + J·δg + B·δq + C·δc = 0, those that are read err by Σ, which gives the rows the covariance
C·Σ·Cᵀ + R, and what the others may be is projected out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from hydroopt.estimation.combined.forces_by_geometry import ForcesByGeometry
from hydroopt.estimation.dynamic.experiment import Experiment
from hydroopt.estimation.dynamic.fitted_motion import Linear
from hydroopt.estimation.kinematic.problem import CalibrationProblem
from hydroopt.spatial.inertia import Array

BLIND = 1e-9
"""Singular value, relative to the largest, below which an unread joint does not move the rows."""


@dataclass(frozen=True, eq=False)
class _Rows:
    """Whitened rows: residual (N, m), by the machine's joints (N, m, n), by all parameters (N, m, P) and by the
    calibrator's joints (N, m, c); `inverse` (N, c, m) gives what unread joints change from what remains."""

    left: Array
    by_q: Array
    by_numbers: Array
    by_own: Array
    inverse: Array

    def projected(self) -> tuple[Array, Array, Array]:
        """Residual and derivatives without what unread joints explain."""
        blind = self.by_own @ self.inverse

        def rest(x: Array) -> Array:
            return np.asarray(x - blind @ x)

        return rest(self.left[:, :, None])[:, :, 0], rest(self.by_q), rest(self.by_numbers)


@dataclass(frozen=True, eq=False)
class LogGeometry:
    """The geometry's numbers at some values, and the samples of one log.

    Attributes:
        postures: of this log alone; its parameters are those of all logs.
        force: how forces depend on the geometry.
        theta: (P,) all parameters; those that are not fixed are the numbers.
        own: (N, c) joints of the calibrator [rad, m].
    """

    postures: CalibrationProblem
    force: ForcesByGeometry
    theta: Array
    own: Array

    @property
    def names(self) -> tuple[str, ...]:
        """Of the numbers."""
        return tuple(name for name in self.postures.parameters.names if name not in self.postures.fixed)

    @property
    def value(self) -> Array:
        """(k,) the numbers [SI]."""
        return self.theta[self.postures.free]

    @property
    def known(self) -> Array:
        """Rows (·, k+1) of what the machine file states of the numbers, and of distances between fixtures."""
        postures, rows = self.postures, []
        for ends, length, sigma in zip(*(getattr(postures.distances, key) for key in ("ends", "length", "sigma")),
                                       strict=True):
            apart = self.theta[ends[0]] - self.theta[ends[1]]
            row = np.zeros(len(self.theta))
            row[ends[0]] = apart / np.linalg.norm(apart) / sigma
            row[ends[1]] = -row[ends[0]]
            rows.append(np.append(row[postures.free], (length - np.linalg.norm(apart)) / sigma
                                  + row[postures.free] @ self.value))
        for k, j in enumerate(np.flatnonzero(postures.free)):
            if weight := postures.known[j]:
                rows.append(weight * np.append(np.eye(len(self.names))[k], postures.parameters.nominal[j]))
        return np.array(rows).reshape(-1, len(self.names) + 1)

    @property
    def unread(self) -> NDArray[np.bool_]:
        """(n,) joints of the machine whose position no channel reads itself."""
        return np.asarray(~self.postures.layout.sensed[:, : self._joints].any(axis=0))

    @cached_property
    def _joints(self) -> int:
        return len(self.postures.model.machine.joints)

    def readings(self, q: Array) -> Linear:
        """The readings about a motion (N, n) and the present numbers."""
        left, by_q, by_numbers = self._linearised(q).projected()
        by_free = by_numbers[:, :, self.postures.free]
        return Linear([by_q], by_free, by_free @ self.value - left)

    def forces(self, data: Experiment, psi: Array) -> Linear:
        """The forces of an experiment about its motion, ψ (p,) and the present numbers."""
        geometry = len(self.postures.model.parameters)  # fixtures and locked joints come behind, and do not matter
        made = self.force.at(data, psi, self.theta[:geometry])
        every = np.zeros((*made.right.shape, len(self.theta)))
        every[:, :, :geometry], by_psi = np.split(made.by_common, [geometry], axis=2)
        held = np.where(self.postures.free, 0.0, self.theta)
        by_common = np.concatenate([every[:, :, self.postures.free], by_psi], axis=2)
        return made._replace(by_common=by_common, right=made.right - every @ held)

    def moved(self, before: Array, after: Array, value: Array) -> Self:
        """With other numbers (k,), when the motion (N, n) has moved along: the calibrator's joints follow."""
        theta = self.theta.copy()
        theta[self.postures.free] = value
        rows, layout = self._linearised(before), self.postures.layout
        error = rows.left + rows.by_numbers @ (theta - self.theta) + np.einsum("nmj,nj->nm", rows.by_q, after - before)
        change = -np.einsum("ncm,nm->nc", rows.inverse, error)
        rest = error + np.einsum("nmc,nc->nm", rows.by_own, change)
        read = layout.reading[:, self._joints:] - self._sigma**2 * np.einsum("nmc,nm->nc", rows.by_own, rest)
        own = np.where(layout.sensed[:, self._joints:], read, self.own + change)
        return replace(self, theta=theta, own=own)

    @property
    def _sigma(self) -> Array:
        """(N, c) standard deviations of the calibrator's readings; 0 where there is none."""
        return np.where(self.postures.layout.sensed, self.postures.angle_sigma, 0.0)[:, self._joints:]

    def _linearised(self, q: Array) -> _Rows:
        postures, layout, n = self.postures, self.postures.layout, self._joints
        used = np.flatnonzero(layout.present.any(axis=0))
        rows, by_numbers, by_q = postures.rows(self.theta, postures.angles(self.theta, np.hstack([q, self.own])), used)
        by_own, sensed = by_q[:, :, n:], layout.sensed[:, n:]
        rows = rows + np.einsum("nmc,nc->nm", by_own, np.where(sensed, layout.reading[:, n:] - self.own, 0.0))
        spread = (by_own * self._sigma[:, None, :] ** 2) @ by_own.transpose(0, 2, 1)
        diagonal = np.arange(len(used))
        spread[:, diagonal, diagonal] += np.where(layout.present[:, used], postures.row_sigma[:, used] ** 2, 1.0)
        root = np.linalg.cholesky(spread)
        white = np.linalg.solve(root, np.concatenate([rows[:, :, None], by_q[:, :, :n], by_own, by_numbers], axis=2))
        c = by_own.shape[2]
        own = white[:, :, 1 + n : 1 + n + c]
        blind = own * layout.moving[:, None, n:]
        inverse = np.linalg.pinv(blind, rcond=BLIND) if c else np.zeros((len(q), 0, len(used)))
        return _Rows(white[:, :, 0], white[:, :, 1 : 1 + n], white[:, :, 1 + n + c :], own, inverse)
