"""What people beside a driven machine keep: how far they stay away, and the values at which they stop it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from functools import cache
from textwrap import fill
from typing import Any

import casadi as ca
import numpy as np
from scipy.optimize import Bounds, differential_evolution

from hydroopt.limits.limits import MARGIN, UseOfLimit
from hydroopt.limits.reserves import Reserves
from hydroopt.machine.machine import BASE
from hydroopt.model.model import Model
from hydroopt.spatial.inertia import Array

ROWS = 15
"""Values that people watch at most."""
IN_PRINT = {"rad": ("deg", 180 / np.pi, 1), "m": ("mm", 1e3, 0)}
"""Units of a sheet and of the table that is filled in by it: name, what SI is multiplied by, and decimals."""
READING = "Read only while the machine rests and its controls are locked; nobody stands below a raised part."
"""What holds beside `Watch.rules` where somebody walks to the machine to read."""


def in_print(value: float, unit: str) -> tuple[str, str]:
    """A value [SI] and its unit as sheets have them.

    >>> in_print(-0.0002, "m"), in_print(0.5, "rad"), in_print(9.80665, "m/s^2")
    (('0', 'mm'), ('28.6', 'deg'), ('9.807', 'm/s^2'))
    """
    if unit not in IN_PRINT:
        return f"{value:.4g}", unit
    name, factor, decimals = IN_PRINT[unit]
    return f"{round(factor * value, decimals) + 0.0:.{decimals}f}", name


@dataclass(frozen=True)
class Reach:
    """Space that a machine's parts reach about the vertical through the origin of its base frame [m].

    `radius` is the distance from that vertical, `highest` and `lowest` are heights above the origin; what people
    watch has them above the ground, where the machine file states it.
    """

    radius: float
    highest: float
    lowest: float


@dataclass(frozen=True)
class StopValue:
    """What people watch: its name, its unit in print, what is planned, and the values at which to stop."""

    name: str
    unit: str
    planned: str
    stop: str


@dataclass(frozen=True)
class Watch:
    """What people beside a driven machine keep.

    Attributes:
        largest: what the machine reaches, all joints over their whole ranges.
        planned: what its own parts reach as planned.
        attached: length of what hangs at its tip, such as a calibrator, part of the largest reach alone [m].
        kept: distance that is added to the largest reach [m].
        margin: how far beyond the plan a motion is stopped, in words.
        stops: at most `ROWS` values at which it is stopped, the most urgent first.
        more: how many more values with a stop there are.
        datum: what the heights are above, in words.
    """

    largest: Reach
    planned: Reach
    attached: float
    kept: float
    margin: str
    stops: tuple[StopValue, ...]
    more: int
    datum: str

    @property
    def distance(self) -> float:
        """What everyone keeps away from the machine's vertical axis [m], rounded up to 0.1 m."""
        return float(np.ceil(10 * (self.largest.radius + self.kept)) / 10)

    @property
    def rules(self) -> tuple[str, ...]:
        """What holds before and while the machine is driven, in sentences."""
        hangs = f", {self.attached:.2f} m of which hang at its tip" if self.attached else ""
        return (
            f"Keep everyone {self.distance:.1f} m away from the machine's vertical axis, on all sides. Its parts reach "
            f"{self.largest.radius:.2f} m with all joints over their whole ranges{hangs}; {self.kept:g} m are added. "
            f"The plan itself reaches {self.planned.radius:.2f} m.",
            f"Nothing is above it: its parts reach up to {self.largest.highest:.2f} m above {self.datum} (planned "
            f"{self.planned.highest:.2f} m). Power lines need their own distance beside that.",
            "What the machine file does not state adds to the distance: measure how far bucket, load and counterweight "
            "stick out beyond their pins.",
            "One person only watches, outside the circle, sees the whole machine, and holds an emergency stop that was "
            "tried before. Who drives stays in the cab or outside the circle.",
            "Stop at once if someone enters the circle, a support lifts or sinks, a hose leaks, the machine does not "
            "follow, or the watcher loses sight of it. Nobody enters before it rests and its controls are locked.")

    @property
    def order(self) -> str:
        """The order of the values, and where the others stand."""
        rest = f" {self.more} more stand in the table for the engineer." if self.more else ""
        return f"First stands what comes nearest to its limit, in units of its margin. {self.margin}{rest}"

    def as_dict(self) -> dict[str, Any]:
        """The entry of a JSON file [m]."""
        return {"distance": self.distance, "largest": asdict(self.largest), "planned": asdict(self.planned),
                "added": self.kept, "stops": [asdict(each) for each in self.stops]}

    @property
    def list(self) -> str:
        """The rules as plain text."""
        return _listed(self.rules)

    def sheet(self, about: str, *lines: str) -> str:
        """A measuring sheet as plain text: what it is about, what people keep, what to do, and when to stop."""
        stops = ("", "Stop at once beyond these values.", self.table) if self.stops else ()
        return "\n".join([about, "", _listed((*self.rules, READING)), "", *lines, *stops]) + "\n"

    @property
    def table(self) -> str:
        """The values as plain text."""
        rows = [("watch", "planned", "stop", "unit"), *((one.name, one.planned, one.stop, one.unit)
                                                        for one in self.stops)]
        wide = [max(len(row[k]) for row in rows) for k in range(4)]
        return "\n".join([fill(self.order, 100), "", *(
            "  " + "  ".join(f"{cell:<{width}}" for cell, width in zip(row, wide, strict=True)).rstrip()
            for row in rows)])


def _listed(rules: Iterable[str]) -> str:
    return "\n".join(fill(rule, 100, initial_indent="- ", subsequent_indent="  ") for rule in rules)


def watch(model: Model, planned: Reach, uses: Iterable[UseOfLimit], reserves: Reserves, *,
          attached: float = 0.0) -> Watch:
    """What people keep beside a machine.

    Args:
        model: of the machine.
        planned: what the plan reaches.
        uses: what the plan uses of the limits.
        reserves: that the plan keeps.
        attached: length [m] of what hangs at the machine's tip, such as a calibrator.

    Example:
        >>> from hydroopt.limits.limits import Limits, courses
        >>> from hydroopt.machine.machine_file import load_machine
        >>> model, q = Model(load_machine("patu655_lift")), np.array([[0.2], [0.3]])
        >>> uses = [course.use for course in courses(Limits(model), q, 0 * q, 0 * q).values()]
        >>> found = watch(model, reach(model, q), uses, Reserves())
        >>> found.distance > found.largest.radius + 1.9 > found.planned.radius + 1.9
        True
        >>> found.stops[0].name, found.stops[0].stop
        ('lift position', 'below 10.3, above 18.4')
    """
    seen = sorted((use for use in uses if use.seen and use.margin), key=lambda use: use.room / use.margin)
    own = largest_reach(model)
    largest = Reach(own.radius + attached, own.highest + attached, own.lowest - attached)
    margin = (f"The stop lies beyond the plan by {MARGIN:g} times the tracking error that the plan assumes, "
              f"{100 * reserves.tracking:g} % of each joint's range.")
    ground = model.machine.ground
    largest, planned = (replace(place, highest=place.highest - (ground or 0.0), lowest=place.lowest - (ground or 0.0))
                        for place in (largest, planned))
    return Watch(largest, planned, attached, reserves.people, margin,
                 tuple(_stop(model, use) for use in seen[:ROWS]), max(len(seen) - ROWS, 0),
                 "the origin of the base frame" if ground is None else "the ground")


def reach(model: Model, q: Array) -> Reach:
    """What a machine's parts reach at joint positions (N, n)."""
    at = np.asarray(_extent(model).map(len(q))(np.asarray(q).T))
    return Reach(*(float(sign * np.nanmax(row)) for sign, row in zip((1, 1, -1), at, strict=True)))


def largest_reach(model: Model, low: Array | None = None, high: Array | None = None) -> Reach:
    """What a machine's parts reach at most with joints between two positions (n,), whatever strokes permit.

    By default they go over their whole ranges.

    Found by differential evolution over all joints, refined by a quasi-Newton method.
    """
    mapped = cache(_extent(model).map)
    ranges = model.machine.ranges.T
    between = Bounds(ranges[0] if low is None else low, ranges[1] if high is None else high)

    def largest(k: int) -> float:
        def least(q: Array, /) -> Any:
            at = np.asarray(mapped(q.shape[1])(q))[k]
            return -np.where(np.isfinite(at), at, -1e3)

        return -float(differential_evolution(least, between, vectorized=True, seed=0, tol=1e-6,
                                             updating="deferred").fun)

    return Reach(largest(0), largest(1), -largest(2))


def _extent(model: Model) -> ca.Function:
    """q (n,) → the largest distance of any part from the vertical axis, its height, and its depth (3,) [m]."""
    machine, graph = model.machine, model.scene_graph
    poses = {link.name: model.dynamics.links[link.name].pose for link in machine.links}
    balls: list[tuple[str, Array, float]] = [(each.link, np.array(each.centre), each.radius)
                                             for each in machine.obstacles if each.link != BASE]
    for body in graph.bodies:
        ends = [body.points, body.far[None], *([] if body.com is None else [body.com[None]]),
                *([] if body.section is None else [body.section])]
        balls += [(body.name, point, 0.0) for point in np.unique(np.vstack(ends), axis=0)]
    balls += [(link, np.array(point), strut.diameter / 2 if strut.kind == "cylinder" else 0.0)
              for strut in graph.struts for link, point in (strut.start, strut.end) if link != BASE]
    places = [(poses[link].point(ca.DM(point)), radius) for link, point, radius in balls]
    up = ca.DM(graph.base[2])
    heights = [(ca.norm_2(at - ca.dot(up, at) * up), ca.dot(up, at), radius) for at, radius in places]
    values = [[away + radius, height + radius, radius - height] for away, height, radius in heights]
    return ca.Function("extent", [model.coordinates.q], [ca.vertcat(*(ca.mmax(ca.vertcat(*each))
                                                                     for each in zip(*values, strict=True)))])


def _stop(model: Model, use: UseOfLimit) -> StopValue:
    """How a sheet shows the use of a limit."""
    name, unit = use.name, IN_PRINT[use.unit][0]
    if name.endswith(" position"):
        joint = name.removesuffix(" position")
        along = model.machine.moved_along(joint)
        name = f"{joint} (with {', '.join(along)}) position" if along else name
    planned = [in_print(value, use.unit)[0] for value, bound in ((use.lowest, use.lower), (use.highest, use.upper))
               if np.isfinite(bound)]
    stop = [f"{word} {in_print(value, use.unit)[0]}" for word, value in zip(("below", "above"), use.stop, strict=True)
            if np.isfinite(value)]
    return StopValue(name, unit, " to ".join(planned), ", ".join(stop))
