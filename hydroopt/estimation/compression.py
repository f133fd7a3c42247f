"""A log of any length as one small triangle for each actuator: streaming QR of [K, f]."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hydroopt.estimation.experiment import Experiment
from hydroopt.inertia import Array
from hydroopt.model.build import Model

CHUNK = 2048
"""Samples evaluated at a time: bounds the memory that a log of any length needs."""


@dataclass(frozen=True, eq=False)
class Compressed:
    """Triangles (n, p+1, p+1) with ``‖T_i·[ψ; −1]‖² = Σ (K_i·ψ − f_i)²`` for actuator i, over `samples[i]` rows."""

    triangles: Array
    samples: Array

    def squares(self, psi: Array) -> Array:
        """Sum of squared residuals of each actuator (n,)."""
        return np.asarray(np.sum((self.triangles @ np.append(psi, -1.0)) ** 2, axis=1))

    def weighted(self, sigma: Array) -> tuple[Array, Array, float]:
        """R (p, p) upper triangular, r (p,) and a rest with ``‖R·ψ − r‖² + rest`` the weighted sum of squares."""
        p = self.triangles.shape[2] - 1
        stacked = (self.triangles / sigma[:, None, None]).reshape(-1, p + 1)
        R: Array = np.asarray(np.linalg.qr(stacked, mode="r"))
        return R[:p, :p], R[:p, p], float(np.sum(R[p:, p] ** 2))


def _chunks(model: Model, experiments: Sequence[Experiment]) -> Iterator[tuple[int, NDArray[np.intp], Array, Array]]:
    """(experiment, sample indices, K (m, n, p), f (m, n)) of samples that take part; K is written over by the next."""
    reused: list[Array] | None = None
    for which, data in enumerate(experiments):
        taken = np.flatnonzero(data.inside)
        for start in range(0, len(taken), CHUNK):
            rows = taken[start : start + CHUNK]
            motion = data.motion
            reused = reused if reused is not None and len(reused[0]) == len(rows) else None
            reused = model.over(model.regressor, motion.q[rows], motion.qd[rows], motion.qdd[rows], out=reused)
            yield which, rows, reused[0], data.force[rows]


def compress(model: Model, experiments: Sequence[Experiment], weights: Sequence[Array] | None = None) -> Compressed:
    """Fold experiments into triangles; `weights` (N, n) per experiment multiply the squared residuals."""
    n, p = len(model.machine.joints), len(model.parameters)
    triangles = np.zeros((n, p + 1, p + 1))
    samples = np.zeros(n)
    for which, rows, K, force in _chunks(model, experiments):
        block = np.concatenate([K, force[:, :, None]], axis=2)
        if weights is not None:
            block = block * np.sqrt(weights[which][rows])[:, :, None]
        for i in range(n):
            taken = experiments[which].moving[rows, i]
            triangles[i] = _fold(triangles[i], block[taken, i])
            samples[i] += np.sum(taken)
    return Compressed(triangles, samples)


def _fold(triangle: Array, block: Array) -> Array:
    folded: Array = np.asarray(np.linalg.qr(np.vstack([triangle, block]), mode="r"))
    return folded[: len(triangle)]


def predict(model: Model, data: Experiment, psi: Array) -> Array:
    """Actuator forces (N, n) that the parameters ψ predict for a measured motion."""
    return model.over(model.inverse_dynamics, data.motion.q, data.motion.qd, data.motion.qdd, psi)[0][:, :, 0]
