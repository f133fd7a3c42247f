"""What a stage of the link-by-link method gave: the iterations that the thesis counts, and its truncation."""

from __future__ import annotations

from typing import Any, NamedTuple

from hydroopt.results.tables import number


class StageResult(NamedTuple):
    """What a stage gave; the last one, named 'all', is what the loops of all stages gave together.

    Attributes:
        stage: its name.
        joint: the joint that moved unsensed; '' if all were sensed.
        unknowns: parameters that no stage before had identified, with the circle's two (Eq. 3.28).
        identified: names of those that this stage identified.
        iterations: steps of Eq. 3.43 that were made, the columns "No. of Iterations" of Tables 4 to 7 and 9.
        truncation: part p of the largest singular value below which the last step zeroed singular values.
        rank: singular values that it kept.
        rms: root mean square of the rows [m].
    """

    stage: str
    joint: str
    unknowns: int
    identified: tuple[str, ...]
    iterations: int
    truncation: float
    rank: int
    rms: float

    def __str__(self) -> str:
        moved = f", {self.joint} moves" if self.joint else ""
        return (f"{self.stage}{moved}: {self.iterations} iterations, {len(self.identified)} of {self.unknowns} "
                f"unknowns identified, rank {self.rank} at a truncation of {100 * self.truncation:.1e} %, "
                f"RMS {1e3 * self.rms:.3f} mm")

    def as_dict(self) -> dict[str, Any]:
        """The entry of a JSON file."""
        return {**self._asdict(), "identified": list(self.identified), "rms": number(self.rms)}
