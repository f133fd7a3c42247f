"""The machine in space as a page shows it: bodies, struts and surroundings, colours, and the columns that move it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from hydroopt.machine.machine import BASE
from hydroopt.report.samples import packed

if TYPE_CHECKING:
    from hydroopt.model.scene_graph import Point, SceneGraph
    from hydroopt.spatial.inertia import Array


@dataclass(frozen=True)
class Tint:
    """Colours of parts by a number of theirs.

    Attributes:
        name: of the choice.
        title: what the colour means.
        unit: of the number.
        highest: the number of the last colour; that of the first is zero.
        columns: of the samples by part, where the number changes with the clock, and what counts as one of it.
        values: by part, where it does not.
    """

    name: str
    title: str
    unit: str
    highest: float
    columns: Mapping[str, tuple[str, float]] = field(default_factory=dict)
    values: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Mark:
    """A ball about a point (3,) [m] of a body: a fixture, a target, an obstacle of some radius [m]."""

    name: str
    body: str
    at: Sequence[float]
    radius: float
    kind: str


@dataclass(frozen=True)
class SceneView:
    """A machine that moves with the samples of its page, or by sliders where it has none.

    Attributes:
        graph: the machine's bodies.
        replayed: names of the columns of the samples that hold q (in the order of ``machine.joints``, then of the
            calibrator's joints); empty for sliders.
        tints: ways to colour it, the first by default.
        marks: points to show.
        path: (k, 3) [m] of the tip in the base frame.
    """

    graph: SceneGraph
    replayed: tuple[str, ...] = ()
    tints: tuple[Tint, ...] = ()
    marks: tuple[Mark, ...] = ()
    path: Array | None = None

    @property
    def alt(self) -> str:
        """The view in words."""
        machine, struts = self.graph.machine, self.graph.struts
        how = "which replays the samples of this page" if self.replayed else "which moves by the sliders below"
        parts = f"{len(self.graph.bodies)} links: {', '.join(body.name for body in self.graph.bodies)}"
        between = f"; between pins: {', '.join(strut.name for strut in struts)}" if struts else ""
        return f"The machine {machine.name} in space, {how}. {parts}{between}."

    def payload(self) -> dict[str, Any]:
        """What the page's scripts read: lengths in m, angles in rad, matrices row by row."""
        graph, machine = self.graph, self.graph.machine
        known = (*machine.joints, *graph.columns[len(machine.tree_joints):])
        return {
            "base": graph.base.ravel().tolist(), "onBase": graph.on_base.tolist(),
            "bodies": [{"name": body.name, "parent": body.parent, "seat": body.seat[:3].ravel().tolist(),
                        "joint": body.joint, "column": body.column, "points": body.points.tolist(),
                        "section": None if body.section is None else body.section.tolist(),
                        "com": None if body.com is None else body.com.tolist()} for body in graph.bodies],
            "struts": [{**strut._asdict(), "start": _point(strut.start), "end": _point(strut.end)}
                       for strut in graph.struts],
            "closings": [{"name": each.name, "one": _point(each.one), "other": _point(each.other)}
                         for each in graph.closings],
            "tree": len(machine.tree_joints), "columns": len(graph.columns), "tip": _point(graph.tip),
            "replayed": list(self.replayed), "alt": self.alt,
            "joints": [self._joint(name) for name in known],
            "turning": {each.name: each.joint for each in machine.motors}
            | {each.name: each.joint for each in machine.drives},
            "tints": [vars(tint) | {"columns": dict(tint.columns), "values": dict(tint.values)} for tint in self.tints],
            "marks": [vars(mark) | {"at": list(mark.at)} for mark in (*self.marks, *self._obstacles())],
            "path": None if self.path is None else packed(np.asarray(self.path).ravel()),
            "ground": machine.ground,
            "footprint": [] if machine.footprint is None else [list(corner) for corner in machine.footprint.corners],
            "workspace": None if machine.workspace is None else [list(machine.workspace.lower),
                                                                 list(machine.workspace.upper)]}

    def _joint(self, name: str) -> dict[str, Any]:
        link = next(each for each in self.graph.geometry.links if each.name == name)
        low, high = link.joint.range if link.joint.lower is not None else (-np.pi, np.pi)
        return {"name": name, "lower": low, "upper": high, "turns": link.joint.type == "revolute"}

    def _obstacles(self) -> tuple[Mark, ...]:
        return tuple(Mark(each.name, each.link, each.centre, each.radius, "obstacle")
                     for each in self.graph.machine.obstacles)


def _point(point: Point) -> dict[str, Any]:
    return {"body": point[0], "at": list(point[1])}


def base_point(name: str, at: Sequence[float], kind: str, radius: float = 0.03) -> Mark:
    """A point (3,) [m] of the base frame."""
    return Mark(name, BASE, at, radius, kind)
