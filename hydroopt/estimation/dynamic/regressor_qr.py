"""A log of any length as one small triangle for each actuator: streaming QR of [K, f]."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hydroopt.estimation.dynamic.column_basis import ColumnBasis
from hydroopt.estimation.dynamic.experiment import Experiment
from hydroopt.estimation.dynamic.folding import ActuatorTriangles, split, triangle
from hydroopt.estimation.dynamic.frequency_bands import ActuatorBands
from hydroopt.estimation.inference.identifiability import analyse
from hydroopt.estimation.inference.whitening import whitened
from hydroopt.logs.smoothing import Motion
from hydroopt.model.model import Model
from hydroopt.spatial.inertia import Array


@dataclass(frozen=True, eq=False)
class CompressedRegressor:
    """Triangles (n, p+1, p+1) with ``‖T_i·[ψ; −1]‖² = Σ (K_i·ψ − f_i)²`` for actuator i, over `samples[i]` rows."""

    triangles: Array
    samples: Array

    def squares(self, psi: Array) -> Array:
        """Sum of squared residuals of each actuator (n,)."""
        return np.asarray(np.sum((self.triangles @ np.append(psi, -1.0)) ** 2, axis=1))

    def weighted(self, sigma: Array) -> tuple[Array, Array, float]:
        """R (p, p) upper triangular, r (p,) and a rest with ``‖R·ψ − r‖² + rest`` the weighted sum of squares."""
        return split(triangle(*self.triangles / sigma[:, None, None]))


def compress(experiments: Sequence[Experiment], weights: Sequence[Array] | None = None, *,
             psi: Array | None = None) -> CompressedRegressor:
    """Fold experiments, linearised at `psi`, into triangles; `weights` (N, n) for each multiply squared residuals."""
    folded = ActuatorTriangles([ColumnBasis.whole(np.flatnonzero(row)) for row in experiments[0].pattern],
                               len(experiments[0].model.parameters))
    for k, data in enumerate(experiments):
        data.fold_into(folded, psi, None if weights is None else weights[k])
    return CompressedRegressor(folded.full, folded.samples)


def compressed(folded: Sequence[ActuatorBands]) -> CompressedRegressor:
    """What experiments folded by frequency say together, whatever the frequency."""
    whole = folded[0].triangles
    for more in folded[1:]:
        whole.add(more.triangles)
    return CompressedRegressor(whole.full, whole.samples)


def _chunks(experiments: Sequence[Experiment],
            psi: Array | None) -> Iterator[tuple[int, NDArray[np.intp], Array, Array]]:
    """The chunks of several experiments, each with the experiment's index."""
    for which, data in enumerate(experiments):
        for rows, K, force in data.chunks(psi):
            yield which, rows, K, force


def compress_jointly(model: Model, experiments: Sequence[Experiment], covariance: Array,
                     weights: Sequence[Array] | None = None, *,
                     psi: Array | None = None) -> tuple[Array, Array, float]:
    """R (p, p), r (p,) and the rest, as of `CompressedRegressor.weighted`, with residuals that correlate between
    actuators.

    Args:
        model, experiments, weights, psi: as of `compress`.
        covariance: (n, n) of the actuators' residuals in one sample; where some of them are not used, that of the
            others.
    """
    p = len(model.parameters)
    R = np.zeros((p + 1, p + 1))
    for which, rows, K, force in _chunks(experiments, psi):
        block = np.concatenate([K, force[:, :, None]], axis=2)
        if weights is not None:
            block = block * np.sqrt(weights[which][rows])[:, :, None]
        R = triangle(R, whitened(block, experiments[which].known[rows], covariance))
    return split(R)


def compress_instrumented(model: Model, experiments: Sequence[Experiment], instruments: Sequence[Motion],
                          sigma: Array, weights: Sequence[Array] | None = None, *,
                          psi: Array | None = None) -> tuple[Array, Array, float]:
    """R (p, p) and r (p,) of ``Zᵀ·(f − K·ψ) ≈ 0``: least squares on the rows projected on the instruments Z.

    Z is the regressor of a motion whose errors are not those of the measured one (a reference, a second sensor, a
    repetition): its columns do not correlate with the noise in K, so that noisy angles no longer bias parameters
    towards zero (two-stage least squares; Janot, Vandanjon, Gautier 2014, "A generic instrumental variable approach for
    industrial robot identification").

    Args:
        model, experiments, weights, psi: as of `compress`.
        instruments: a motion at the samples of each experiment.
        sigma: (n,) standard deviation of each actuator's residual.
    """
    p = len(model.parameters)
    R = np.zeros((2 * p + 1, 2 * p + 1))
    for which, rows, K, force in _chunks(experiments, psi):
        Z = model.over(model.regressor, *replace(experiments[which], motion=instruments[which]).inputs(rows))[0]
        block = np.concatenate([Z, K, force[:, :, None]], axis=2) / sigma[:, None]
        if weights is not None:
            block = block * np.sqrt(weights[which][rows])[:, :, None]
        R = triangle(R, block[experiments[which].known[rows]])
    # directions that the instruments do not excite would add the noise of K
    excited = list(analyse(R[:p, :p], model.parameters.names).basis)
    order = [*excited, *range(p, 2 * p + 1)]
    on_instruments = triangle(R[:, order])[: len(excited), len(excited) :]
    return split(triangle(on_instruments, np.zeros((p + 1 - len(excited), p + 1))))


def predict(model: Model, data: Experiment, psi: Array) -> Array:
    """Actuator forces (N, n) that a model with the parameters ψ predicts for a measured motion."""
    return replace(data, model=model).predicted(psi)
