"""A diagnostic: one thing that a reader should know before trusting an answer, as a typed value."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from hydroopt.results.machine_wording import MACHINE_WORDS
from hydroopt.results.pose_wording import POSE_WORDS
from hydroopt.results.sensor_wording import SENSOR_WORDS
from hydroopt.results.session_wording import SESSION_WORDS
from hydroopt.results.wording import WORDS, Kind, filled

_ALL_WORDS = WORDS | MACHINE_WORDS | POSE_WORDS | SESSION_WORDS | SENSOR_WORDS
LEAST_P = 1e-15
"""p-value below which rounding errors leave no digit of it."""
NAMED = 8
"""How many names of a list are written out."""


@dataclass(frozen=True)
class Diagnostic:
    """One finding about an answer.

    Code decides by `kind`, `subject` and `evidence`; text and remedy are written from them in `results/wording.py` and
    are never searched.

    Attributes:
        kind: what was found.
        subject: names of the parameters, bodies, actuators, logs or poses that it is about.
        evidence: the numbers (SI, or as the key says) and words that show it.

    Example:
        >>> from hydroopt.results.wording import Kind
        >>> d = Diagnostic(Kind.WORSE_THAN_ZERO, ("boom_cylinder",), {"relative": 1.31})
        >>> print(d.text)
        The forces of boom_cylinder in the validation logs are predicted worse than by zero (131 % error).
    """

    kind: Kind
    subject: tuple[str, ...] = ()
    evidence: Mapping[str, Any] = field(default_factory=dict)

    @property
    def text(self) -> str:
        """What was found, as one or two sentences."""
        return filled(_ALL_WORDS[self.kind].text, listed(self.subject), self.evidence)

    @property
    def remedy(self) -> str:
        """What to do about it; empty where nothing can be done."""
        return filled(_ALL_WORDS[self.kind].remedy, listed(self.subject), self.evidence)

    def __str__(self) -> str:
        return f"{self.text} {self.remedy}".strip()

    def as_dict(self) -> dict[str, Any]:
        """The entry of a JSON file."""
        return {"kind": str(self.kind), "subject": list(self.subject), "evidence": dict(self.evidence),
                "text": self.text, "remedy": self.remedy}


def listed(names: Sequence[str], most: int = NAMED) -> str:
    """Names with commas in between, at most so many."""
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


def of_kind(diagnostics: Iterable[Diagnostic], *kinds: Kind) -> tuple[Diagnostic, ...]:
    """Those of some kinds."""
    return tuple(diagnostic for diagnostic in diagnostics if diagnostic.kind in kinds)


def sentences(diagnostics: Iterable[Diagnostic]) -> list[str]:
    """Text and remedy of each diagnostic; a remedy that several in a row share follows the last of them."""
    found = list(diagnostics)
    return [each.text if after is not None and after.remedy == each.remedy else str(each)
            for each, after in zip(found, [*found[1:], None], strict=True)] if found else []


def probability(p: float) -> str:
    """A p-value in words."""
    return f"p < {LEAST_P:.0e}" if p < LEAST_P else f"p = {p:.2g}"
