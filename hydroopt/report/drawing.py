"""A machine as a drawing without scripts: its parts seen from one direction, as shapes in metres and as inline SVG."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from html import escape
from itertools import pairwise
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from markupsafe import Markup
from numpy.typing import ArrayLike

from hydroopt.errors import visible
from hydroopt.machine.machine import BASE
from hydroopt.report.numbers import plain
from hydroopt.spatial.convex_hull import corners

if TYPE_CHECKING:
    from hydroopt.model.scene_graph import SceneGraph, Strut
    from hydroopt.model.vertical_plane import Plane
    from hydroopt.spatial.inertia import Array

WIDE, NARROW, TALL = 860.0, 290.0, 520.0
"""Largest width of the machine in a drawing, on a screen and on a phone, and its largest height [px]."""
LEFT, BELOW, EDGE = 52, 40, 10
"""Room for the numbers of the axes, and around all [px]."""
LETTER, LINE = 7.5, 13.0
"""Width of a letter and height of a line [px]."""
STEPS = (1.0, 2.0, 5.0)
STRUTS = ("cylinder", "gas", "spring", "rod")

Pixels = Callable[["Array"], list[tuple[float, float]]]
"""What turns places (k, 2) [m] into those on the sheet [px]."""


class View(NamedTuple):
    """Directions (3,) in the world that point to the right and up on paper."""

    right: Array
    up: Array

    @classmethod
    def side(cls, plane: Plane) -> View:
        """Onto a vertical plane."""
        return cls(plane.across, np.array([0.0, 0.0, 1.0]))

    def of(self, points: Array) -> Array:
        """Places (k, 2) on paper of points (k, 3)."""
        return np.asarray(np.asarray(points).reshape(-1, 3) @ np.array([self.right, self.up]).T)

    def nearness(self, points: Array) -> float:
        """How near the middle of points (k, 3) is to who looks."""
        return float(np.mean(np.asarray(points).reshape(-1, 3) @ np.cross(self.right, self.up)))


class Part(NamedTuple):
    """A part: the corners (k, 2) [m] of its outline; of a cylinder the barrel's pin and end, then the rod's pin."""

    name: str
    kind: Literal["chassis", "link", "cylinder", "gas", "spring", "rod"]
    corners: Array


class Posture(NamedTuple):
    """The parts of a machine in one posture, the farthest first, its joints and pins of struts (k, 2) [m] by name, and
    the centres of mass of its links."""

    parts: tuple[Part, ...]
    joints: dict[str, Array]
    pins: tuple[Array, ...]
    masses: dict[str, Array]

    def places(self) -> Iterator[Array]:
        """Every point (2,) [m] that is drawn."""
        for part in self.parts:
            yield from part.corners
        yield from (*self.joints.values(), *self.pins, *self.masses.values())


class Name(NamedTuple):
    """A name that stands beside a place (2,) [m], in the colour of a kind of part."""

    text: str
    at: Array
    kind: str


@dataclass(frozen=True)
class Drawing:
    """A machine from one direction: as it mainly stands, and faint behind that other postures.

    >>> from hydroopt.machine.machine_file import load_machine
    >>> from hydroopt.model.scene_graph import SceneGraph
    >>> side = View(np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]))
    >>> found = drawn(SceneGraph(load_machine("cat215b")), np.array([[0.0, -0.5, 1.5]]), side)
    >>> [part.name for part in found.first.parts]
    ['base', 'swing', 'boom', 'stick', 'boom_cylinder', 'stick_cylinder']
    >>> found.svg("An excavator.")[:20]
    Markup('<svg class="drawing"')
    """

    first: Posture
    others: tuple[Posture, ...]

    @cached_property
    def corners(self) -> tuple[Array, Array]:
        """Lower left and upper right corner (2,) [m], with some room."""
        places = np.array([at for posture in (self.first, *self.others) for at in posture.places()])
        low, high = places.min(axis=0), places.max(axis=0)
        room = 0.07 * max(float(np.max(high - low)), 1e-3)
        return low - room, high + room

    def description(self, machine: str, how: str) -> str:
        """A view from the side in words."""
        by = {kinds: dict.fromkeys(part.name for part in self.first.parts if part.kind in kinds)
              for kinds in (("link",), STRUTS)}
        (left, bottom), (right, top) = ([plain(float(x), 3) for x in corner] for corner in self.corners)
        struts = f" with {', '.join(by[STRUTS])} between pins" if by[STRUTS] else ""
        return (f"The machine {machine} from the side, {how}: links {', '.join(by['link',])}{struts}, within {left} to "
                f"{right} m of reach and {bottom} to {top} m of height.")

    def names(self) -> list[Name]:
        """Names of joints, struts, and links whose joint has another name; joints in one place share theirs."""
        found: list[Name] = []
        near = 0.008 * float(np.max(self.corners[1] - self.corners[0]))
        for joint, at in self.first.joints.items():
            same = next((k for k, one in enumerate(found) if np.linalg.norm(one.at - at) < near), None)
            if same is None:
                found.append(Name(joint, at, "link"))
            else:
                found[same] = Name(f"{found[same].text}, {joint}", at, "link")
        found += [Name(part.name, (part.corners[0] + part.corners[-1]) / 2, part.kind) for part in self.first.parts
                  if part.kind in STRUTS]
        bodies = [Name(link, at, "com") for link, at in self.first.masses.items() if link not in self.first.joints]
        return found + bodies

    def lettered(self, scale: float, letter: float = LETTER, line: float = LINE) -> list[Name]:
        """Names where each covers least, at a scale [px/m] and sizes of letters [px]; none over another."""
        low, high = self.corners
        busy = np.array([a + t * (b - a) for part in self.first.parts for a, b in pairwise(part.corners)
                         for t in np.linspace(0, 1, 25)]) * scale
        placed: list[Name] = []
        boxes: list[tuple[Array, Array]] = []
        for name in self.names():
            half = np.array([letter * len(name.text) / 2 + 2, line / 2])
            at = name.at * scale
            best = min(_around(at, half), key=lambda c, h=half, a=at: _cover(  # type: ignore[misc]
                c, h, busy, boxes, a, (low * scale, high * scale)))
            if any(np.all(np.abs(other - best) < half + size) for other, size in boxes):
                continue
            boxes.append((best, half))
            placed.append(name._replace(at=best / scale))
        return placed

    def svg(self, alt: str, *, axes: bool = False, named: bool = True, wide: float = WIDE) -> Markup:
        """An ``<svg>`` element in the colours of its page, at most `wide` px; `axes` are metres of its plane."""
        low, high = self.corners
        scale = float(np.min(np.array([wide, TALL]) / (high - low)))
        width, height = (high - low) * scale
        left, below = (LEFT, BELOW) if axes else (0, 0)

        def px(points: Array) -> list[tuple[float, float]]:
            return [(left + x, height - y) for x, y in ((np.asarray(points).reshape(-1, 2) - low) * scale).tolist()]

        words = [*(_ruled(low, high, px) if axes else ())]
        for posture in self.others:
            words += ['<g class="faint">', *_parts(posture, px), "</g>"]
        words += [*_parts(self.first, px), *_dots(self.first, px)]
        for name in self.lettered(scale) if named else ():
            (x, y), = px(name.at)
            words.append(f'<text class="{name.kind}" x="{x:.0f}" y="{y + 4:.0f}" text-anchor="middle">'
                         f"{escape(visible(name.text))}</text>")
        across, tall = left + width + EDGE, height + below + EDGE
        return Markup(f'<svg class="drawing" viewBox="0 0 {across:.0f} {tall:.0f}" width="{across:.0f}" role="img" '
                      f'aria-label="{escape(visible(alt))}">{"".join(words)}</svg>')


def drawn(graph: SceneGraph, tree: Array, view: View) -> Drawing:
    """The machine at positions (k, t) [rad or m] of all joints of the tree, as ``graph.columns`` names them.

    The first row is the main posture; rows of others whose loops cannot close are left out.
    """
    found = [_posture(graph, dict(zip(graph.columns, row, strict=True)), view)
             for k, row in enumerate(np.asarray(tree, dtype=float).tolist()) if not k or np.all(np.isfinite(row))]
    return Drawing(found[0], tuple(found[1:]))


def _posture(graph: SceneGraph, tree: dict[str, float], view: View) -> Posture:
    poses = graph.poses(tree)

    def world(body: str, points: ArrayLike) -> Array:
        local = np.asarray(points, dtype=float).reshape(-1, 3)
        return np.asarray(local @ poses[body][:3, :3].T + poses[body][:3, 3])

    bodies = [(world(body.name, points), body.name, "link") for body in graph.bodies
              for points in (body.points, body.section) if points is not None]
    if len(graph.on_base):
        bodies.append((world(BASE, [[0.0, 0.0, 0.0], *graph.on_base]), BASE, "chassis"))
    bodies.sort(key=lambda body: round(view.nearness(body[0]), 6))
    parts = [Part(name, kind, seen[corners(seen)])  # type: ignore[arg-type]
             for seen, name, kind in ((view.of(points), name, kind) for points, name, kind in bodies)]
    pins: list[Array] = []
    for strut in graph.struts:
        start, end = (world(body, at)[0] for body, at in (strut.start, strut.end))
        parts.append(Part(strut.name, strut.kind, view.of(_strut(strut, start, end))))
        pins += [*view.of(np.array([start, end]))]
    joints = {body.name: view.of(world(body.name, (0.0, 0.0, 0.0)))[0] for body in graph.bodies
              if body.column is not None}
    closings = [view.of(world(*each.one))[0] for each in graph.closings]
    masses = {body.name: view.of(world(body.name, body.com))[0] for body in graph.bodies if body.com is not None}
    return Posture(tuple(parts), joints, (*pins, *closings), masses)


def _strut(strut: Strut, start: Array, end: Array) -> Array:
    """Points (k, 3) of a strut's line between its pins."""
    length = float(np.linalg.norm(end - start))
    neck = start + (end - start) * min(0.95, strut.body / max(length, 1e-9))
    return np.array([start, neck, end] if strut.body else [start, end])


def coil(start: Array, end: Array) -> Array:
    """Points (k, 2) of a spring's zigzag between its pins."""
    along = np.concatenate([[0.0, 0.15], np.linspace(0.2, 0.8, 13), [0.85, 1.0]])
    aside = np.concatenate([[0.0, 0.0], 0.04 * (-1.0) ** np.arange(13), [0.0, 0.0]])
    line = end - start
    return np.asarray(start + np.outer(along, line) + np.outer(aside, [-line[1], line[0]]))


def ticks(low: float, high: float, most: int = 7) -> list[float]:
    """Round numbers between two others, at most `most`.

    >>> ticks(-1.3, 6.2)
    [0.0, 2.0, 4.0, 6.0]
    """
    power = 10.0 ** np.floor(np.log10((high - low) / most))
    step = next(s for s in (*(power * s for s in STEPS), 10 * power) if (high - low) / s <= most)
    return [float(k * step) for k in range(int(np.ceil(low / step)), int(np.floor(high / step)) + 1)]


# --- SVG ---


def _path(points: Sequence[tuple[float, float]], *, closed: bool = False) -> str:
    return "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in points) + ("Z" if closed else "")


def _parts(posture: Posture, px: Pixels) -> Iterator[str]:
    for part in posture.parts:
        corners = px(coil(*part.corners) if part.kind == "spring" else part.corners)
        if part.kind in ("link", "chassis"):
            path = _path(corners, closed=True)
            yield f'<path class="edge" d="{path}"/><path class="{part.kind}" d="{path}"/>'
        else:
            yield f'<path class="{part.kind}" d="{_path(corners)}"/>'
            if len(corners) == 3:
                yield f'<path class="{part.kind} barrel" d="{_path(corners[:2])}"/>'


def _dots(posture: Posture, px: Pixels) -> Iterator[str]:
    for kind, radius, places in (("mass", 4, posture.masses.values()), ("pin", 3, posture.pins),
                                 ("joint", 4.5, posture.joints.values())):
        for at in places:
            (x, y), = px(at)
            yield f'<circle class="{kind}" cx="{x:.1f}" cy="{y:.1f}" r="{radius}"/>'


def _ruled(low: Array, high: Array, px: Pixels) -> Iterator[str]:
    """Lines of a grid with their numbers, and what they count."""
    (left, bottom), (right, top) = px(np.array([low, high]))
    for x in ticks(low[0], high[0]):
        (at, _), = px(np.array([x, 0.0]))
        yield f'<path class="grid" d="M{at:.1f} {bottom:.1f}V{top:.1f}"/>'
        yield f'<text x="{at:.0f}" y="{bottom + 16:.0f}" text-anchor="middle">{plain(x, 3)}</text>'
    for y in ticks(low[1], high[1]):
        (_, at), = px(np.array([0.0, y]))
        yield f'<path class="grid" d="M{left:.1f} {at:.1f}H{right:.1f}"/>'
        yield f'<text x="{left - 6:.0f}" y="{at + 4:.0f}" text-anchor="end">{plain(y, 3)}</text>'
    yield (f'<text x="{(left + right) / 2:.0f}" y="{bottom + 36:.0f}" text-anchor="middle">'
           "reach in the plane of the drawing [m]</text>")
    yield f'<text transform="translate(14 {(top + bottom) / 2:.0f}) rotate(-90)" text-anchor="middle">height [m]</text>'


# --- places of names ---


def _around(at: Array, half: Array) -> list[Array]:
    angles = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    return [at + np.array([np.cos(a), np.sin(a)]) * (half + gap) for gap in (9, 15, 22, 32) for a in angles]


def _cover(centre: Array, half: Array, busy: Array, boxes: list[tuple[Array, Array]], at: Array,
           limits: tuple[Array, Array]) -> float:
    """How bad a place is for a name: what it covers, how far it is, whether it leaves the drawing."""
    hidden = float(np.sum(np.all(np.abs(busy - centre) < half + 2, axis=1)))
    clash = sum(bool(np.all(np.abs(other - centre) < half + size)) for other, size in boxes)
    outside = bool(np.any(centre - half < limits[0]) or np.any(centre + half > limits[1]))
    return hidden + 30 * clash + 50 * outside + 0.06 * float(np.linalg.norm(np.maximum(np.abs(centre - at) - half, 0)))
