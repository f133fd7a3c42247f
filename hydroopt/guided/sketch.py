"""A machine of a kind with the answers so far, typical numbers for the rest, and what is still to be asked."""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property

from hydroopt.guided.kinds import CylinderPart, Kind, LinkagePart, Member, Telescope
from hydroopt.guided.plane import OpenError, by_distances, near_to, turned
from hydroopt.guided.question import TYPICAL, AnswerError, Question

STEPS = 25
"""Positions over a stroke at which a linkage must close."""
MARGIN = math.radians(0.3)
"""Angle [rad] by which joint limits stay within what the stroke reaches."""
STOP = math.radians(4.0)
"""The same where the stops of a linkage limit a link."""
STRAIGHT = 0.03
"""How near to 0 the sine of an angle between lever and cylinder may come, at which the cylinder has no lever arm."""
SIZES = ("bore", "rod")
"""Of a cylinder's lengths those that are no distances between pins."""
FAR = 1.5
"""Ratio of an answer to the typical one from which on it is named where something does not close."""


@dataclass(frozen=True)
class Sketch:
    """A machine of a kind with answers, texts by key; whatever is not answered is typical, scaled.

    `values` [SI] are those of all questions asked so far.
    """

    kind: Kind
    answers: Mapping[str, str]
    values: dict[str, float | str] = field(default_factory=dict, init=False, compare=False)
    _stale: set[str] = field(default_factory=set, init=False, compare=False)

    @cached_property
    def questions(self) -> tuple[Question, ...]:
        """All questions in order; typical answers follow from the answers before.

        An answer that no longer fits those before it counts as open.
        """
        asked = []
        for question in _Interview(self).questions():
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

    @cached_property
    def members(self) -> tuple[Member, ...]:
        """The moving links; of a counted kind as many as were asked for, the last one repeated."""
        typical = self.kind.members
        if not self.kind.counted:
            return typical
        made = [typical[min(k, len(typical) - 1)] for k in range(int(self.number("links")))]
        return tuple(self._numbered(each, k + 1) for k, each in enumerate(made))

    def _numbered(self, member: Member, k: int) -> Member:
        name = f"{self.kind.members[0].name.rstrip('1')}{k}"
        part = member.cylinder and member.cylinder._replace(name=f"{name}_cylinder")
        return member._replace(name=name, cylinder=part)

    def measured(self, *keys: str) -> bool:
        """Whether all of these were answered by numbers, not by taking what is typical."""
        return all(self.answers.get(key, TYPICAL) != TYPICAL for key in keys)

    def number(self, key: str) -> float:
        """A number in SI, answered or typical."""
        value = self.value(key)
        assert isinstance(value, float | int)
        return float(value)

    def word(self, key: str) -> str:
        """A word, answered or typical."""
        return str(self.value(key))

    def value(self, key: str) -> float | str:
        """A number in SI or a word, answered or typical."""
        if key not in self.values:  # while questions are made, those before it have values
            assert self.questions
        return self.values[key]

    @property
    def column(self) -> bool:
        """Whether the first link of an arm turns about the vertical."""
        first = self.members[0]
        return first.cylinder is None and self.word(f"{first.name}.axis") == "swing"

    @property
    def sections(self) -> int:
        """How many sections slide out of the last link."""
        part = self.kind.telescope
        return 0 if part is None else int(self.number(f"{part.name}.sections"))

    def length(self, k: int) -> float:
        """Length [m] of member k between its pins."""
        return self.number(f"{self.members[k].name}.length")

    def scale(self, k: int) -> float:
        """How much longer member k is than the typical one."""
        return self.length(k) / self.members[k].length

    def point(self, key: str) -> complex:
        """A pin on its link, from its distances to that link's ends.

        Raises:
            OpenError: no point has these distances.
        """
        k = next(k for k, part in self._pins() if part == key)
        side = 1.0 if self.word(f"{key}.side") == "above" else -1.0
        return by_distances(self.number(f"{key}.from_first"), self.number(f"{key}.from_last"), self.length(k), side)

    def _pins(self) -> Iterator[tuple[int, str]]:
        """Keys of pins with the number of the link that they are on."""
        for k, member in enumerate(self.members):
            if member.linkage is not None:
                yield k - 1, f"{member.linkage.rocker_name}.pin"
                yield k, f"{member.linkage.coupler_name}.pin"
            if member.cylinder is not None:
                yield k - 1, f"{member.cylinder.name}.barrel_pin"
                yield k, f"{member.cylinder.name}.rod_pin"

    def barrel(self, k: int, before: float) -> complex:
        """The barrel's pin relative to the first pin of member k (or of the rocker that moves it), in the line of the
        link before, which stands at an angle `before` where the barrel is on the ground."""
        part = self.members[k].cylinder
        assert part is not None
        if part.on_ground:
            pin = complex(self.number(f"{part.name}.barrel_forward"), self.number(f"{part.name}.barrel_up"))
            return pin * cmath.exp(-1j * before) if k else pin
        return self.point(f"{part.name}.barrel_pin") - (0 if self.members[k].linkage else self.length(k - 1))

    def rocker_rod(self, part: LinkagePart) -> complex:
        """The rod's pin on the rocker, in the rocker's line."""
        rocker = self.number(f"{part.rocker_name}.length")
        if part.rod == part.rocker:
            return complex(rocker)
        return by_distances(self.number(f"{part.rocker_name}.rod_from_pivot"),
                            self.number(f"{part.rocker_name}.rod_from_{part.coupler_name}"), rocker,
                            1.0 if part.rod.imag >= 0 else -1.0)

    def posture(self, k: int, length: float, before: float = 0.0) -> tuple[float, float]:
        """Angles of member k and of its rocker (0 without) at a length of its cylinder.

        Raises:
            OpenError: something does not close.
        """
        member = self.members[k]
        middle = math.radians(sum(member.range) / 2)
        if member.linkage is None:
            part = member.cylinder
            assert part is not None
            sign = 1.0 if self.word(f"{member.name}.extends") == "up" else -1.0
            angle = turned(self.barrel(k, before), self.point(f"{part.name}.rod_pin"), length, sign)
            return near_to(angle, middle), 0.0
        part_of = member.linkage
        pivot = self.point(f"{part_of.rocker_name}.pin")
        try:
            rocker = turned(self.barrel(k, before) - pivot, self.rocker_rod(part_of), length, part_of.turns)
        except OpenError as error:
            raise OpenError(f"{error}; those are the distances of the cylinder's two pins from the pivot of the "
                            f"{part_of.rocker_name}") from None
        end = pivot + self.number(f"{part_of.rocker_name}.length") * cmath.exp(1j * rocker) - self.length(k - 1)
        try:
            angle = turned(end, self.point(f"{part_of.coupler_name}.pin"),
                           self.number(f"{part_of.coupler_name}.length"), part_of.branch)
        except OpenError as error:
            raise OpenError(f"the {part_of.coupler_name} of {error}; those are the distances of its two pins from the "
                            f"{member.first}, the {part_of.rocker_name} standing as the cylinder holds it") from None
        return near_to(angle, middle), near_to(rocker, 0.0)

    def _lift_angles(self, k: int) -> tuple[float, ...]:
        """Angles of the link before at which a barrel on the ground must reach: its limits and between them."""
        part = self.members[k].cylinder
        if part is None or not part.on_ground or k == 0:
            return (0.0,)
        low, high = self.limits(k - 1)
        return tuple(low + (high - low) * step / 8 for step in range(9))

    def stroke_closes(self, k: int, end: str = "extended") -> None:
        """Check that the cylinder of member k closes its triangle and linkage over its stroke.

        Raises:
            OpenError: where it does not, with the length.
        """
        lengths, lifts = self.stroke(k), self._lift_angles(k)
        if len(lifts) > 1:
            self.limits(k)
            return
        for before in lifts:
            for step in range(STEPS if end != "retracted" else 1):
                length = lengths[0] + (lengths[1] - lengths[0]) * step / (STEPS - 1)
                try:
                    self.posture(k, length, before)
                except OpenError as error:
                    member = self.members[k]
                    raise OpenError(f"{error}; those are the distances of its two pins from the {member.first}"
                                    if member.linkage is None else
                                    f"with the cylinder at {1e3 * length:.0f} mm: {error}") from None

    def stroke(self, k: int) -> tuple[float, float]:
        """Lengths pin to pin of the cylinder of member k, retracted and extended."""
        name = f"{self.members[k].name}_stroke"
        return self.number(f"{name}.retracted"), self.number(f"{name}.extended")

    def limits(self, k: int) -> tuple[float, float]:
        """Joint limits [rad] of member k that its stroke reaches, whatever the link before does.

        Raises:
            OpenError: a triangle does not close, or there is no such range.
        """
        member = self.members[k]
        if member.cylinder is None:
            return self.number(f"{member.name}.lower"), self.number(f"{member.name}.upper")
        ranges = [self._reached(k, before) for before in self._lift_angles(k)]
        margin = MARGIN if len(ranges) == 1 else STOP
        low, high = max(each[0] for each in ranges) + margin, min(each[1] for each in ranges) - margin
        if low >= high:
            raise OpenError(f"the stroke of {member.cylinder.name} moves the {member.name} by nothing in all positions "
                            f"of the {self.members[k - 1].name}")
        return low, high

    def _reached(self, k: int, before: float) -> tuple[float, float]:
        """Least and greatest angle [rad] of member k over its stroke, the link before at an angle.

        A cylinder that stands on the ground meets the stops of its linkage where the link before stands far up or
        down: there the range ends where the linkage does not close.
        """
        short, long = self.stroke(k)
        if self.members[k].linkage is None or not k or len(self._lift_angles(k)) == 1:
            low, high = sorted(self.posture(k, length, before)[0] for length in (short, long))
            return low, high
        stretches: list[list[float]] = [[]]
        for step in range(STEPS):
            try:
                stretches[-1].append(self.posture(k, short + (long - short) * step / (STEPS - 1), before)[0])
            except OpenError as error:
                reason = error
                stretches.append([])
        longest = max(stretches, key=len)
        if len(longest) < 2:
            raise OpenError(f"with the {self.members[k - 1].name} at {math.degrees(before):.0f} deg: {reason}")
        return min(longest), max(longest)


class _Interview:
    """What is asked of a sketch, in which order; each typical answer follows from the answers to those before."""

    def __init__(self, sketch: Sketch) -> None:
        self.sketch = sketch

    def questions(self) -> Iterator[Question]:
        """All questions in order."""
        kind = self.sketch.kind
        yield Question("name", "What is the machine called? (letters, digits, _)", "", f"my_{kind.name}")
        if kind.counted:
            yield Question("links", "How many moving links are there?", "1", 2.0, least=1, most=7)
        first = self.sketch.members[0]
        if kind.slew:
            yield Question(f"{kind.slew}.height", f"How high is the {first.first} above the ground?", "m",
                           kind.slew_height, "vertically, the machine on level ground", least=-5, most=30)
            yield Question(f"{kind.slew}.offset", f"How far in front of the swing's axis is the {first.first}?", "m",
                           0.0, "0 mm if unknown; behind counts negative", least=-5, most=5)
        for k, member in enumerate(self.sketch.members):
            yield from self._member(k, member)
        if kind.telescope is not None:
            yield from self._telescope(kind.telescope)

    def _member(self, k: int, member: Member) -> Iterator[Question]:
        slides = self.sketch.kind.telescope is not None and k + 1 == len(self.sketch.members)
        yield Question(f"{member.name}.length", f"{member.name}: from the {member.first} to the {member.last}?", "m",
                       member.length * (self.sketch.scale(k - 1) if k else 1.0), "tape from pin centre to pin centre"
                       + ", a telescope fully retracted" * slides, least=0.02, most=60)
        if member.cylinder is None:
            yield from self._axis(k, member)
        else:
            if member.linkage is not None:
                yield from self._linkage(k, member, member.linkage)
            yield from self._cylinder(k, member, member.cylinder)
        yield Question(f"{member.name}.mass", f"{member.name}: mass without its cylinder?", "kg",
                       member.mass * self.sketch.scale(k) ** 3, "from the maker's sheet or a scale", least=0.01,
                       most=2e5)

    def _axis(self, k: int, member: Member) -> Iterator[Question]:
        if k == 0:
            yield Question(f"{member.name}.axis", f"{member.name}: does it turn about the vertical (swing) or in the "
                           "vertical plane (tilt)?", "", "swing", choices=("swing", "tilt"))
        yield Question(f"{member.name}.lower", f"{member.name}: lowest angle?", "rad", math.radians(member.range[0]),
                       "to the link before; upwards counts positive", least=-7, most=7)
        yield Question(f"{member.name}.upper", f"{member.name}: highest angle?", "rad", math.radians(member.range[1]),
                       least=-7, most=7)
        yield Question(f"{member.name}.torque", f"{member.name}: largest torque of its drive?", "N*m",
                       member.torque * self.sketch.scale(k) ** 3, "from the maker's sheet", least=1e-3, most=1e7)

    def _linkage(self, k: int, member: Member, part: LinkagePart) -> Iterator[Question]:
        before, scale = self.sketch.members[k - 1], self.sketch.scale(k - 1)
        rocker, coupler = part.rocker_name, part.coupler_name
        yield from self._pin(f"{rocker}.pin", f"{rocker}: its pivot on the {before.name}", k - 1, part.pin)
        yield Question(f"{rocker}.length", f"{rocker}: from its pivot to its pin with the {coupler}?", "m",
                       scale * part.rocker, "pin centre to pin centre; where the rod is pinned to the "
                       f"{member.name} itself there is none: begin with --kind empty", least=0.01, most=20)
        if part.rod != part.rocker:
            yield Question(f"{rocker}.rod_from_pivot", f"{rocker}: from its pivot to its pin with the cylinder?", "m",
                           scale * abs(part.rod), least=0.01, most=20)
            yield Question(f"{rocker}.rod_from_{coupler}", f"{rocker}: from its pin with the {coupler} to its pin with "
                           "the cylinder?", "m", scale * abs(part.rod - part.rocker), least=0.01, most=40)
        yield Question(f"{coupler}.length", f"{coupler}: from the {rocker} to the {member.name}, pin to pin?", "m",
                       scale * part.coupler, least=0.01, most=20)
        yield from self._pin(f"{coupler}.pin", f"{coupler}: its pin on the {member.name}", k, part.coupler_pin)

    def _cylinder(self, k: int, member: Member, part: CylinderPart) -> Iterator[Question]:
        name = part.name
        if part.on_ground:
            scale, where = self.sketch.scale(0), self.sketch.members[0].first
            text = f"{name}: its pin on the {self.sketch.kind.slew or 'frame'}"
            yield Question(f"{name}.barrel_forward", f"{text}: how far in front of the {where}?", "m",
                           scale * part.barrel.real, "horizontally; behind counts negative", least=-30, most=30)
            yield Question(f"{name}.barrel_up", f"{text}: how far above the {where}?", "m", scale * part.barrel.imag,
                           "vertically; below counts negative", least=-30, most=30)
        else:
            before = self.sketch.members[k - 1].name
            yield from self._pin(f"{name}.barrel_pin", f"{name}: its pin on the {before}", k - 1, part.barrel)
        if member.linkage is None:
            yield from self._pin(f"{name}.rod_pin", f"{name}: its pin on the {member.name}", k, part.rod_pin)
            yield Question(f"{member.name}.extends", f"{name}: when it extends, does the {member.name} turn up or "
                           "down?", "", "up" if part.extends > 0 else "down", choices=("up", "down"))
        retracted, extended = self._typical_stroke(k)
        stroke = f"{member.name}_stroke"
        yield Question(f"{stroke}.retracted", f"{name}: pin to pin, fully retracted?", "m", retracted, least=0.02,
                       most=40)
        short = self.sketch.number(f"{stroke}.retracted")
        yield Question(f"{stroke}.extended", f"{name}: pin to pin, fully extended?", "m",
                       extended if extended > 1.05 * short else 1.5 * short, least=1.01 * short, most=2 * short)
        scale = self.sketch.scale(k)
        yield Question(f"{name}.bore", f"{name}: bore?", "m", _round(scale * part.bore), "inner diameter of the barrel",
                       least=0.005, most=2)
        bore = self.sketch.number(f"{name}.bore")
        yield Question(f"{name}.rod", f"{name}: diameter of the rod?", "m", _round(bore * part.rod / part.bore),
                       least=0.1 * bore, most=0.98 * bore)
        yield Question(f"{name}.jacks", f"{name}: how many equal cylinders side by side?", "1", float(part.jacks),
                       least=1, most=8)

    def _telescope(self, part: Telescope) -> Iterator[Question]:
        """Sections that slide out of the last link, the first by a cylinder, the second as the first takes it along."""
        link, length, name = self.sketch.members[-1], self.sketch.length(len(self.sketch.members) - 1), part.name
        yield Question(f"{name}.sections", f"{name}: how many sections slide out of the {link.name}?", "1", 0.0,
                       "0 without a telescope; 2 where a chain or a rope takes a second one along with the first",
                       least=0, most=2)
        if not self.sketch.sections:
            return
        travel = part.travel * length
        yield Question(f"{name}.travel", f"{name}: how far does the first section slide out?", "m", travel,
                       f"from fully retracted to fully extended, measured at the {link.last}", least=0.02, most=30)
        travel = self.sketch.number(f"{name}.travel")
        if self.sketch.sections == 2:
            yield Question(f"{name}_second.travel", f"{name}_second: how far does it slide out of the first one "
                           "meanwhile?", "m", travel, "a chain takes it just as far", least=0.02, most=30)
        cylinder = f"{name}_cylinder"
        text = f"{cylinder}: its pin on the {link.name}"
        yield Question(f"{cylinder}.barrel_forward", f"{text}: how far in front of the {link.first}?", "m",
                       length * part.barrel.real, f"along the {link.name}; behind counts negative", least=-30, most=30)
        yield Question(f"{cylinder}.barrel_up", f"{text}: how far above its line?", "m", length * part.barrel.imag,
                       f"from the {link.first} to the {link.last}; below counts negative", least=-10, most=10)
        yield Question(f"{name}_stroke.retracted", f"{cylinder}: pin to pin, fully retracted?", "m",
                       max(length * part.retracted, 1.15 * travel), "longer than its stroke", least=travel, most=40)
        for size, word, typical in ((part.bore, "bore", "bore"), (part.rod, "rod", "diameter of the rod")):
            yield Question(f"{cylinder}.{word}", f"{cylinder}: {typical}?", "m", _round(length * size), least=0.005,
                           most=2)
        for section in [name, f"{name}_second"][:self.sketch.sections]:
            yield Question(f"{section}.mass", f"{section}: mass without its cylinder?", "kg",
                           part.mass * (length / 2) ** 3, "from the maker's sheet or a scale", least=0.01, most=2e5)

    def _pin(self, key: str, text: str, k: int, typical: complex) -> Iterator[Question]:
        """A pin on member k by its distances to that link's two ends, and on which side of the line it lies."""
        member, length = self.sketch.members[k], self.sketch.length(k)
        scaled = typical * self.sketch.scale(k)
        yield Question(f"{key}.from_first", f"{text}: from the {member.first}?", "m", abs(scaled),
                       "tape from pin centre to pin centre", least=1e-3, most=60)
        near = self.sketch.number(f"{key}.from_first")
        typical_far = abs(scaled / abs(scaled) * near - length) if scaled else abs(length - near)
        yield Question(f"{key}.from_last", f"{text}: from the {member.last}?", "m", typical_far,
                       "tape from pin centre to pin centre", least=0.0, most=120)
        yield Question(f"{key}.side", f"{text}: above or below the line between these two?", "",
                       "above" if typical.imag >= 0 else "below", f"the {member.name} held level, pointing forward",
                       choices=("above", "below"))

    def _typical_stroke(self, k: int) -> tuple[float, float]:
        """Lengths of the cylinder at the typical joint limits with the pins so far; where they do not close, scaled."""
        member, scale = self.sketch.members[k], self.sketch.scale(k)
        part = member.cylinder
        assert part is not None
        try:
            if member.linkage is None:
                barrel, rod = self.sketch.barrel(k, 0.0), self.sketch.point(f"{part.name}.rod_pin")
                sign = 1.0 if self.sketch.word(f"{member.name}.extends") == "up" else -1.0
                angles = [math.radians(limit) for limit in member.range]
                sines = [sign * math.sin(q + cmath.phase(rod) - cmath.phase(barrel)) for q in angles]
                if min(sines) > STRAIGHT:
                    short, long = sorted(abs(barrel - rod * cmath.exp(1j * q)) for q in angles)
                    return short, min(long, 1.9 * short)
            pin = 0 if member.linkage is None else self.sketch.point(f"{member.linkage.rocker_name}.pin")
            arm = abs(self.sketch.point(f"{part.name}.rod_pin") if member.linkage is None
                      else self.sketch.rocker_rod(member.linkage))
            reach = abs(self.sketch.barrel(k, 0.0) - pin)
        except OpenError:
            return 1.0 * scale, 1.6 * scale
        if part.lengths is not None:
            made = (self.sketch.scale(k - 1) * part.lengths[0], self.sketch.scale(k - 1) * part.lengths[1])
            if part.on_ground or all(self._closes(k, length) for length in made):
                return made
        least, most = abs(reach - arm), reach + arm
        return least + 0.25 * (most - least), least + 0.75 * (most - least)

    def _closes(self, k: int, length: float) -> bool:
        try:
            self.sketch.posture(k, length)
        except OpenError:
            return False
        return True


def _round(length: float) -> float:
    """To 5 mm, as pistons and rods are made."""
    return max(0.005, 0.005 * round(length / 0.005))
