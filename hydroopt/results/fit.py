"""How closely a model follows the readings of one channel."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from hydroopt.results.tables import number


@dataclass(frozen=True)
class Fit:
    """How well one channel is predicted: RMS error [N or N·m], variance accounted for, error relative to the signal.

    VAF is 1 − var(error)/var(signal) (Eq. 3.45); relative is ‖error‖/‖signal‖. The last two are of free runs only: the
    largest error [`unit`], and the RMS error as a part of the range that the channel covers.
    """

    rms: float
    vaf: float
    relative: float
    unit: str
    largest: float | None = None
    of_range: float | None = None

    def __str__(self) -> str:
        text = (f"RMS {self.rms:10.4g} {self.unit:<5} relative {100 * self.relative:6.2f} %  "
                f"VAF {100 * self.vaf:7.3f} %")
        if self.largest is None or self.of_range is None:
            return text
        return f"{text}  largest {self.largest:10.4g}  {100 * self.of_range:6.2f} % of the range"

    def as_dict(self) -> dict[str, Any]:
        """The entry of a JSON file: None where a number does not exist; `largest` and `of_range` of free runs only."""
        entry = asdict(self)
        return {key: value if key == "unit" else number(value) for key, value in entry.items() if value is not None}

    @classmethod
    def from_dict(cls, entry: Mapping[str, Any]) -> Fit:
        """The fit that `as_dict` wrote.

        Raises:
            KeyError, TypeError, ValueError: this is not such an entry.
        """
        rms, vaf, relative = (float("nan") if entry[key] is None else float(entry[key])
                              for key in ("rms", "vaf", "relative"))
        return cls(rms, vaf, relative, str(entry["unit"]), entry.get("largest"), entry.get("of_range"))
