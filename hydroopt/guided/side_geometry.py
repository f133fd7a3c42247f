"""The plane geometry of a machine of which some numbers are answered and the rest typical."""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property

from hydroopt.guided.kinds import Kind, LinkagePart, Member
from hydroopt.guided.plane import OpenError, by_distances, near_to, turned
from hydroopt.guided.question import TYPICAL, Question

STEPS = 25
"""Positions over a stroke at which a linkage must close."""
MARGIN = math.radians(0.3)
"""Angle [rad] by which joint limits stay within what the stroke reaches."""
STOP = math.radians(4.0)
"""The same where the stops of a linkage limit a link."""


@dataclass(frozen=True)
class SideGeometry:
    """A machine of a kind with answers, texts by key, and the values [SI] of all questions asked so far."""

    kind: Kind
    answers: Mapping[str, str]
    values: dict[str, float | str] = field(default_factory=dict, init=False, compare=False)

    @cached_property
    def members(self) -> tuple[Member, ...]:
        """The moving links; of a counted kind as many as were asked for, the last one repeated."""
        typical = self.kind.members
        if not self.kind.counted:
            return typical
        count = int(float(self.answers.get("links") or 2))
        made = [typical[min(k, len(typical) - 1)] for k in range(count)]
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

    def tentative(self, key: str, typical: float) -> float:
        """An answered number that is a length, or its typical value."""
        text = self.answers.get(key, TYPICAL)
        value = Question(key, "", "m", typical, least=-1e3, most=1e3).read(text)
        return float(value)

    def length(self, k: int) -> float:
        """Length [m] of member k between its pins."""
        return self.tentative(f"{self.members[k].name}.length",
                            self.members[k].length * (self.scale(k - 1) if k else 1.0))

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
