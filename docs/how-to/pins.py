"""Draw docs/how-to/pins.svg, where pins stand, from docs/how-to/crane.toml: ``python docs/how-to/pins.py``."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from hydroopt import load_machine
from hydroopt.machine.geometry import Geometry

FOLDER = Path(__file__).parent
POSTURE = {"lift": math.radians(38), "jib": math.radians(-62)}
SCALE, LEFT, TOP, WIDTH, HEIGHT = 158.0, 150.0, 395.0, 900, 720
INK, GREY, BLUE, ORANGE, STEEL = "#1f2933", "#64707d", "#0072b2", "#c2500a", "#c9d2db"
"""The picture has a ground of its own, so that it can be read on any page."""


def at(point: np.ndarray) -> tuple[float, float]:
    """Place in the picture of a point [m] in the plane of the crane."""
    return LEFT + SCALE * float(point[0]), TOP - SCALE * float(point[1])


class Drawing:
    """Lines of an SVG file."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def path(self, points: list[np.ndarray], colour: str, width: float, more: str = "") -> None:
        """A line through points [m]."""
        text = " ".join(f"{x:.1f},{y:.1f}" for x, y in map(at, points))
        self.lines.append(f'<polyline points="{text}" fill="none" stroke="{colour}" stroke-width="{width}" '
                          f'stroke-linecap="round" stroke-linejoin="round" {more}/>')

    def dot(self, point: np.ndarray, radius: float, fill: str, stroke: str = "#ffffff") -> None:
        """A disc at a point [m]."""
        x, y = at(point)
        self.lines.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius}" fill="{fill}" stroke="{stroke}" '
                          'stroke-width="1.5"/>')

    def text(self, x: float, y: float, text: str, colour: str = INK, more: str = "") -> None:
        """A line of text at a place of the picture."""
        self.lines.append(f'<text x="{x:.1f}" y="{y:.1f}" fill="{colour}" {more}>{text}</text>')

    def beside(self, point: np.ndarray, dx: float, dy: float, text: str, colour: str = INK, more: str = "") -> None:
        """A line of text beside a point [m]."""
        x, y = at(point)
        self.text(x + dx, y + dy, text, colour, more)

    def frame(self, origin: np.ndarray, x: np.ndarray, y: np.ndarray, name: str, dx: float, dy: float) -> None:
        """Axes of a frame, with z towards the reader."""
        for axis, letter in ((x, "x"), (y, "y")):
            end = origin + 0.42 * axis
            self.path([origin, end], BLUE, 2.4, 'marker-end="url(#tip)"')
            self.beside(origin + 0.52 * axis, -4, 5, letter, BLUE, 'font-style="italic"')
        self.dot(origin, 6, "#ffffff", BLUE)
        self.dot(origin, 2, BLUE, BLUE)
        self.beside(origin, dx, dy, name, BLUE, 'font-weight="bold"')

    def pin(self, origin: np.ndarray, x: np.ndarray, y: np.ndarray, local: tuple[float, float], text: str, dx: float,
            dy: float) -> None:
        """A pin with its coordinates, as steps along x and then y of its frame."""
        foot, place = origin + local[0] * x, origin + local[0] * x + local[1] * y
        self.path([origin, foot, place], ORANGE, 1.6, 'stroke-dasharray="5 4"')
        self.dot(place, 6, ORANGE)
        self.beside(place, dx, dy, text, ORANGE)


def drawing() -> str:
    """The picture as an SVG file."""
    machine = load_machine(FOLDER / "crane.toml")
    geometry, made = Geometry(machine), Drawing()
    frames = {"base": (np.zeros(3), np.eye(3))}
    for link in ("lift", "jib"):
        pose = geometry.relative_pose("base", link, POSTURE)
        frames[link] = np.array(pose.origin, dtype=float).ravel(), np.array(pose.rotation, dtype=float)
    tip = frames["jib"][0] + machine.link("jib").joint.a * frames["jib"][1][:, 0]

    column = [np.array([x, y, 0.0]) for x, y in ((-0.16, -1.4), (-0.16, 0.0), (0.16, 0.0), (0.16, -0.85), (0.5, -1.15),
                                                 (0.5, -1.4))]
    made.path([*column, column[0]], STEEL, 3, f'style="fill:{STEEL};fill-opacity:.45"')
    made.path([frames["lift"][0], frames["jib"][0]], STEEL, 24)
    made.path([frames["jib"][0], tip], STEEL, 18)
    for cylinder in machine.cylinders:
        ends = []
        for attachment in (cylinder.barrel, cylinder.rod):
            origin, axes = frames[attachment.link]
            ends.append(origin + axes @ np.array(attachment.pin, dtype=float))
        middle = ends[0] + 0.56 * (ends[1] - ends[0])
        made.path(ends, GREY, 4)
        made.path([ends[0], middle], GREY, 12)
    pins = {"lift_cylinder": (("barrel, in the base frame", 16, 26), ("rod, in P of lift", 56, 34)),
            "jib_cylinder": (("barrel, in P of lift", -226, -4), ("rod, in P of jib", 14, -10))}
    for cylinder in machine.cylinders:
        for attachment, (words, dx, dy) in zip((cylinder.barrel, cylinder.rod), pins[cylinder.name], strict=True):
            origin, axes = frames[attachment.link]
            x, y = (float(value) for value in attachment.pin[:2])
            made.pin(origin, axes[:, 0], axes[:, 1], (x, y), f"({x:.2f}, {y:.2f}) {words}".replace("-", "−"), dx,
                     dy)
    made.frame(*_axes(frames["base"]), "", 0, 0)
    made.beside(frames["base"][0], -118, -14, "base frame", BLUE, 'font-weight="bold"')
    made.frame(*_axes(frames["lift"]), "", 0, 0)
    made.beside(frames["lift"][0], -118, -62, "P of lift", BLUE, 'font-weight="bold"')
    made.frame(*_axes(frames["jib"]), "P of jib", 34, -18)
    made.dot(tip, 6, INK)
    made.beside(tip, -14, -18, "far end of jib")
    _dimension(made, frames["lift"], machine.link("lift").joint.a, "a of lift", -0.42)
    _dimension(made, frames["jib"], machine.link("jib").joint.a, "a of jib", -0.28)
    _chain(made)
    body = "\n".join(made.lines)
    return f"""<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" role="img" \
font-family="system-ui, 'DejaVu Sans', Arial, sans-serif" font-size="15">
<title>Where pins stand: a crane with two joints, its frames, and the pins of its cylinders in them</title>
<defs><marker id="tip" viewBox="0 0 10 10" refX="7" refY="5" markerWidth="5" markerHeight="5" orient="auto">\
<path d="M0,0 L10,5 L0,10 z" fill="{BLUE}"/></marker></defs>
<rect x="1" y="1" width="{WIDTH - 2}" height="{HEIGHT - 2}" rx="12" fill="#ffffff" stroke="#c9d2db"/>
{body}
</svg>
"""


def _axes(frame: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    origin, axes = frame
    return origin, axes[:, 0], axes[:, 1]


def _dimension(made: Drawing, frame: tuple[np.ndarray, np.ndarray], length: float, text: str, aside: float) -> None:
    """A length along x of a frame, drawn beside the link."""
    origin, axes = frame
    ends = [origin + step * axes[:, 0] + aside * axes[:, 1] for step in (0.0, length)]
    for step, end in zip((0.0, length), ends, strict=True):
        made.path([origin + step * axes[:, 0], end + 0.06 * np.sign(aside) * axes[:, 1]], GREY, 0.8)
    made.path(ends, GREY, 1.2)
    x, y = at(0.36 * ends[0] + 0.64 * ends[1])
    angle = -math.degrees(math.atan2(axes[1, 0], axes[0, 0]))
    made.text(0, 16 if aside < 0 else -7, f"{text} = {length:.1f} m", GREY,
              f'text-anchor="middle" transform="translate({x:.1f} {y:.1f}) rotate({angle:.1f})"')


def _chain(made: Drawing) -> None:
    """The order of the steps from link to link."""
    y = HEIGHT - 66
    boxes = ((26, 172, "far end of the", "link before"), (346, 232, "P: pins, masses and", "inertias of the link"),
             (752, 122, "far end of", "the link"))
    for x, width, first, second in boxes:
        bold = 'font-weight="bold" ' if first.startswith("P") else ""
        colour = BLUE if bold else GREY
        made.lines.append(f'<rect x="{x}" y="{y - 26}" width="{width}" height="52" rx="7" fill="none" '
                          f'stroke="{colour}" stroke-width="1.5"/>')
        for row, text in enumerate((first, second)):
            made.text(x + width / 2, y - 5 + 19 * row, text, colour if bold else INK, f'{bold}text-anchor="middle"')
    for left, right, first, second in ((198, 346, "d along z, then", "joint's angle + theta"),
                                       (578, 752, "a along x, then", "alpha, beta")):
        made.lines.append(f'<line x1="{left + 6}" y1="{y}" x2="{right - 8}" y2="{y}" stroke="{BLUE}" '
                          'stroke-width="2.4" marker-end="url(#tip)"/>')
        for text, dy in ((first, -9), (second, 20)):
            made.text((left + right) / 2, y + dy, text, INK, 'text-anchor="middle" font-size="13"')


if __name__ == "__main__":
    (FOLDER / "pins.svg").write_text(drawing(), "utf-8")
