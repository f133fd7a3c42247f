"""What a guided start asks, in which order, and what it takes as typical: scaled from a typical machine of the kind."""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

from hydroopt.guided.kinds import CylinderPart, LinkagePart, Member, Telescope
from hydroopt.guided.plane import OpenError
from hydroopt.guided.question import Question

if TYPE_CHECKING:
    from hydroopt.guided.sketch import Sketch

STRAIGHT = 0.03
"""How near to 0 the sine of an angle between lever and cylinder may come, at which the cylinder has no lever arm."""


def ask(sketch: Sketch) -> Iterator[Question]:
    """All questions about a sketch in order; each typical answer follows from the answers to those before."""
    return _Interview(sketch).questions()


class _Interview:
    """The questions of one sketch."""

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
