"""How closely a model follows the readings of one channel."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from hydroopt.results.readable import readable
from hydroopt.results.tables import number
from hydroopt.spatial.inertia import Array

ROUNDING = 1e-15
"""Spread of a signal, as a part of its squares, that is rounding alone."""


@dataclass(frozen=True)
class Fit:
    """How well one channel is predicted: RMS error [`unit`], variance accounted for, error relative to the signal.

    RMS are those of Eq. 3.44 and 3.45. VAF is ``1 − Σ error²/Σ (signal − mean)²`` (Eq. 3.46), so that a constant error
    lowers it, and NaN of a constant signal; relative is ‖error‖/‖signal‖. Of several channels, all sums are over the
    channels, each about its own mean: the figures lie between those of the parts. The last two are of free runs only:
    the largest error [`unit`], and the RMS error as a part of the range that the channel covers.

    >>> signal = np.array([0.0, 1.0, 2.0, 3.0])
    >>> Fit.of(np.full(4, 0.5), signal, "N").vaf
    0.8
    """

    rms: float
    vaf: float
    relative: float
    unit: str
    largest: float | None = None
    of_range: float | None = None

    @classmethod
    def of(cls, error: Array, signal: Array, unit: str, *, free_run: bool = False) -> Fit:
        """Of errors (N,) or (N, d) of a signal of this shape; the last two figures, too, of one `free_run` (N,)."""
        fit = cls.of_sums(np.array([len(error), np.sum(error**2), np.sum(signal**2),
                                    np.sum((signal - signal.mean(axis=0)) ** 2)]), unit)
        if not free_run:
            return fit
        covered = float(np.ptp(signal))
        return replace(fit, largest=float(np.max(np.abs(error))),
                       of_range=fit.rms / covered if covered else float("inf"))

    @classmethod
    def of_sums(cls, sums: Array, unit: str) -> Fit:
        """Of the number of samples and the sums (4,) of error², signal² and (signal − mean)² over them."""
        count, error, signal, spread = sums.tolist()
        vaf = 1 - error / spread if spread > ROUNDING * signal else float("nan")
        relative = np.sqrt(error / signal) if signal else np.inf
        return cls(float(np.sqrt(error / count)), vaf, float(relative), unit)

    def __str__(self) -> str:
        text = (f"RMS {readable(self.rms, self.unit, 3):>12}  relative {100 * self.relative:6.2f} %  "
                f"VAF {100 * self.vaf:7.3f} %")
        if self.largest is None or self.of_range is None:
            return text
        return f"{text}  largest {readable(self.largest, self.unit, 3):>12}  {100 * self.of_range:6.2f} % of the range"

    def as_dict(self) -> dict[str, Any]:
        """The entry of a JSON file: None where a number does not exist; `largest` and `of_range` of free runs only."""
        entry = asdict(self)
        return {key: value if key == "unit" else number(value) for key, value in entry.items() if value is not None}
