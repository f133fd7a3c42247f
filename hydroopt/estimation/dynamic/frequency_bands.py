"""Rows of a regressor by actuator and frequency: what the covariance of the estimate is computed from."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from hydroopt.estimation.dynamic.column_basis import ColumnBasis
from hydroopt.estimation.dynamic.folding import ActuatorTriangles, compact, folded_rows
from hydroopt.estimation.dynamic.holds import Holds
from hydroopt.estimation.inference.band_variances import Channel
from hydroopt.kernels.cosine import cosine_transform
from hydroopt.parameters.parameter_set import ParameterKind, ParameterSet
from hydroopt.spatial.inertia import Array

BLOCK = 2**13
"""Samples at most whose frequencies are computed together: of a stretch in memory and of a log in pieces alike."""
LOWEST, RATIO, BANDS = 0.02, 1.6, 24
"""Upper end of the lowest band over `RATIO` [Hz], ratio of neighbouring ends, and number of bands: up to 1 kHz."""


class ActuatorBands:
    """Rows [K_i, C_i, f_i] of each actuator, K_i in the columns that its basis keeps, one block of samples after the
    other, by the frequencies of a cosine transform (DCT-II), which is orthonormal: sums of squares over all bands are
    those over all samples.

    C_i are the columns of the actuator's friction and offset, with the opposite sign in the first half of a log: how
    much they differ between the halves. Rows that do not take part are zero before the transform, and a coefficient
    counts by the share of samples that do.

    Attributes:
        bases, contrast: for each actuator the columns of K_i, and those that C_i repeats.
        counts: (n, B) residuals of each actuator in each band.
        samples, sums: (n,) number and (n, p+1) sums of the rows [K_i, f_i] over time.
        holds: equations of joints at rest, which these rows do not contain.
        noise: (f, p, p) expected part of K_iᵀK_i that is noise of K_i, of the actuators `noisy` (f,).
    """

    def __init__(self, parameters: ParameterSet, bases: Sequence[ColumnBasis],
                 noisy: Sequence[int] = ()) -> None:
        n, p = len(bases), len(parameters)
        varying = np.array([kind.is_friction or kind is ParameterKind.FORCE_OFFSET for kind in parameters.kinds])
        self.bases = bases
        self.contrast = [basis.own[varying[basis.own]] for basis in bases]
        self.rows = [[np.zeros((0, len(basis.kept) + len(extra) + 1)) for _ in range(BANDS)]
                     for basis, extra in zip(bases, self.contrast, strict=True)]
        self.counts = np.zeros((n, BANDS))
        self.samples = np.zeros(n)
        self.sums = np.zeros((n, p + 1))
        self.holds = Holds([basis.own for basis in bases])
        self.noisy, self.noise = np.array(noisy, dtype=np.intp), np.zeros((len(noisy), p, p))

    def columns(self, actuator: int) -> NDArray[np.intp]:
        """Those of K_i in the rows [K_i, C_i, f_i] of an actuator."""
        return np.concatenate([self.bases[actuator].kept, self.contrast[actuator]])

    def fold(self, rows: Sequence[Array], taken: NDArray[np.bool_], later: NDArray[np.bool_], step: float) -> None:
        """Add a block of samples in a row.

        Args:
            rows: (k_i + m_i + 1, N) of each actuator: its `columns` of K, and forces; they are written over.
            taken: (N, n) which of them take part.
            later: (N,) which samples are in the second half of their log.
            step: [s] between samples.
        """
        count = len(later)
        frequency = (np.arange(count) + 0.5) / (2 * count * step)
        band = np.clip(np.floor(np.log(frequency / LOWEST) / np.log(RATIO)), 0, BANDS - 1)
        edges = np.searchsorted(band, np.arange(BANDS + 1))
        sign = np.where(later, 1.0, -1.0)
        for i, (basis, block) in enumerate(zip(self.bases, rows, strict=True)):
            here = taken[:, i]
            if not np.any(here):
                continue
            block[:, np.flatnonzero(~here)] = 0.0
            k = len(basis.kept)
            self.sums[i, basis.columns] += block.sum(axis=1)[np.r_[:k, -1]] @ basis.expander
            self.samples[i] += np.sum(here)
            turned = self._turned(block, i, sign).T
            self.counts[i] += np.diff(edges) * np.mean(here)
            for b in range(BANDS):
                if edges[b] < edges[b + 1]:
                    self.rows[i][b] = folded_rows(self.rows[i][b], turned[edges[b] : edges[b + 1]])

    def _turned(self, block: Array, actuator: int, sign: Array) -> Array:
        """The transform of an actuator's rows, whose C_i have one `sign` (N,) in each sample."""
        k = len(self.bases[actuator].kept)
        place = {column: row for row, column in enumerate(self.bases[actuator].kept.tolist())}
        repeated = [place[column] for column in self.contrast[actuator].tolist() if column in place]
        if len(repeated) < len(self.contrast[actuator]) or np.ptp(sign):
            block[k:-1] *= sign
            return cosine_transform(block)
        # in one half of the log C_i are columns of K_i, or their opposites: their place is free for the forces
        block[k] = block[-1]
        cosine_transform(block[: k + 1])
        block[-1] = block[k]
        np.multiply(sign[0], block[repeated], out=block[k:-1])
        return block

    def add(self, other: ActuatorBands, step: float = 0.0) -> None:
        """Add what another has folded: of another log, or of a later piece of the same one, sampled each `step` [s]."""
        for mine, others in zip(self.rows, other.rows, strict=True):
            for b, block in enumerate(others):
                mine[b] = folded_rows(mine[b], block)
        self.counts += other.counts
        self.samples += other.samples
        self.sums += other.sums
        self.holds.add(other.holds, step)
        self.noise += other.noise

    def copy(self) -> ActuatorBands:
        """The same, to which others can be added."""
        return self.only(np.ones(len(self.bases), dtype=bool))

    def only(self, actuators: NDArray[np.bool_]) -> ActuatorBands:
        """Nothing but the rows of some actuators (n,), and all holds."""
        part = object.__new__(ActuatorBands)
        part.bases, part.contrast = self.bases, self.contrast
        part.rows = [[block if here else block[:0] for block in blocks]
                     for blocks, here in zip(self.rows, actuators, strict=True)]
        part.counts, part.samples = self.counts * actuators[:, None], self.samples * actuators
        part.sums, part.holds = self.sums * actuators[:, None], self.holds.copy()
        part.noisy, part.noise = self.noisy, self.noise * actuators[self.noisy, None, None]
        return part

    def channels(self, *, contrasts: bool = False) -> tuple[Channel, ...]:
        """The actuators' rows without C_i, or with them, as columns p, p + 1, … of the parameters."""
        return tuple(self._channels(contrasts))

    def _channels(self, contrasts: bool) -> Iterator[Channel]:
        first = self.sums.shape[1] - 1
        whole = self.expanded()
        for basis, contrast, blocks, counts in zip(whole.bases, self.contrast, whole.rows, self.counts, strict=True):
            extra = np.arange(first, first + len(contrast)) if contrasts else np.zeros(0, dtype=np.intp)
            first += len(extra)
            c = len(basis.own)
            kept = np.r_[: c + len(extra), c + len(contrast)]
            yield Channel(np.concatenate([basis.own, extra]), tuple(block[:, kept] for block in blocks), counts)

    def expanded(self) -> ActuatorBands:
        """The same in all columns of the actuators, with at most as many rows as columns."""
        if all(basis.kept is basis.own and all(len(block) <= block.shape[1] for block in blocks)
               for basis, blocks in zip(self.bases, self.rows, strict=True)):
            return self
        made = self.copy()
        made.bases = [ColumnBasis.whole(basis.own) for basis in self.bases]
        made.rows = [[np.hstack([block[:, : len(basis.kept)] @ basis.mixing, block[:, len(basis.kept) :]])
                      for block in map(compact, blocks)]
                     for basis, blocks in zip(self.bases, self.rows, strict=True)]
        return made

    @property
    def triangles(self) -> ActuatorTriangles:
        """The same rows whatever their frequency, without C_i."""
        whole = self.expanded()
        rows = [np.vstack([np.delete(block, np.s_[len(basis.own) : -1], axis=1) for block in blocks])
                for basis, blocks in zip(whole.bases, whole.rows, strict=True)]
        return ActuatorTriangles.of_rows(whole.bases, rows, self.samples, self.sums)
