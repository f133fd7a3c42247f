"""The machine file of a sketch: measured numbers with the tape's accuracy, all others as assumed, with comments."""

from __future__ import annotations

import math
from collections.abc import Iterator

from hydroopt.guided.kinds import CylinderPart, LinkagePart, Member, Telescope
from hydroopt.guided.sketch import Sketch

TAPE = 0.005
"""Standard deviation [m] of a distance between pin centres by a tape."""
GUESS = 0.05
"""Standard deviation of a typical length, as a part of it."""
PLAY = 0.002
"""Length [m] by which the limits of a telescope stay within the stroke of its cylinder."""
STEEL = 7850.0
"""Density [kg/m³]."""


def machine_text(sketch: Sketch) -> str:
    """The text of the machine file, which `hydroopt.read_machine` takes.

    Raises:
        OpenError: a triangle or a linkage does not close.
    """
    return "\n".join(_Writer(sketch).lines()) + "\n"


class _Writer:
    """Writes the parts of a sketch."""

    def __init__(self, sketch: Sketch) -> None:
        self.sketch, self.kind = sketch, sketch.kind
        self.assumed = f"assumed: typical of {'an' if self.kind.name[0] in 'aeiou' else 'a'} {self.kind.name}, scaled"
        self.column = sketch.column

    def lines(self) -> Iterator[str]:
        """All lines."""
        name = self.sketch.word("name")
        yield f"# {name}: written by 'hydroopt new', kind {self.kind.name}. Typical numbers: {self.kind.typical}."
        yield "# Replace what is assumed by what you know, and keep sigma honest: it is the standard deviation that the"
        yield "# estimators believe. Pins stand in the frame of their link: x from its first pin to its last, y up when"
        yield "# the link points forward, z sideways."
        yield f'name = "{name}"'
        yield 'description = "described by the guided start of hydroopt"'
        yield 'bandwidth = { value = "2 Hz", source = "assumed: what the valves of such a machine follow" }'
        if self.kind.slew:
            yield 'ground = { value = "0 m", source = "level ground" }'
        elif not self.column:
            yield "# The base frame lies in the plane of the machine: x forward, y up."
            yield 'orientation = ["90 deg", "0 deg", "0 deg"]'
        if self.kind.slew:
            yield from self._slew()
        for k, member in enumerate(self.sketch.members):
            yield from self._link(k, member)
        telescope = self.kind.telescope if self.sketch.sections else None
        if telescope is not None:
            yield from self._sections(telescope)
        for k, member in enumerate(self.sketch.members):
            if member.linkage is not None:
                yield from self._linkage(k, member, member.linkage)
        if self.kind.slew:
            yield from self._motor()
        for k, member in enumerate(self.sketch.members):
            yield from (self._drive(member) if member.cylinder is None else self._cylinder(k, member, member.cylinder))
        if telescope is not None:
            yield from self._telescope_cylinder(telescope)
        yield from self._sensors()

    def _slew(self) -> Iterator[str]:
        slew, size = self.kind.slew, self.sketch.number(f"{self.sketch.members[0].name}.length")
        mass = self.kind.slew_mass * (size / self.kind.members[0].length) ** 3
        yield from ("", "# Turns about the vertical; its far end is the first pin of the next link.", "[[links]]",
                    f'name = "{slew}"')
        yield (f"joint = {{ type = \"revolute\", d = {self._length(f'{slew}.height')}, "
               f"a = {self._length(f'{slew}.offset')}, alpha = \"90 deg\", lower = \"-180 deg\", upper = \"180 deg\", "
               f"{self._pace('30 deg/s', '30 deg/s^2')} }}")
        # a ring as high as its radius; a flat one is on the bound of what a body can have, and beyond it once rounded
        turning = mass * (0.25 * size) ** 2
        yield from self._body("links.body", mass, (-0.1 * size, 0.0, 0.1 * size), (
            turning * 7 / 12, turning * 7 / 12, turning), 0.2, 0.1 * size)

    def _link(self, k: int, member: Member) -> Iterator[str]:
        length = self.sketch.number(f"{member.name}.length")
        low, high = (math.degrees(limit) for limit in self.sketch.limits(k))
        by = "what its cylinder's stroke reaches" if member.cylinder else "stated"
        yield from ("", f"# {member.name}: from the {member.first} to the {member.last}; limits are {by}.", "[[links]]",
                    f'name = "{member.name}"')
        column = self.column and k == 0
        if self.sketch.sections and k + 1 == len(self.sketch.members):
            yield "# Its telescope slides along the z of its own frame, which lies along this link."
            far = 'alpha = "90 deg", beta = "90 deg"'
        else:
            far = (f"d = {self._length(f'{member.name}.length')}, alpha = \"90 deg\"" if column else
                   f"a = {self._length(f'{member.name}.length')}")
        yield (f'joint = {{ type = "revolute", {far}, lower = "{low:.2f} deg", upper = "{high:.2f} deg", '
               f"{self._pace('25 deg/s', '40 deg/s^2')} }}")
        yield from self._slender(member.name, length, (0.0, 0.0, -0.55 * length) if column else (
            0.45 * length, 0.05 * length, 0.0), upright=column)

    def _slender(self, name: str, length: float, com: tuple[float, float, float], *, upright: bool) -> Iterator[str]:
        """The body of a link or section, along z if `upright`, else along x."""
        mass, stated = self.sketch.number(f"{name}.mass"), self.sketch.measured(f"{name}.mass")
        slender, thick = mass * length**2 / 12, mass * (0.15 * length) ** 2 / 6
        yield from self._body("links.body", mass, com, (slender, slender, thick) if upright else (
            thick, slender, slender), 0.05 if stated else 0.3, 0.1 * length, measured=stated)

    def _sections(self, part: Telescope) -> Iterator[str]:
        """The sections of a telescope: z along the last link, x to what is y of it; each frame lies at its far end."""
        last, sketch = self.sketch.members[-1], self.sketch
        length = sketch.number(f"{last.name}.length")
        travel = sketch.number(f"{part.name}.travel")
        names = [part.name, f"{part.name}_second"][:sketch.sections]
        for name in names:
            first = name == part.name
            yield from ("", f"# {name}: slides out of the {last.name if first else part.name}; its frame lies where "
                        f"the {last.last} is with all retracted.", "[[links]]", f'name = "{name}"')
            far = self._length(f"{last.name}.length")
            yield (f'joint = {{ type = "prismatic", d = {far}, lower = "{PLAY:.4f} m", '
                   f'upper = "{travel - PLAY:.4f} m", {self._pace("0.3 m/s", "0.6 m/s^2")} }}' if first else
                   'joint = { type = "prismatic", dependent = true }')
            yield from self._slender(name, length, (0.0, 0.0, -0.5 * length), upright=True)
        if len(names) == 2:
            ratio = sketch.number(f"{names[1]}.travel") / travel
            yield from ("", "# A chain or a rope takes the second section along.", "[[couplings]]",
                        f'name = "{part.name}_chain"', f'joint = "{names[1]}"',
                        f"ratios = {{ {part.name} = {ratio:.6g} }}")

    def _telescope_cylinder(self, part: Telescope) -> Iterator[str]:
        """Along the last link: on it at its barrel, on the first section at its rod."""
        name, last, sketch = f"{part.name}_cylinder", self.sketch.members[-1], self.sketch
        travel, short = sketch.number(f"{part.name}.travel"), sketch.number(f"{part.name}_stroke.retracted")
        yield from self._piston(name, part.name, short, short + travel, 1, f"{part.name}.travel")
        forward, up, sigma, source = self._offset(name, "tape measure")
        yield from ("[cylinders.barrel]", f'link = "{last.name}"',
                    f"pin = {self._vector(complex(forward, up), sigma, source)}")
        bore, rod = sketch.number(f"{name}.bore"), sketch.number(f"{name}.rod")
        yield from self._barrel_body(bore, short, 1)
        along = forward + short - sketch.number(f"{last.name}.length")
        yield from ("[cylinders.rod]", f'link = "{part.name}"',
                    f'pin = {{ value = ["{up:.4f} m", "0 m", "{along:.4f} m"], sigma = "{1e3 * sigma:.0f} mm", '
                    f'source = "{source}: parallel to the {last.name}" }}')
        yield from self._rod_body(rod, travel, 1)

    def _linkage(self, k: int, member: Member, part: LinkagePart) -> Iterator[str]:
        stroke = self.sketch.stroke(k)
        angle, rocker = self.sketch.posture(k, sum(stroke) / 2, sum(self.sketch.limits(k - 1)) / 2)
        yield from ("", f"# The cylinder turns the {part.rocker_name}, which moves the {member.name} by the "
                    f"{part.coupler_name}.", "[[linkages]]", f'name = "{member.name}_linkage"',
                    f'moves = "{member.name}"',
                    "# one posture tells on which side the parts are assembled")
        yield (f'posture = {{ {member.name} = "{math.degrees(angle):.1f} deg", {part.rocker_name} = '
               f'"{math.degrees(rocker):.1f} deg" }}')
        for role, name in (("rocker", part.rocker_name), ("coupler", part.coupler_name)):
            length = self.sketch.number(f"{name}.length")
            yield f"[linkages.{role}]"
            if name != role:
                yield f'name = "{name}"'
            yield f"pin = {self._pin(f'{name}.pin')}"
            yield f"length = {self._length(f'{name}.length')}"
            mass = 180.0 * length**3
            yield from self._body(f"linkages.{role}.body", mass, (length / 2, 0.0, 0.0), (
                mass * length**2 / 120, mass * length**2 / 12, mass * length**2 / 12), 0.3, 0.1 * length)

    def _motor(self) -> Iterator[str]:
        ratio = (self.sketch.number(f"{self.sketch.members[0].name}.length") / 6.2) ** 3
        yield from ("", "# Torque per pressure difference: displacement per radian of the swing, by the plate.",
                    "[[motors]]", f'name = "{self.kind.slew}_motor"', f'joint = "{self.kind.slew}"',
                    f'torque_per_pressure = {{ value = "{6e-3 * ratio:.3g} N*m/Pa", source = "{self.assumed}" }}')
        yield (f'friction = {{ coulomb = {self._guess(3000 * ratio, "N*m", 1)}, '
               f'viscous = {self._guess(2000 * ratio, "N*m*s/rad", 2)} }}')

    def _cylinder(self, k: int, member: Member, part: CylinderPart) -> Iterator[str]:
        name, sketch = part.name, self.sketch
        short, long = sketch.stroke(k)
        bore, rod = sketch.number(f"{name}.bore"), sketch.number(f"{name}.rod")
        jacks = int(sketch.number(f"{name}.jacks"))
        yield from self._piston(name, member.name, short, long, jacks, f"{member.name}_stroke.extended")
        if part.on_ground:
            yield from ("[cylinders.barrel]", f'link = "{self.kind.slew or "base"}"',
                        f"pin = {self._ground_pin(name)}")
        else:
            yield from ("[cylinders.barrel]", f'link = "{sketch.members[k - 1].name}"',
                        f"pin = {self._pin(f'{name}.barrel_pin')}")
        yield from self._barrel_body(bore, short, jacks)
        if member.linkage is None:
            yield from ("[cylinders.rod]", f'link = "{member.name}"', f"pin = {self._pin(f'{name}.rod_pin')}")
        else:
            at = sketch.rocker_rod(member.linkage)
            yield from ("[cylinders.rod]", f'link = "{member.linkage.rocker_name}"',
                        f"pin = {self._vector(at, 2 * TAPE, self.assumed)}")
        yield from self._rod_body(rod, long - short, jacks)

    def _piston(self, name: str, moved: str, short: float, long: float, jacks: int, known: str) -> Iterator[str]:
        """A cylinder without its pins and bodies; its stroke is measured where the answer `known` is."""
        sketch = self.sketch
        head = jacks * math.pi / 4 * sketch.number(f"{name}.bore") ** 2
        yield from ("", "[[cylinders]]", f'name = "{name}"')
        if jacks > 1:
            yield f"jacks = {jacks}"
        for key, size in (("bore", "bore"), ("rod_diameter", "rod")):
            source = self._source("measured", f"{name}.{size}")
            yield f'{key} = {{ value = "{1e3 * sketch.number(f"{name}.{size}"):.1f} mm", source = "{source}" }}'
        yield "# pin to pin, fully retracted"
        yield f"dead_length = {self._length(f'{moved}_stroke.retracted')}"
        yield f'stroke = {{ value = "{long - short:.4f} m", source = "{self._source("tape measure", known)}" }}'
        yield f'relief_pressure = {{ value = "300 bar", source = "{self.assumed}" }}'
        yield (f'friction = {{ offset = {self._guess(0.0, "N", 1, 1.5e5 * head)}, '
               f'coulomb = {self._guess(2e5 * head, "N", 1)}, viscous = {self._guess(5e5 * head, "N*s/m", 2)} }}')

    def _barrel_body(self, bore: float, short: float, jacks: int) -> Iterator[str]:
        mass = 1.3 * STEEL * jacks * math.pi / 4 * (1.2**2 - 1) * bore**2 * short
        yield from self._rod_like("cylinders.barrel.body", mass, 0.45 * short, short, bore)

    def _rod_body(self, rod: float, stroke: float, jacks: int) -> Iterator[str]:
        mass = 1.2 * STEEL * jacks * math.pi / 4 * rod**2 * 1.1 * stroke
        yield from self._rod_like("cylinders.rod.body", mass, -0.5 * stroke, 1.1 * stroke, rod)

    def _drive(self, member: Member) -> Iterator[str]:
        torque = self.sketch.number(f"{member.name}.torque")
        source = self._source("stated", f"{member.name}.torque")
        yield from ("", "[[drives]]", f'name = "{member.name}_drive"', f'joint = "{member.name}"',
                    f'max_torque = {{ value = "{torque:.4g} N*m", source = "{source}" }}',
                    f'friction = {{ coulomb = {self._guess(0.03 * torque, "N*m", 1)}, '
                    f'viscous = {self._guess(0.03 * torque, "N*m*s/rad", 2)} }}')

    def _sensors(self) -> Iterator[str]:
        members = self.sketch.members
        joints = ([self.kind.slew] if self.kind.slew else []) + [member.name for member in members]
        chambers = [f"{self.kind.slew}_motor.{side}" for side in ("p_a", "p_b")] if self.kind.slew else []
        cylinders, part = [member.cylinder.name for member in members if member.cylinder], self.kind.telescope
        slides = [f"{part.name}.q"] if part is not None and self.sketch.sections else []
        if part is not None and slides:
            cylinders.append(f"{part.name}_cylinder")
        chambers += [f"{name}.{side}" for name in cylinders for side in ("p_head", "p_rod")]
        lengths = [f"{name}.length" for name in cylinders]
        torques = [f"{member.name}.tau" for member in members if member.cylinder is None]
        yield from ("", "# Accuracy is the largest error of a reading, either way; a log may hold fewer channels.")
        for channels, accuracy in (([f"{joint}.q" for joint in joints], "0.1 deg"), (chambers, "2 bar"),
                                   (slides, "2 mm"), (lengths, "2 mm"), (torques, "1 N*m")):
            if channels:
                yield from ("", "[[sensors]]", f"channels = [{', '.join(f'{chr(34)}{c}{chr(34)}' for c in channels)}]",
                            f'accuracy = {{ value = "{accuracy}", source = "assumed" }}', 'rate = "100 Hz"')

    def _rod_like(self, table: str, mass: float, along: float, length: float, width: float) -> Iterator[str]:
        yield from self._body(table, mass, (along, 0.0, 0.0), (
            mass * width**2 / 8, mass * length**2 / 12, mass * length**2 / 12), 0.3, 0.1 * length)

    def _body(self, table: str, mass: float, com: tuple[float, float, float], inertia: tuple[float, float, float],
              sigma: float, com_sigma: float, *, measured: bool = False) -> Iterator[str]:
        x, y, z = inertia
        yield f"[{table}]"
        yield (f'm = {{ value = "{mass:.4g} kg", sigma = "{100 * sigma:.0f} %", '
               f'source = "{"stated" if measured else self.assumed}" }}')
        yield (f'com = {{ value = ["{com[0]:.4f} m", "{com[1]:.4f} m", "{com[2]:.4f} m"], sigma = "{com_sigma:.3f} m", '
               f'source = "assumed" }}')
        zero = '"0 kg*m^2"'
        yield (f'inertia_com = {{ value = ["{x:.5g} kg*m^2", {zero}, {zero}, "{y:.5g} kg*m^2", {zero}, '
               f'"{z:.5g} kg*m^2"], sigma = "30 %", source = "assumed: a slender body" }}')

    def _pace(self, speed: str, acceleration: str) -> str:
        return (f'max_speed = {{ value = "{speed}", source = "assumed" }}, '
                f'max_acceleration = {{ value = "{acceleration}", source = "assumed" }}')

    def _source(self, measured: str, *keys: str) -> str:
        """Where numbers are from: measured if all were answered."""
        return measured if self.sketch.measured(*keys) else self.assumed

    def _guess(self, value: float, unit: str, spread: float, sigma: float | None = None) -> str:
        size = sigma if sigma is not None else spread * value
        return f'{{ value = "{value:.4g} {unit}", sigma = "{size:.4g} {unit}", source = "{self.assumed}" }}'

    def _length(self, key: str) -> str:
        value, source = self.sketch.number(key), self._source("tape measure", key)
        sigma = TAPE if self.sketch.measured(key) else max(TAPE, GUESS * abs(value))
        return f'{{ value = "{value:.4f} m", sigma = "{1e3 * sigma:.0f} mm", source = "{source}" }}'

    def _pin(self, key: str) -> str:
        """A pin from two distances: their errors grow as the angle between them gets flat."""
        point = self.sketch.point(key)
        near, far = self.sketch.number(f"{key}.from_first"), self.sketch.number(f"{key}.from_last")
        if not self.sketch.measured(f"{key}.from_first", f"{key}.from_last"):
            return self._vector(point, max(2 * TAPE, GUESS * abs(point)), self.assumed)
        length = abs(point.real) + math.sqrt(max(far**2 - point.imag**2, 0.0))
        sine = abs(point.imag) * length / (near * far) if near * far else 0.0
        return self._vector(point, TAPE / max(0.2, min(1.0, sine)), "tape measure, from both ends of the link")

    def _offset(self, name: str, measured: str) -> tuple[float, float, float, str]:
        """How far in front of a link's first pin and above it a barrel is pinned, standard deviation, and source."""
        keys = [f"{name}.barrel_{way}" for way in ("forward", "up")]
        forward, up = map(self.sketch.number, keys)
        sigma = 2 * TAPE if self.sketch.measured(*keys) else max(2 * TAPE, GUESS * math.hypot(forward, up))
        return forward, up, sigma, self._source(measured, *keys)

    def _ground_pin(self, name: str) -> str:
        forward, up, sigma, source = self._offset(name, "tape measure and plumb line")
        if not self.kind.slew:
            return self._vector(complex(forward, up), sigma, source)
        offset = self.sketch.number(f"{self.kind.slew}.offset")
        return (f'{{ value = ["{offset + forward:.4f} m", "0 m", "{up:.4f} m"], sigma = "{1e3 * sigma:.0f} mm", '
                f'source = "{source}" }}')

    @staticmethod
    def _vector(point: complex, sigma: float, source: str) -> str:
        return (f'{{ value = ["{point.real:.4f} m", "{point.imag:.4f} m", "0 m"], sigma = "{1e3 * sigma:.0f} mm", '
                f'source = "{source}" }}')
