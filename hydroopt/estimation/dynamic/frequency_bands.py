"""Rows of a regressor by actuator and frequency: what the covariance of the estimate is computed from."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct

from hydroopt.estimation.dynamic.column_basis import ColumnBasis
from hydroopt.estimation.dynamic.folding import ActuatorTriangles, Triangles
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
    much they differ between the halves. They follow from K_i, and are folded only of a block with samples of both
    halves. Rows that do not take part are zero before the transform, and a coefficient counts by the share of samples
    that do.

    Attributes:
        bases, contrast: for each actuator the columns of K_i, of which those that its basis keeps are folded, and those
            that C_i repeats.
        earlier, later: rows [K_i, f_i] of each actuator by band, of blocks in the first and the second half of a log.
        across: rows [K_i, C_i, f_i] of blocks in both.
        counts: (n, B) residuals of each actuator in each band.
        parameters: their number p.
        samples, forces: (n,) number of the rows [K_i, f_i], and sums of f_i over time.
        holds: equations of joints at rest, which these rows do not contain.
        noise: (f, p, p) expected part of K_iᵀK_i that is noise of K_i, of the actuators `noisy` (f,).
    """

    def __init__(self, parameters: ParameterSet, bases: Sequence[ColumnBasis],
                 noisy: Sequence[int] = ()) -> None:
        n, p = len(bases), len(parameters)
        varying = np.array([kind.is_friction or kind is ParameterKind.FORCE_OFFSET for kind in parameters.kinds])
        self.bases = bases
        self.contrast = [basis.own[varying[basis.own]] for basis in bases]
        kept = [len(basis.kept) + 1 for basis in bases]
        self.earlier, self.later = _empty(kept), _empty(kept)
        self.across = _empty([k + len(extra) for k, extra in zip(kept, self.contrast, strict=True)])
        self.counts = np.zeros((n, BANDS))
        self.parameters, self.samples, self.forces = p, np.zeros(n), np.zeros(n)
        self.holds = Holds([basis.own for basis in bases])
        self.noisy, self.noise = np.array(noisy, dtype=np.intp), np.zeros((len(noisy), p, p))

    def fold(self, rows: Sequence[Array], taken: NDArray[np.bool_], later: NDArray[np.bool_], step: float) -> None:
        """Add a block of samples in a row.

        Args:
            rows: (k_i + 1, N) of each actuator: the kept columns of K, and forces; they are written over.
            taken: (N, n) which of them take part.
            later: (N,) which samples are in the second half of their log.
            step: [s] between samples.
        """
        count = len(later)
        ends = 2 * count * step * LOWEST * RATIO ** np.arange(1.0, BANDS)  # coefficient k has k + ½ half waves
        edges = np.concatenate([[0], np.clip(np.ceil(ends - 0.5), 0, count).astype(int), [count]])
        folded = self.later if np.all(later) else self.across if np.any(later) else self.earlier
        for i, (block, here) in enumerate(zip(rows, np.ascontiguousarray(taken.T), strict=True)):
            if not (many := np.count_nonzero(here)):
                continue
            self.samples[i] += many
            self.counts[i] += np.diff(edges) * (many / count)
            contrast = np.where(later, 1.0, -1.0) * (self._repeated(i).T @ block[:-1]) if folded is self.across else ()
            whole = np.vstack([block[:-1], contrast, block[-1:]]) if len(contrast) else block
            whole[:, ~here] = 0.0
            turned = dct(whole, norm="ortho", overwrite_x=True).T
            self.forces[i] += np.sqrt(count) * turned[0, -1]
            folded[i].fold(turned, edges)

    def _repeated(self, actuator: int) -> Array:
        """(k, m) what makes the columns that C repeats of the kept ones."""
        basis = self.bases[actuator]
        return basis.mixing[:, np.isin(basis.own, self.contrast[actuator])]

    @property
    def _folded(self) -> tuple[list[Triangles], list[Triangles], list[Triangles]]:
        return self.earlier, self.later, self.across

    def add(self, other: ActuatorBands) -> None:
        """Add what another has folded, of another log."""
        for mine, others in zip(self._folded, other._folded, strict=True):
            for own, more in zip(mine, others, strict=True):
                own.add(more)
        self.counts += other.counts
        self.samples += other.samples
        self.forces += other.forces
        self.holds.add(other.holds)
        self.noise += other.noise

    def copy(self) -> ActuatorBands:
        """The same, to which others can be added."""
        made = object.__new__(ActuatorBands)
        made.bases, made.contrast, made.parameters = self.bases, self.contrast, self.parameters
        made.earlier, made.later, made.across = ([rows.copy() for rows in some] for some in self._folded)
        made.counts, made.samples, made.forces = self.counts.copy(), self.samples.copy(), self.forces.copy()
        made.holds, made.noisy, made.noise = self.holds.copy(), self.noisy, self.noise.copy()
        return made

    def channels(self, *, contrasts: bool = False) -> tuple[Channel, ...]:
        """The actuators' rows without C_i, or with them, as columns p, p + 1, … of the parameters."""
        return tuple(self._channels(contrasts))

    def _channels(self, contrasts: bool) -> Iterator[Channel]:
        first = self.parameters
        whole = self.expanded()
        for basis, contrast, rows, counts in zip(whole.bases, self.contrast, whole.across, self.counts, strict=True):
            extra = np.arange(first, first + len(contrast)) if contrasts else np.zeros(0, dtype=np.intp)
            first += len(extra)
            c = len(basis.own)
            kept = np.r_[: c + len(extra), c + len(contrast)]
            yield Channel(np.concatenate([basis.own, extra]), tuple(rows[b][:, kept] for b in range(BANDS)), counts)

    def expanded(self) -> ActuatorBands:
        """The same in all columns of the actuators, [K_i, C_i, f_i] `across` the halves, with at most as many rows as
        columns."""
        if all(basis.kept is basis.own and first.empty and second.empty
               for basis, first, second, _ in zip(self.bases, *self._folded, strict=True)):
            return self
        made = self.copy()
        made.bases = [ColumnBasis.whole(basis.own) for basis in self.bases]
        made.earlier, made.later = (_empty([len(basis.columns) for basis in self.bases]) for _ in range(2))
        made.across = _empty([len(basis.columns) + len(extra)
                              for basis, extra in zip(self.bases, self.contrast, strict=True)])
        for i, whole in enumerate(made.across):
            for rows, sign in zip(self._folded, (-1.0, 1.0, 0.0), strict=True):
                whole.add([self._spread(i, rows[i][b], sign) for b in range(BANDS)])
        return made

    def _spread(self, actuator: int, rows: Array, sign: float) -> Array:
        """Rows [K, C, f] in all columns, of those in the kept ones; where C has one sign, of [K, f] there."""
        k = len(self.bases[actuator].kept)
        contrast = sign * (rows[:, :k] @ self._repeated(actuator)) if sign else rows[:, k:-1]
        return np.hstack([rows[:, :k] @ self.bases[actuator].mixing, contrast, rows[:, -1:]])

    @property
    def triangles(self) -> ActuatorTriangles:
        """The same rows whatever their frequency, without C_i."""
        whole = self.expanded()
        rows = [np.vstack([np.delete(own[b], np.s_[len(basis.own) : -1], axis=1) for b in range(BANDS)])
                for basis, own in zip(whole.bases, whole.across, strict=True)]
        return ActuatorTriangles.of_rows(whole.bases, self.parameters, rows, self.samples, self.forces)


def _empty(columns: Sequence[int]) -> list[Triangles]:
    """No rows, of so many columns by actuator."""
    return [Triangles(BANDS, k) for k in columns]
