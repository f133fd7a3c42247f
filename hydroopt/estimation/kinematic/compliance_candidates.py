"""Sets of joints that give way under gravity, and how well each predicts held-out poses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from hydroopt.results.readable import readable
from hydroopt.results.tables import number

LARGEST = 1.0
"""Deflection [rad, m] that no joint has: poses that show only larger ones show none."""
CLEAR = 2.0
"""Standard errors by which errors of held-out poses must lie along what one more compliant joint changes."""
RULE = ("Joints are taken in one after the other, the one first that lowers the squared errors of held-out poses most, "
        f"as long as they fall and the evidence is above {CLEAR:g} standard errors.")


@dataclass(frozen=True)
class ComplianceCandidate:
    """Joints that give way, and the squared error of held-out poses (mean per row, in σ²; noise alone gives at most 1).

    `difference` is that from the set that was chosen before, `evidence` how clearly held-out poses show the joint that
    was added, in standard errors.
    """

    joints: tuple[str, ...]
    held_out: float
    difference: float
    evidence: float
    chosen: bool


@dataclass(frozen=True)
class ComplianceChoice:
    """The sets of compliant joints that were tried, in their order; the last that is `chosen` holds.

    Attributes:
        candidates: the sets.
        detectable: by how much each joint must give way at most [rad, m] to be found with a probability of 95 %;
            infinite where it never is. `units` are those of the joints.
    """

    candidates: tuple[ComplianceCandidate, ...]
    detectable: Mapping[str, float]
    units: Mapping[str, str]

    @property
    def joints(self) -> tuple[str, ...]:
        """Those that give way."""
        return [each for each in self.candidates if each.chosen][-1].joints

    def as_dict(self) -> dict[str, Any]:
        """The entry ``compliance_choice`` of estimate.json."""
        return {"rule": RULE, "joints": list(self.joints), "candidates": [
            {"joints": list(each.joints), "held_out": number(each.held_out), "difference": number(each.difference),
             "evidence": number(each.evidence), "chosen": each.chosen} for each in self.candidates],
             "detectable_sag": {joint: number(sag) for joint, sag in self.detectable.items()}}

    def __str__(self) -> str:
        names = [", ".join(each.joints) or "none" for each in self.candidates]
        width = max(map(len, ("compliant", *names)))
        lines = [f"  {'compliant':<{width}}  held-out [σ²]  difference  evidence"]
        for name, each in zip(names, self.candidates, strict=True):
            change = "" if each is self.candidates[0] else f"{each.difference:+10.4f}  {each.evidence:8.1f}"
            lines.append(f"{'*' if each.chosen else ' '} {name:<{width}}  {each.held_out:>13.4f}  {change}")
        shown = ", ".join(f"{joint} from {readable(sag, self.units[joint])}" if sag < LARGEST else f"{joint} never"
                          for joint, sag in self.detectable.items())
        return "\n".join([*lines, RULE, "Deflections that would show in these poses with a probability of 95 %: "
                          f"{shown}."])
