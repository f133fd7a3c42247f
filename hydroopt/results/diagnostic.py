"""A diagnostic: one thing that a reader should know before trusting an answer."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from string import Formatter
from typing import Any, Self

LEAST_P = 1e-15
"""p-value below which rounding errors leave no digit of it."""
NAMED = 8
"""How many names of a list are written out."""
FIRST = 5
"""Kinds of diagnostics that stand beside a verdict."""


class Meaning(StrEnum):
    """What a diagnostic means for its answer; the value stands in JSON files."""

    NOTE = "note"
    """It is about the data and leaves the answer as it is."""
    PROPERTY = "property"
    """It is what machine, machine file and motion are like, whatever the readings are."""
    LACK = "lack"
    """It is a property that the machine file lacks, to be stated before anything else is done."""
    CONTRADICTION = "contradiction"
    """It makes the answer suspect."""
    REFUTATION = "refutation"
    """It makes the answer suspect, and no machine is made of it unless that is forced: its data are misread."""


class _Sentence(Formatter):
    """A format such as ``.0f %`` writes a part as a percentage; None is unknown."""

    def format_field(self, value: Any, format_spec: str) -> str:
        if value is None:
            return "unknown"
        if format_spec.endswith(" %"):
            return f"{100 * value:{format_spec.removesuffix(' %')}} %"
        return str(super().format_field(value, format_spec))


@dataclass(frozen=True)
class Diagnostic:
    """One finding about an answer, stated by the code that finds it.

    Code decides by `meaning`, `kind`, `subject` and `evidence`; `text` and `remedy` are never searched.

    Attributes:
        kind: what was found, a short name that stays the same from version to version.
        subject: names of the parameters, bodies, actuators, logs or poses that it is about.
        evidence: the numbers (SI, or as the key says) and words that show it.
        text: what was found, as one or two sentences.
        remedy: what to do about it; empty where nothing can be done.
        meaning: what it means for the answer.

    Example:
        >>> d = Diagnostic.of("worse than zero", ("boom_cylinder",), {"relative": 1.31},
        ...                   "The forces of {subject} are predicted worse than by zero ({relative:.0f %} error).",
        ...                   meaning=Meaning.CONTRADICTION)
        >>> print(d.text, d.contradicts)
        The forces of boom_cylinder are predicted worse than by zero (131 % error). True
    """

    kind: str
    subject: tuple[str, ...]
    evidence: Mapping[str, Any]
    text: str
    remedy: str = ""
    meaning: Meaning = Meaning.NOTE

    @classmethod
    def of(cls, kind: str, subject: Sequence[str], evidence: Mapping[str, Any], text: str, remedy: str = "",
           meaning: Meaning = Meaning.NOTE) -> Self:
        """With text and remedy as templates for `filled`."""
        return cls(kind, tuple(subject), dict(evidence), filled(text, subject, evidence),
                   filled(remedy, subject, evidence), meaning)

    @property
    def contradicts(self) -> bool:
        """Whether it makes the answer suspect."""
        return self.meaning in (Meaning.CONTRADICTION, Meaning.REFUTATION)

    @property
    def about_machine(self) -> bool:
        """Whether it is a property of machine, machine file and motion, whatever the readings are."""
        return self.meaning in (Meaning.PROPERTY, Meaning.LACK)

    def __str__(self) -> str:
        return f"{self.text} {self.remedy}".strip()

    def as_dict(self) -> dict[str, Any]:
        """The entry of a JSON file."""
        return asdict(self) | {"subject": list(self.subject), "meaning": str(self.meaning)}


def filled(template: str, subject: Sequence[str], evidence: Mapping[str, Any]) -> str:
    """A template with a diagnostic's subject and evidence; ``{relative:.0f %}`` writes 0.25 as "25 %"."""
    return _Sentence().vformat(template, (), {**evidence, "subject": listed(subject)})


def in_samples(log: str, text: str) -> Diagnostic:
    """What was found in the samples of a log when it was read."""
    return Diagnostic.of("finding in the data", (log,), {"text": text}, "{subject}: {text}")


def listed(names: Sequence[str], most: int = NAMED) -> str:
    """Names with commas in between, at most so many."""
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


def of_kind(diagnostics: Iterable[Diagnostic], *kinds: str) -> tuple[Diagnostic, ...]:
    """Those of some kinds."""
    return tuple(diagnostic for diagnostic in diagnostics if diagnostic.kind in kinds)


def by_kind(diagnostics: Iterable[Diagnostic]) -> list[list[Diagnostic]]:
    """Diagnostics in the order in which a reader needs them: contradictions one by one, then notes kind by kind, those
    about the data before those about machine and motion.

    >>> both = [Diagnostic("not excited", ("boom.m",), {}, "Not excited: boom.m.", meaning=Meaning.PROPERTY),
    ...         *(Diagnostic("oscillation", (name,), {}, f"{name} oscillates.") for name in ("boom", "stick"))]
    >>> [[one.text for one in kind] for kind in by_kind(both)]
    [['boom oscillates.', 'stick oscillates.'], ['Not excited: boom.m.']]
    """
    kinds: dict[tuple[bool, bool, str], list[Diagnostic]] = {}
    for each in diagnostics:
        kinds.setdefault((not each.contradicts, each.about_machine, str(each) if each.contradicts else each.kind),
                         []).append(each)
    return [kinds[key] for key in sorted(kinds, key=lambda key: key[:2])]


def probability(p: float) -> str:
    """A p-value in words."""
    return f"p < {LEAST_P:.0e}" if p < LEAST_P else f"p = {p:.2g}"
