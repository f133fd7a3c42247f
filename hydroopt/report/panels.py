"""Figures over time of jobs that show many quantities: each a few traces of one unit with its limits."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, MutableMapping
from dataclasses import dataclass, field

import numpy as np

from hydroopt.report.charts import LOOKS, TimeChart
from hydroopt.report.charts import Line as ChartLine
from hydroopt.report.numbers import NONE, plain, unit_text
from hydroopt.spatial.inertia import Array

DEG = 180 / np.pi
Units = Mapping[str, tuple[str, float]]
"""Units in print by SI unit, and what SI is multiplied by."""
SI: Units = {}
PRINTED: Units = {
    "rad": ("deg", DEG), "rad/s": ("deg/s", DEG), "rad/s^2": ("deg/s²", DEG), "m": ("m", 1.0), "Pa": ("bar", 1e-5),
    "m^3/s": ("L/min", 6e4), "N*m": ("kN·m", 1e-3), "N": ("kN", 1e-3)}
"""Units that a reader prefers."""
SMALL: Units = {"rad": ("deg", DEG), "m": ("mm", 1e3), "Pa": ("bar", 1e-5)}
"""The same for errors."""
NUMBERS: Units = {
    **SMALL, "rad/s": ("deg/s", DEG), "m^3/s": ("L/min", 6e4), "m^3": ("L", 1e3),
    "m^3/(s*Pa)": ("mL/(min·bar)", 6e12)}
"""The same for parameters and single numbers."""


def shown(unit: str, units: Units = NUMBERS) -> tuple[str, float]:
    """An SI unit in print, and what SI is multiplied by."""
    return units.get(unit, (unit_text(unit), 1.0))


def printed(value: float, unit: str, units: Units = NUMBERS, digits: int = 3) -> tuple[str, str]:
    """A number in SI to some significant digits, and its unit, in print.

    >>> printed(0.0123, "m")
    ('12.3', 'mm')
    """
    name, factor = shown(unit, units)
    return plain(factor * value, digits), name


def with_unit(value: float, unit: str, units: Units = NUMBERS, digits: int = 3) -> str:
    """The same as one text, in which a pure number has no unit."""
    number, name = printed(value, unit, units, digits)
    return number if name == NONE else f"{number} {name}"


@dataclass(frozen=True)
class Trace:
    """Values (N,) of one quantity in SI, with the look of its line; by default looks follow one another."""

    label: str
    values: Array
    look: str = ""
    limits: tuple[float, ...] = ()


@dataclass(frozen=True)
class Panel:
    """Traces of one SI unit that share a figure; `span` is what its axis shows, in SI."""

    title: str
    unit: str
    traces: list[Trace] = field(default_factory=list)
    span: tuple[float, float] | None = None


def columns_of(panels: Iterable[Panel], units: Units = PRINTED) -> dict[str, Array]:
    """Columns of samples for these figures."""
    found: dict[str, Array] = {}
    for panel in panels:
        for trace in panel.traces:
            found[f"{panel.title} {trace.label}"] = shown(panel.unit, units)[1] * trace.values
    return found


def charts_of(panels: Iterable[Panel], units: Units = PRINTED) -> list[TimeChart]:
    """The figures over those columns, limits as broken lines."""
    made = []
    for panel in panels:
        unit, factor = shown(panel.unit, units)
        limits = dict.fromkeys(factor * bound for trace in panel.traces for bound in trace.limits if np.isfinite(bound))
        lines = tuple(ChartLine(f"{panel.title} {trace.label}", trace.label or panel.title,
                                trace.look or LOOKS[k % len(LOOKS)]) for k, trace in enumerate(panel.traces))
        span = None if panel.span is None else (factor * panel.span[0], factor * panel.span[1])
        made.append(TimeChart(f"{panel.title} [{unit}]", lines, limits=tuple(limits), span=span))
    return made


def positions(joints: Iterable[str], q: Array) -> MutableMapping[str, Array]:
    """Columns of joint positions (N, n) in SI, by which the machine moves."""
    return {f"{joint}.q": q[:, k] for k, joint in enumerate(joints)}
