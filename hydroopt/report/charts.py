"""The figures of a page: what each shows, in words too."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from hydroopt.report.numbers import plain
from hydroopt.report.samples import Samples, packed
from hydroopt.spatial.inertia import Array

NOTHING = np.zeros(0)
LOOKS = ("predicted", "other", "third", "fourth", "fifth", "sixth")
"""Looks of lines of equal rank, in order; ``measured`` is one more. Their colours are those of the page's style."""


@dataclass(frozen=True)
class Line:
    """A column drawn over the clock: `look` is one of `LOOKS` or ``measured``; `dashed` are limits or other models."""

    column: str
    label: str
    look: str = "predicted"
    dashed: bool = False
    dots: bool = False


@dataclass(frozen=True)
class TimeChart:
    """Lines over the clock.

    Attributes:
        title: what is shown, with its unit.
        lines: the first is drawn first.
        alt: what the figure shows, with its numbers; by default the range of every line.
        band: lower and upper edge of a shaded band.
        limits: heights of broken lines.
        span: lowest and highest value of the axis; by default that of the lines.
        shaded: look, and columns of the lower and upper edge, of shaded bands.
        logarithmic: whether the axis of values is.
    """

    title: str
    lines: tuple[Line, ...]
    alt: str = ""
    band: tuple[float, float] | None = None
    limits: tuple[float, ...] = ()
    span: tuple[float, float] | None = None
    shaded: tuple[tuple[str, str, str], ...] = ()
    logarithmic: bool = False
    kind: ClassVar[str] = "time"


@dataclass(frozen=True)
class Cloud:
    """A dot a sample: column `y` over column `x`; a click moves the clock to the dot."""

    title: str
    x: str
    y: str
    across: str
    alt: str = ""
    band: tuple[float, float] | None = None
    kind: ClassVar[str] = "cloud"


@dataclass(frozen=True)
class HeatMap:
    """Mean magnitude of the column `value` in cells of the place of the machine's tip."""

    title: str
    value: str
    unit: str
    across: str = ""
    up: str = ""
    kind: ClassVar[str] = "map"


@dataclass(frozen=True)
class Field:
    """Mean of `value` (N,) in cells of the places `x`, `y` (N,), which are no samples of the page."""

    title: str
    x: Array
    y: Array
    value: Array
    unit: str
    across: str
    up: str
    kind: ClassVar[str] = "field"


@dataclass(frozen=True)
class Curves:
    """Lines over values of their own, not over the clock.

    Attributes:
        title: what is shown, with its unit.
        across: what `x` (N,) is, with its unit.
        lines: label, look and values (N,) of each.
        alt: what the figure shows, with its numbers; by default the range of every line.
        limits: heights of broken lines.
        bands: look, lower and upper edge (N,) of shaded bands.
        logarithmic: whether the axis of `x`, and that of values, is.
        dots: whether values are dots instead of lines.
        ticks: numbers at the axis of values are multiples of this one; 0 for any.
    """

    title: str
    across: str
    x: Array
    lines: tuple[tuple[str, str, Array], ...]
    alt: str = ""
    limits: tuple[float, ...] = ()
    bands: tuple[tuple[str, Array, Array], ...] = ()
    logarithmic: tuple[bool, bool] = (False, False)
    dots: bool = False
    ticks: float = 0.0
    kind: ClassVar[str] = "curves"


@dataclass(frozen=True)
class Plane:
    """Lines and dots in a plane whose axes have about the same scale, such as the complex one.

    Attributes:
        title: what is shown.
        across, up: what the axes are.
        span: left, right, lower and upper end.
        lines: label, look, x and y (N,) of each.
        dots: label, look, x and y (N,) of each; those whose label ends in ``poles`` are crosses.
        circles: centre x, y and radius of broken circles.
        alt: what the figure shows, with its numbers.
    """

    title: str
    across: str
    up: str
    span: tuple[float, float, float, float]
    lines: tuple[tuple[str, str, Array, Array], ...] = ()
    dots: tuple[tuple[str, str, Array, Array], ...] = ()
    circles: tuple[tuple[float, float, float], ...] = ()
    alt: str = ""
    kind: ClassVar[str] = "plane"


Chart = TimeChart | Cloud | HeatMap | Field | Curves | Plane


def described(chart: TimeChart | Curves, samples: Samples) -> str:
    """A chart in words: its title and the range of every line.

    >>> samples = Samples("time [s]", np.arange(3.0), {"f": np.array([-1.0, 2.0, np.nan])})
    >>> described(TimeChart("boom cylinder: force [kN]", (Line("f", "measured"),)), samples)
    'boom cylinder: force [kN], time [s] from 0 to 2: measured from −1 to 2.'
    """
    if chart.alt:
        return chart.alt
    if isinstance(chart, Curves):
        over, at, lines = chart.across, chart.x, [(label, values) for label, _, values in chart.lines]
    else:
        over, at = samples.clock, samples.at
        lines = [(line.label, samples.columns[line.column]) for line in chart.lines]
    spans = [f"{label} from {plain(float(np.nanmin(values)), 3)} to {plain(float(np.nanmax(values)), 3)}"
            for label, values in lines if np.any(np.isfinite(values))]
    ends = f"{plain(float(at[0]), 3)} to {plain(float(at[-1]), 3)}" if len(at) else "nothing"
    return f"{chart.title}, {over} from {ends}: {'; '.join(spans) or 'no values'}."


def payload(chart: Chart) -> dict[str, Any]:
    """What the page's scripts read of a chart."""
    found = {"kind": chart.kind} | {key: value for key, value in vars(chart).items() if key != "alt"}
    if isinstance(chart, TimeChart):
        found["lines"] = [vars(line) for line in chart.lines]
    if isinstance(chart, Field):
        found |= {key: packed(getattr(chart, key)) for key in ("x", "y", "value")}
    if isinstance(chart, Plane):
        found |= {key: [{"label": label, "look": look, "x": packed(x), "y": packed(y)} for label, look, x, y in some]
                  for key, some in (("lines", chart.lines), ("dots", chart.dots))}
    if isinstance(chart, Curves):
        found["x"] = packed(chart.x)
        found["lines"] = [{"label": label, "look": look, "values": packed(values)}
                          for label, look, values in chart.lines]
        found["bands"] = [{"look": look, "low": packed(low), "high": packed(high)} for look, low, high in chart.bands]
    return found
