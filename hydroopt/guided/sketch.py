"""What is known of a machine so far: answers, typical numbers for the rest, and what is still to be asked."""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

from hydroopt.guided.interview import ask
from hydroopt.guided.plane import OpenError
from hydroopt.guided.question import TYPICAL, AnswerError, Question
from hydroopt.guided.side_geometry import SideGeometry

SIZES = ("bore", "rod")
"""Of a cylinder's lengths those that are no distances between pins."""
FAR = 1.5
"""Ratio of an answer to the typical one from which on it is named where something does not close."""


class Part(NamedTuple):
    """A part from the side: name, whether it was answered, and the points [m] of its line or outline."""

    name: str
    known: bool
    points: tuple[complex, ...]
    cylinder: bool = False


@dataclass(frozen=True)
class Sketch(SideGeometry):
    """A machine of a kind with the answers so far; whatever is not answered is typical, scaled."""

    _stale: set[str] = field(default_factory=set, init=False, compare=False)

    @cached_property
    def questions(self) -> tuple[Question, ...]:
        """All questions in order; typical answers follow from the answers before.

        An answer that no longer fits those before it counts as open.
        """
        asked = []
        for question in ask(self):
            try:
                self.values[question.key] = question.read(self.answers.get(question.key, TYPICAL))
            except AnswerError:
                self.values[question.key] = question.typical
                self._stale.add(question.key)
            asked.append(question)
        return tuple(asked)

    @property
    def open(self) -> Question | None:
        """The first question without an answer."""
        return next((question for question in self.questions
                     if question.key not in self.answers or question.key in self._stale), None)

    def answered(self, question: Question, text: str) -> Sketch:
        """With an answer.

        Raises:
            AnswerError: it cannot be read, or contradicts the answers before.
        """
        question.read(text)
        made = Sketch(self.kind, {**self.answers, question.key: text.strip()})
        prefix = question.key.rpartition(".")[0]
        try:
            if prefix.endswith("pin") and f"{prefix}.from_last" in made.answers:
                made.point(prefix)
        except OpenError as error:
            raise AnswerError(str(error)) from None
        for k, member in enumerate(made.members):
            if question.key.startswith(f"{member.name}_stroke.") or question.key == f"{member.name}.extends":
                end = question.key.rpartition(".")[2]
                try:
                    made.stroke_closes(k, end)
                except OpenError as error:
                    raise AnswerError(f"{error}{made._furthest(k, end)}") from None
        return made

    def _furthest(self, k: int, end: str) -> str:
        """Which of the answers that the cylinder of member k depends on is furthest from what is typical, if any is far
        from it, and whether it would close with that; begins with a semicolon."""
        member = self.members[k]
        owners = [f"{member.name}_stroke", *([member.cylinder.name] if member.cylinder else []),
                  *(member.linkage[:2] if member.linkage else [])]
        off = {question: max(answer / typical, typical / answer) for question in self.questions
               if question.unit == "m" and self.measured(question.key)
               and any(question.key.startswith(f"{owner}.") for owner in owners)
               and question.key.rpartition(".")[2] not in SIZES
               and min(answer := self.number(question.key), typical := float(question.typical)) > 0}
        if not off or max(off.values()) < FAR:
            return ""
        question = max(off, key=lambda each: off[each])
        found = (f"; of the answers that count here, {question.key} is the furthest from what is typical, "
                 f"{self.answers[question.key]} instead of {question.shown}")
        try:
            Sketch(self.kind, {**self.answers, question.key: TYPICAL}).stroke_closes(k, end)
        except OpenError:
            return found
        return f"{found}, with which it would close"

    def value(self, key: str) -> float | str:
        """A number in SI or a word, answered or typical."""
        if key not in self.values:  # while questions are made, those before it have values
            assert self.questions
        return self.values[key]

    def parts(self) -> Iterator[Part]:
        """Every part from the side, in mid-range, as far as it closes."""
        at, heading, outlines, others = 0j, 0.0, list[list[complex]](), list[Part]()
        for k, member in enumerate(self.members):
            if k == 0 and self.column:
                at = 1j * self.length(0)
                outlines.append([0j, at])
                continue
            angle, rocker = self._mid(k, heading)
            before = cmath.exp(1j * heading)
            base = at - (self.length(k - 1) * before if k else 0)
            heading += angle
            link = cmath.exp(1j * heading)
            outlines.append([at, at + self.length(k) * link])
            part = member.cylinder
            if part is not None and not math.isnan(rocker):
                foot = (base if member.linkage else at) + self.barrel(k, heading - angle) * before
                done = self.measured(f"{part.name}.bore")
                if member.linkage is None:
                    rod = at + self.point(f"{part.name}.rod_pin") * link
                    outlines[k].append(rod)
                else:
                    own = member.linkage
                    pivot = base + self.point(f"{own.rocker_name}.pin") * before
                    arm = cmath.exp(1j * rocker) * before
                    end = pivot + self.number(f"{own.rocker_name}.length") * arm
                    rod, pin = pivot + self.rocker_rod(own) * arm, at + self.point(f"{own.coupler_name}.pin") * link
                    others += [Part(own.rocker_name, done, (rod, pivot, end)),
                               Part(own.coupler_name, done, (end, pin))]
                    outlines[k].append(pin)
                    outlines[k - 1].append(pivot)
                if k and not part.on_ground:
                    outlines[k - 1].append(foot)
                others.append(Part(part.name, done, (foot, rod), cylinder=True))
            at += self.length(k) * link
        telescope = self.kind.telescope
        if telescope is not None and self.sections:
            others += self._sections(telescope.name, at, link)
        for member, outline in zip(self.members, outlines, strict=True):
            centre = sum(outline) / len(outline)
            around = sorted(outline, key=lambda point, centre=centre: cmath.phase(point - centre))  # type: ignore[misc]
            yield Part(member.name, self.measured(f"{member.name}.length"), (*around, around[0]))
        yield from others

    def _sections(self, name: str, at: complex, link: complex) -> Iterator[Part]:
        """The sections of a telescope, half extended, and their cylinder; `at` is the far end when it is retracted."""
        cylinder, end = f"{name}_cylinder", at
        for section in [name, f"{name}_second"][:self.sections]:
            begin, end = end, end + self.number(f"{section}.travel") / 2 * link
            yield Part(section, self.measured(f"{section}.travel"), (begin, end))
        pivot = at - self.length(len(self.members) - 1) * link
        foot = pivot + complex(*(self.number(f"{cylinder}.barrel_{way}") for way in ("forward", "up"))) * link
        extended = self.number(f"{name}_stroke.retracted") + self.number(f"{name}.travel") / 2
        yield Part(cylinder, self.measured(f"{cylinder}.bore"), (foot, foot + extended * link), cylinder=True)

    def _mid(self, k: int, heading: float) -> tuple[float, float]:
        """Angles of member k and its rocker in the middle; that of the rocker is NaN where something does not close."""
        member = self.members[k]
        try:
            if member.cylinder is None:
                return sum(self.limits(k)) / 2, math.nan
            return self.posture(k, sum(self.stroke(k)) / 2, heading if k else 0.0)
        except OpenError:
            return math.radians(sum(member.range) / 2), math.nan
