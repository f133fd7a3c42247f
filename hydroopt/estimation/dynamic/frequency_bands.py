"""Rows of a regressor by actuator and frequency: what the covariance of the estimate is computed from."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct

from hydroopt.estimation.dynamic.folding import Triangles
from hydroopt.estimation.dynamic.holds import Holds
from hydroopt.estimation.inference.band_variances import Channel
from hydroopt.parameters.parameter_set import ParameterKind, ParameterSet
from hydroopt.spatial.inertia import Array

BLOCK = 2**13
"""Samples at most whose frequencies are computed together: of a stretch in memory and of a log in pieces alike."""
LOWEST, RATIO, BANDS = 0.02, 1.6, 24
"""Upper end of the lowest band over `RATIO` [Hz], ratio of neighbouring ends, and number of bands: up to 1 kHz."""


class ActuatorBands:
    """Rows [K_i, C_i, f_i] of each actuator, one block of samples after the other, by the frequencies of a cosine
    transform (DCT-II), which is orthonormal: sums of squares over all bands are those over all samples.

    C_i are the columns of the actuator's friction and offset, with the opposite sign in the first half of a log: how
    much they differ between the halves. Rows that do not take part are zero before the transform, and a coefficient
    counts by the share of samples that do.

    Attributes:
        own, contrast: for each actuator the columns of K_i, and those that C_i repeats.
        rows: [K_i, C_i, f_i] of each actuator by band.
        counts: (n, B) residuals of each actuator in each band.
        parameters: what K_i has columns of, p of them.
        samples: (n,) number of the rows.
        holds: equations of joints at rest, which these rows do not contain.
        noise: (f, p, p) expected part of K_iᵀK_i that is noise of K_i, of the actuators `noisy` (f,).
    """

    def __init__(self, parameters: ParameterSet, pattern: NDArray[np.bool_],
                 noisy: Sequence[int] | NDArray[np.intp] = ()) -> None:
        n, p = pattern.shape
        varying = np.array([kind.is_friction or kind is ParameterKind.FORCE_OFFSET for kind in parameters.kinds])
        self.parameters, self.pattern = parameters, pattern
        self.own = [np.flatnonzero(row) for row in pattern]
        self.contrast = [own[varying[own]] for own in self.own]
        self.rows = [Triangles(BANDS, len(own) + len(extra) + 1)
                     for own, extra in zip(self.own, self.contrast, strict=True)]
        self.counts, self.samples = np.zeros((n, BANDS)), np.zeros(n)
        self.holds = Holds(self.own)
        self.noisy, self.noise = np.array(noisy, dtype=np.intp), np.zeros((len(noisy), p, p))

    def fold(self, K: Array, force: Array, taken: NDArray[np.bool_], later: NDArray[np.bool_], step: float) -> None:
        """Add a block of samples in a row.

        Args:
            K, force: (N, n, p) and (N, n).
            taken: (N, n) which of them take part.
            later: (N,) which samples are in the second half of their log.
            step: [s] between samples.
        """
        count = len(later)
        ends = 2 * count * step * LOWEST * RATIO ** np.arange(1.0, BANDS)  # coefficient k has k + ½ half waves
        edges = np.concatenate([[0], np.clip(np.ceil(ends - 0.5), 0, count).astype(int), [count]])
        half = np.where(later, 1.0, -1.0)
        for i, (own, extra) in enumerate(zip(self.own, self.contrast, strict=True)):
            here = taken[:, i]
            if not (many := np.count_nonzero(here)):
                continue
            self.samples[i] += many
            self.counts[i] += np.diff(edges) * (many / count)
            columns = K[:, i].T
            whole = np.vstack([columns[own], half * columns[extra], force[:, i]])
            whole[:, ~here] = 0.0
            self.rows[i].fold(dct(whole, norm="ortho", overwrite_x=True).T, edges)

    @classmethod
    def together(cls, logs: Sequence[ActuatorBands]) -> ActuatorBands:
        """The rows of several logs."""
        made = cls(logs[0].parameters, logs[0].pattern, logs[0].noisy)
        for other in logs:
            for own, more in zip(made.rows, other.rows, strict=True):
                own.add([more[band] for band in range(BANDS)])
            made.counts += other.counts
            made.samples += other.samples
            made.holds.add(other.holds)
            made.noise += other.noise
        return made

    def channels(self, *, contrasts: bool = False) -> tuple[Channel, ...]:
        """The actuators' rows without C_i, or with them, as columns p, p + 1, … of the parameters."""
        return tuple(self._channels(contrasts))

    def _channels(self, contrasts: bool) -> Iterator[Channel]:
        first = len(self.parameters)
        for own, contrast, rows, counts in zip(self.own, self.contrast, self.rows, self.counts, strict=True):
            extra = np.arange(first, first + len(contrast)) if contrasts else np.zeros(0, dtype=np.intp)
            first += len(extra)
            kept = np.r_[: len(own) + len(extra), len(own) + len(contrast)]
            yield Channel(np.concatenate([own, extra]), tuple(rows[b][:, kept] for b in range(BANDS)), counts)
