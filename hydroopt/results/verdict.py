"""The verdict of an answer: what it can be used for, with which figures, and what to do next."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from typing import Any, NamedTuple

from hydroopt.results.diagnostic import FIRST, Diagnostic, by_kind
from hydroopt.results.parameter_table import ParameterRow
from hydroopt.results.readable import percentage, readable
from hydroopt.results.status import Status
from hydroopt.results.tables import number

LEVEL = 0.95
"""Probability with which the bound of a claim holds."""
NORMAL = 1.96
"""Half-width of a 95 % interval in standard deviations."""
LINES, WIDTH, NARROWEST = 12, 110, 60
"""Most lines of a card, and most and least characters of a line."""


class Purpose(StrEnum):
    """What an answer may be used for."""

    LOG = "identification from these logs"
    FORCE = "force"
    """Prediction of the force of an actuator."""
    MASS = "mass"
    """A single mass."""
    WEIGHING = "weighing"
    CONTROL = "control"
    """Feedforward and gravity compensation."""
    POSITION = "position"
    """Position of the tip."""
    LENGTH = "length"
    """A single dimension of the geometry."""
    SENSOR = "sensor"
    """The correction of a sensor."""
    VALVE = "valve"
    """Valves and oil."""
    CHANGE = "change"
    """A change between sessions."""
    LOAD = "load"
    """The mass or centre of a load."""
    DRIVING = "driving this motion"
    DRIVING_TO = "driving to these poses"


class Usable(StrEnum):
    """Whether an answer is usable for a purpose; not tested where the data for that are missing."""

    YES = "usable"
    NO = "not usable"
    UNTESTED = "not tested"


class About(StrEnum):
    """What a claim is about: what the same sensors will read, or what is true whatever they read."""

    READING = "reading"
    TRUTH = "truth"


class Threshold(NamedTuple):
    """Largest figure of a purpose, as a part of what it is measured by, and the reason for it."""

    part: float
    of: str
    reason: str


THRESHOLDS: Mapping[Purpose, Threshold] = {
    Purpose.FORCE: Threshold(0.05, "the force's range", (
        "The range is four standard deviations of the force: feedforward that errs by a twentieth of it leaves 4 % of "
        "the force's variance to the feedback.")),
    Purpose.MASS: Threshold(0.10, "its value", (
        "Drawings and catalogues state masses within about a tenth: a wider 95 % interval adds nothing to them. At "
        "least three quarters of the information must be from data, else the number repeats the machine file.")),
    Purpose.WEIGHING: Threshold(0.05, "the load that the machine can hold", (
        "Scales on loaders and excavators that fill trucks state errors of a few per cent of full scale.")),
    Purpose.CONTROL: Threshold(0.05, "the force's range", (
        "As of a force: a model is as good as its worst actuator.")),
    Purpose.POSITION: Threshold(0.004, "the reach", (
        "Guidance of excavators that grade states about 30 mm at a reach of 8 m.")),
    Purpose.LENGTH: Threshold(0.5, "its uncertainty before", (
        "Half of the uncertainty before: three quarters of the information are from the poses.")),
    Purpose.SENSOR: Threshold(0.5, "its uncertainty before", (
        "Half of the uncertainty before: three quarters of the information are from the data.")),
    Purpose.VALVE: Threshold(0.10, "the range of the channel", (
        "A free run from commands alone adds up all errors: within a tenth of the range the model follows the machine "
        "for the whole log.")),
    Purpose.LOAD: Threshold(0.05, "its value", "As of weighing."),
}
"""When a figure counts as usable. A purpose without a threshold is decided by a test."""


@dataclass(frozen=True)
class Claim:
    """How wrong an answer is for one purpose and one part of the machine, and whether that is within the need.

    Attributes:
        purpose: what for.
        of: actuator, body, parameter or point that it is about; "" for the whole machine.
        usable: whether the bound is within the need of the purpose.
        bound: the error [`unit`, SI] that is not exceeded with the probability `LEVEL`; None where there is none.
        unit: of it.
        part: the bound as a part of what the purpose's `Threshold` says; None where unknown.
        condition: under which the bound holds.
        reason: why it is not usable, or not tested; empty where it is usable.
        about: whether the bound is about readings or about the truth, which scale errors of sensors change.

    >>> claim = Claim(Purpose.FORCE, "boom_cylinder", Usable.YES, 2600.0, "N", 0.02)
    >>> print(claim)
    boom_cylinder ±2.6 kN (2.0 %)
    """

    purpose: Purpose
    of: str
    usable: Usable
    bound: float | None = None
    unit: str = ""
    part: float | None = None
    condition: str = ""
    reason: str = ""
    about: About = About.TRUTH

    @property
    def tested(self) -> bool:
        """Whether there were data to test the bound."""
        return self.usable is not Usable.UNTESTED

    @property
    def size(self) -> str:
        """The bound in print, with the part that it is."""
        sign = "from " if self.purpose is Purpose.CHANGE else "±"
        size = "" if self.bound is None else f"{sign}{readable(self.bound, self.unit)}"
        part = "" if self.part is None else f" ({percentage(self.part)})" if size else f"±{percentage(self.part)}"
        return f"{size}{part}"

    def __str__(self) -> str:
        return f"{self.of} {self.size}".strip()

    def as_dict(self) -> dict[str, Any]:
        """The entry of a JSON file."""
        finite = {key: None if (value := getattr(self, key)) is None else number(value) for key in ("bound", "part")}
        return asdict(self) | finite | {"purpose": str(self.purpose), "usable": str(self.usable),
                                        "about": str(self.about), "level": LEVEL, "tested": self.tested}


def judged(purpose: Purpose, of: str, bound: float, unit: str, part: float, *, condition: str = "",
           reason: str = "", untested: str = "", about: About = About.TRUTH) -> Claim:
    """A claim, decided by the threshold of its purpose.

    Args:
        purpose: with a threshold.
        of: what it is about.
        bound: the error [`unit`].
        unit: of it, SI.
        part: the bound as a part of what the threshold says; NaN where unknown, which is not tested.
        condition: under which the bound holds.
        reason: why it is not usable, if that is not the bound alone.
        untested: why it is not tested, if the data for that are missing.
        about: whether it is about readings or the truth.

    >>> judged(Purpose.MASS, "boom.m", 40.0, "kg", 0.03).usable
    <Usable.YES: 'usable'>
    """
    limit = THRESHOLDS[purpose]
    known, size = number(part), number(bound)
    if untested:
        return Claim(purpose, of, Usable.UNTESTED, size, unit, known, condition, untested, about)
    if known is None and not reason:
        return Claim(purpose, of, Usable.UNTESTED, size, unit, None, condition, f"{limit.of} is not known", about)
    if reason or (known is not None and known > limit.part):
        return Claim(purpose, of, Usable.NO, size, unit, known, condition,
                   reason or f"more than {percentage(limit.part)} of {limit.of}", about)
    return Claim(purpose, of, Usable.YES, size, unit, known, condition, about=about)


def determined(purpose: Purpose, row: ParameterRow, *, condition: str = "", unknown: str = "") -> Claim:
    """A single number of an answer, decided by how much the data narrowed it.

    Args:
        purpose: whose threshold is a part of the uncertainty before.
        row: of the table of parameters.
        condition: under which its interval holds.
        unknown: why it has none, where it has none.
    """
    if row.std is None or row.identifiability == "none":
        return Claim(purpose, row.name, Usable.NO, reason=unknown)
    half = NORMAL * row.std
    if not row.prior_std:
        return Claim(purpose, row.name, Usable.YES, half, row.unit, condition=condition)
    return judged(purpose, row.name, half, row.unit, row.std / row.prior_std, condition=condition)


class Action(StrEnum):
    """What a next step is."""

    DRIVE = "drive"
    MEASURE = "measure"
    CHECK = "check"
    STATE = "state"
    USE = "use"


@dataclass(frozen=True)
class NextStep:
    """What to do next: an action, a sentence that says how, and the command that does it, if there is one.

    The command is what can be copied to a shell, where all that it needs is known.
    """

    action: Action
    text: str
    command: str = ""


@dataclass(frozen=True)
class Verdict:
    """What an answer can be used for, what not, and what to do next; of no answer that is not ok anything is usable.

    Attributes:
        title: machine and job.
        status: of the answer.
        cause: why it is not ok, or what the machine file lacks, in a sentence.
        finding: the answer in a sentence, where the job asks a question, such as whether anything changed.
        claims: by purpose and part of the machine, those with a bound first.
        next_steps: the most useful first.

    >>> verdict = Verdict("crane: identification", Status.OK, "", (
    ...     Claim(Purpose.FORCE, "lift_cylinder", Usable.YES, 260.0, "N", 0.02, "on 1 held-out log"),),
    ...     (NextStep(Action.USE, "Write the model as C:", "hydroopt codegen out -o c"),))
    >>> print(verdict.card())
    crane: identification: ok
      usable      force: lift_cylinder ±260 N (2.0 %); on 1 held-out log
      next        Write the model as C:
                  hydroopt codegen out -o c
    >>> verdict.usable(Purpose.FORCE), verdict.usable(Purpose.CONTROL), verdict.serves
    (True, False, True)
    """

    title: str
    status: Status
    cause: str = ""
    claims: tuple[Claim, ...] = ()
    next_steps: tuple[NextStep, ...] = ()
    finding: str = ""

    def __post_init__(self) -> None:
        claims = sorted(self.claims, key=lambda each: each.bound is None)
        if self.status is not Status.OK:
            claims = [replace(each, usable=Usable.NO, reason=f"the answer is {self.status}")
                      if each.usable is Usable.YES else each for each in claims]
        object.__setattr__(self, "claims", tuple(claims))

    @property
    def serves(self) -> bool:
        """Whether it is usable for anything, or names no use at all."""
        return not self.claims or any(claim.usable is Usable.YES for claim in self.claims)

    @property
    def said(self) -> tuple[Claim, ...]:
        """The claims that a card shows: those about readings, or about the truth where there are none of these."""
        read = {(each.purpose, each.of) for each in self.claims if each.about is About.READING}
        return tuple(each for each in self.claims
                     if each.about is About.READING or (each.purpose, each.of) not in read)

    @property
    def truths(self) -> dict[tuple[Purpose, str], Claim]:
        """The claims about the truth by what they are about."""
        return {(each.purpose, each.of): each for each in self.claims if each.about is About.TRUTH}

    def usable(self, purpose: Purpose, subject: str | None = None) -> bool:
        """Whether the answer is usable for a purpose: for one part of the machine, or for all that it is about."""
        about = [claim for claim in self.claims if claim.purpose is purpose and subject in (None, claim.of)]
        return bool(about) and all(claim.usable is Usable.YES for claim in about)

    def card(self, width: int = WIDTH) -> str:
        """The verdict as plain text for a terminal: of at most `LINES` lines, or as much text in narrower ones.

        The first next step is always there.
        """
        width = max(NARROWEST, min(WIDTH, width))
        limit = LINES * WIDTH // width
        for most, conditions in ((6, True), (4, True), (3, True), (2, True), (1, True), (1, False)):
            lines, steps = self._lines(most, width, conditions=conditions), self._steps(max(1, most // 2), width)
            if len(lines) + len(steps) <= limit:
                break
        return "\n".join([*lines[:max(limit - len(steps), 1)], *steps])

    def _steps(self, most: int, width: int) -> list[str]:
        """Next steps; commands stay on one line of their own, so that they can be copied."""
        return [line for step in self.next_steps[:most] for line in (
            *_wrapped(step.text, "next", width), *([f"{'':14}{step.command}"] if step.command else []))]

    def _lines(self, most: int, width: int, *, conditions: bool) -> list[str]:
        """The card without next steps, with so many subjects a purpose at most."""
        lines = _wrapped(f"{self.title}: {self.status}{f'. {self.cause}' if self.cause else ''}", "", width)
        if self.finding:
            lines += _wrapped(self.finding, "found", width)
        for usable in Usable:
            for purpose in Purpose:
                if some := [claim for claim in self.said if (claim.purpose, claim.usable) == (purpose, usable)]:
                    lines += _wrapped(f"{purpose}: {_folded(some, most, conditions=conditions)}", usable, width)
        return lines

    @property
    def facts(self) -> dict[str, str]:
        """Cause, what it is usable for, what not, and the next step: texts by their headings, for a notebook."""
        said = {str(self.status): self.cause} if self.cause else {}
        for usable in Usable:
            texts = [f"{purpose}: {_folded(some, 3, conditions=True)}" for purpose in Purpose if (
                some := [claim for claim in self.said if (claim.purpose, claim.usable) == (purpose, usable)])]
            said |= {str(usable): ". ".join(texts)} if texts else {}
        return said | ({"next": " ".join(filter(None, (
            self.next_steps[0].text, self.next_steps[0].command)))} if self.next_steps else {})

    def as_dict(self) -> dict[str, Any]:
        """The entry of a JSON file."""
        return {"title": self.title, "status": str(self.status), "cause": self.cause,
                "finding": self.finding,
                "unbounded": [each.as_dict() for each in self.claims if each.bound is None],
                "next_steps": [asdict(step) | {"action": str(step.action)} for step in self.next_steps],
                "thresholds": {str(purpose): THRESHOLDS[purpose]._asdict()
                               for purpose in dict.fromkeys(each.purpose for each in self.claims)
                               if purpose in THRESHOLDS}}


def noted(diagnostics: Iterable[Diagnostic], cause: str, width: int, room: int) -> list[str]:
    """Diagnostics as lines for a terminal: what contradicts, then the first note of each kind, at most `FIRST` of them.

    Args:
        diagnostics: of an answer.
        cause: the sentence that its verdict states already.
        width: characters of a line.
        room: lines that notes may take beyond the first.

    >>> some = [Diagnostic("oscillation", (name,), {}, f"{name} oscillates.") for name in ("boom", "stick")]
    >>> print(*noted(some, "", 80, 5), sep="\\n")
      note        boom oscillates. One more like it.
    """
    kinds, lines, shown = by_kind(each for each in diagnostics if each.text != cause), list[str](), 0
    for k, (first, *others) in enumerate(kinds):
        alike = "" if not others else " One more like it." if len(others) == 1 else f" {len(others)} more like it."
        said = first.text if first.contradicts else f"{first.text}{alike} {first.remedy}"
        wrapped = _wrapped(said.strip(), "and" if first.contradicts else "note", width)
        if not first.contradicts and (k >= FIRST or (k and len(lines) + len(wrapped) > room)):
            lines.append(f"  {len(kinds) - shown} kinds of notes more are in the JSON file and the report")
            break
        lines, shown = lines + wrapped, shown + 1
    return lines


def _folded(claims: Sequence[Claim], most: int, *, conditions: bool) -> str:
    """The figures of several claims by the reason that they share, then their conditions if they are wanted."""
    groups: dict[str, list[Claim]] = {}
    for claim in claims:
        groups.setdefault(claim.reason, []).append(claim)
    said = [": ".join(filter(None, [_figures(some, -(-most // len(groups))), reason]))
            for reason, some in groups.items()]
    on = dict.fromkeys(claim.condition for claim in claims if claim.condition and conditions)
    return "; ".join(filter(None, [*said, *on][:3]))


def _figures(claims: Sequence[Claim], most: int) -> str:
    """The first figures of several claims, and how many there are more."""
    more = f" and {len(claims) - most} more" if len(claims) > most else ""
    return f"{', '.join(filter(None, map(str, claims[:most])))}{more}"


def _wrapped(text: str, label: str, width: int) -> list[str]:
    """A text after a label, with its further lines below it."""
    first = f"  {label:<11} " if label else ""
    whole = re.sub(r"(\d) (?=\S)", "\\1\N{NO-BREAK SPACE}", text)  # a number and its unit stay together
    lines = textwrap.wrap(whole, width, initial_indent=first, subsequent_indent=" " * (14 if label else 2),
                          break_on_hyphens=False)
    return [line.replace("\N{NO-BREAK SPACE}", " ") for line in lines] or [first.rstrip()]
