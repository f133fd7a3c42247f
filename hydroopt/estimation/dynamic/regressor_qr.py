"""A log of any length as one small triangle for each actuator: streaming QR of [K, f]."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hydroopt.estimation.dynamic.experiment import Experiment
from hydroopt.estimation.dynamic.folding import Triangles, split, triangle
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

    @classmethod
    def of(cls, rows: Sequence[Array], columns: Sequence[NDArray[np.intp]], p: int,
           samples: Array) -> CompressedRegressor:
        """From rows (·, k) of each actuator in some columns (k,) of [K, f]."""
        triangles = np.zeros((len(rows), p + 1, p + 1))
        for made, some, own in zip(triangles, rows, columns, strict=True):
            R = triangle(some)
            made[np.ix_(own[: len(R)], own)] = R
        return cls(triangles, samples)

    def squares(self, psi: Array) -> Array:
        """Sum of squared residuals of each actuator (n,)."""
        return np.asarray(np.sum((self.triangles @ np.append(psi, -1.0)) ** 2, axis=1))

    def weighted(self, sigma: Array) -> tuple[Array, Array, float]:
        """R (p, p) upper triangular, r (p,) and a rest with ``‖R·ψ − r‖² + rest`` the weighted sum of squares."""
        return split(triangle(*self.triangles / sigma[:, None, None]))


def compress(experiments: Sequence[Experiment], weights: Sequence[Array] | None = None, *,
             psi: Array | None = None) -> CompressedRegressor:
    """Fold experiments, linearised at `psi`, into triangles; `weights` (N, n) for each multiply squared residuals."""
    own = [np.append(np.flatnonzero(row), -1) for row in experiments[0].pattern]
    folded, samples = [Triangles(1, len(columns)) for columns in own], np.zeros(len(own))
    for which, rows, block in _blocks(experiments, weights, psi):
        known = experiments[which].known[rows]
        for i, columns in enumerate(own):
            taken = block[known[:, i], i][:, columns]
            folded[i].fold(taken, [0, len(taken)])
        samples += np.count_nonzero(known, axis=0)
    return CompressedRegressor.of([rows[0] for rows in folded], own, experiments[0].pattern.shape[1], samples)


def compressed(folded: ActuatorBands) -> CompressedRegressor:
    """What experiments folded by frequency say together, whatever the frequency."""
    channels, p = folded.channels(), len(folded.parameters)
    return CompressedRegressor.of([one.stacked for one in channels], [np.append(one.columns, -1) for one in channels],
                                  p, folded.samples)


def _blocks(experiments: Sequence[Experiment], weights: Sequence[Array] | None,
            psi: Array | None) -> Iterator[tuple[int, NDArray[np.intp], Array]]:
    """Rows [K, f] (m, n, p+1) of several experiments, weighted, each with the experiment's index and the samples."""
    for which, data in enumerate(experiments):
        for rows, K, force in data.chunks(psi):
            block = np.concatenate([K, force[:, :, None]], axis=2)
            yield which, rows, block if weights is None else block * np.sqrt(weights[which][rows])[:, :, None]


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
    for which, rows, block in _blocks(experiments, weights, psi):
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
    for which, rows, block in _blocks(experiments, weights, psi):
        Z = model.over(model.regressor, *replace(experiments[which], motion=instruments[which]).inputs(rows))[0]
        if weights is not None:
            Z = Z * np.sqrt(weights[which][rows])[:, :, None]
        white = np.concatenate([Z, block], axis=2) / sigma[:, None]
        R = triangle(R, white[experiments[which].known[rows]])
    # directions that the instruments do not excite would add the noise of K
    excited = list(analyse(R[:p, :p], model.parameters.names).basis)
    order = [*excited, *range(p, 2 * p + 1)]
    on_instruments = triangle(R[:, order])[: len(excited), len(excited) :]
    return split(triangle(on_instruments, np.zeros((p + 1 - len(excited), p + 1))))


def predict(model: Model, data: Experiment, psi: Array) -> Array:
    """Actuator forces (N, n) that a model with the parameters ψ predicts for a measured motion."""
    return replace(data, model=model).predicted(psi)
