"""The parts of a machine as straight lines, and the distances between them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import casadi as ca
import numpy as np

from hydroopt.limits.uncertain import TINY
from hydroopt.machine.loops import Loop
from hydroopt.machine.machine import BASE, Machine
from hydroopt.model.model import Model
from hydroopt.model.scene_graph import SceneBody
from hydroopt.spatial.inertia import Array

CLOSE, OFTEN, POSTURES = 0.1, 0.25, 400
"""Parts that are nearer than this [m] in more than this part of so many random postures are built close."""
VARIES = 1e-6
"""Change of a distance [m] over these postures from which on it varies."""


class Part(NamedTuple):
    """A line of a link, or a cylinder, rod or spring from pin to pin; all in the base frame.

    `start` and `end` (3,) [m] are expressions of q; `radius` [m] is that of a barrel, zero where none is known. `link`
    is the link that it belongs to, empty for a strut; `carriers` are the links that carry its ends. A line is `rooted`
    if it starts where its link is held.
    """

    name: str
    start: ca.SX
    end: ca.SX
    radius: float
    link: str
    carriers: frozenset[str]
    rooted: bool = True

    @property
    def bodies(self) -> frozenset[str]:
        """The link that it is and those that carry it."""
        return self.carriers | ({self.link} if self.link else frozenset())


def parts(model: Model) -> tuple[Part, ...]:
    """The lines of all links, but for axes without body and length, then all struts, of a machine.

    They are those that its picture shows: `SceneBody.lines` and the sections of telescopes.
    """
    machine, graph = model.machine, model.scene_graph
    poses = {link.name: model.dynamics.links[link.name].pose for link in machine.links}

    def at(link: str, place: Sequence[float]) -> ca.SX:
        return ca.SX(ca.DM(place)) if link == BASE else poses[link].point(ca.DM(place))

    def line(body: SceneBody, ends: Array, carriers: frozenset[str], *, rooted: bool) -> Part:
        start, end = (at(body.name, each.tolist()) for each in ends)
        return Part(body.name, start, end, 0.0, body.name, carriers, rooted)

    links = []
    for body in graph.bodies:
        if machine.link(body.name).body is not None or np.any(body.lines):
            links += [line(body, ends, frozenset({body.parent}), rooted=not np.any(ends[0])) for ends in body.lines]
        if body.section is not None:  # its inner end moves in the telescope's first section, and is held where this is
            first = _section(machine, body.name)
            links.append(line(body, body.section[::-1], frozenset({body.parent, first, machine.link(first).parent}),
                              rooted=True))
    struts = [Part(strut.name, at(*strut.start), at(*strut.end),
                   strut.diameter / 2 if strut.kind == "cylinder" else 0.0, "",
                   frozenset({strut.start[0], strut.end[0]})) for strut in graph.struts]
    return (*links, *struts)


def pairs(model: Model, within: float) -> Iterator[tuple[Part, Part]]:
    """Two links, or a link and a strut, that may come nearer to each other than `within` [m].

    Left out are those that a pin or joint joins, sections of a telescope and what they carry, parts of one linkage, and
    those that are built close: nearer than `CLOSE` in more than `OFTEN` of random postures.
    """
    machine, found = model.machine, parts(model)
    sections = {link.name: _section(machine, link.name) for link in machine.links} | {BASE: BASE}
    linkages = [frozenset(_linkage(machine, loop)) for loop in machine.loops]

    def joined(one: Part, other: Part) -> bool:
        return bool(one.link) and sections[one.link] in {sections[each] for each in other.bodies}

    apart = [(one, other) for k, one in enumerate(found) for other in found[k + 1:]
             if one.link and not joined(one, other) and not joined(other, one)
             and not any(one.link in linkage and other.bodies <= linkage for linkage in linkages)]
    if not apart:
        return
    drawn = drawn_distances(model, [distance(one, other) - one.radius - other.radius for one, other in apart])
    for pair, values in zip(apart, drawn, strict=True):
        if values.size and np.min(values) < within and np.ptp(values) > VARIES and not built_close(values):
            yield pair


def drawn_distances(model: Model, distances: Sequence[ca.SX]) -> list[Array]:
    """Each of these functions of q [m] in random postures within all joints' limits, but those where loops do not
    close."""
    between = ca.Function("between", [model.coordinates.q], [ca.vertcat(*distances)])
    low, high = model.machine.ranges.T
    drawn = np.random.default_rng(0).uniform(low, high, (POSTURES, len(low)))
    return [every[np.isfinite(every)] for every in np.asarray(between.map(POSTURES)(drawn.T))]


def built_close(distances: Array) -> bool:
    """Whether parts are built close to each other, by their distances [m] in random postures.

    >>> built_close(np.array([0.05, 0.08, 0.3, 0.4])), built_close(np.array([0.05, 0.2, 0.3, 0.4]))
    (True, False)
    """
    return bool(distances.size and np.mean(distances < CLOSE) > OFTEN)


def _section(machine: Machine, link: str) -> str:
    """The first section of the telescope that a link belongs to, the link that it is fixed to, or itself."""
    while link != BASE and machine.link(link).joint.type != "revolute":
        link = machine.link(link).parent
    return link


def _linkage(machine: Machine, loop: Loop) -> Iterator[str]:
    """The links of a closed loop."""
    for joint in machine.joints_between(loop.link, loop.to.link):
        yield from (joint, machine.link(joint).parent)


def distance_to_point(part: Part, point: ca.SX) -> ca.SX:
    """Distance [m] of a part's line from a point (3,)."""
    along = part.end - part.start
    share = _share(ca.dot(point - part.start, along) / (ca.sumsqr(along) + TINY))
    return _length(part.start + share * along - point)


def distance(one: Part, other: Part) -> ca.SX:
    """Distance [m] between the lines of two parts (Ericson, Real-Time Collision Detection, 5.1.9)."""
    first, second, between = one.end - one.start, other.end - other.start, one.start - other.start
    a, e, b = ca.sumsqr(first) + TINY, ca.sumsqr(second) + TINY, ca.dot(first, second)
    c, f = ca.dot(first, between), ca.dot(second, between)
    s = _share((b * f - c * e) / (a * e - b * b + TINY))
    t = _share((b * s + f) / e)
    s = _share((b * t - c) / a)
    return _length(between + s * first - t * second)


def _share(value: ca.SX) -> ca.SX:
    """A value within 0 and 1."""
    return (ca.fabs(value) - ca.fabs(value - 1) + 1) / 2


def _length(vector: ca.SX) -> ca.SX:
    return ca.sqrt(ca.sumsqr(vector) + TINY)
