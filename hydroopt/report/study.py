"""The page of a study: its summary in one figure and a few tables."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator, NullFormatter

from hydroopt.files import write_files
from hydroopt.report.figures import BLUE, GREEN, GREY, ORANGE, STYLE, WIDTH, svg
from hydroopt.report.numbers import NONE, plain, unit_text
from hydroopt.report.page import document
from hydroopt.study.study import Study
from hydroopt.study.table import Table

SCHEMA = 1
"""Version of summary.json; it changes when a key changes its meaning or goes."""

COLOURS = (BLUE, ORANGE, GREEN, GREY)
TITLES = {"montecarlo": "Monte Carlo", "sweep": "sweep", "bootstrap": "block bootstrap", "multistart": "random starts"}


def save(study: Study, table: Table, summary: Mapping[str, Any], directory: str | Path) -> dict[str, Any]:
    """Write ``summary.json`` and ``report.html`` beside the cells.

    Returns:
        The content of summary.json.

    Raises:
        ProblemError: the directory cannot be written.
    """
    settings = study.identity
    content = {"schema": SCHEMA, "study": study.name,
               "machine": {"name": settings["machine"], "sha256": settings["machine_sha256"]}, "cells": len(table),
               "failed": len(table) - len(table.results), "settings": settings, **summary}
    write_files(directory, {"report.html": render(content, table),
                            "summary.json": json.dumps(content, indent=1, allow_nan=False)})
    return content


def render(content: Mapping[str, Any], table: Table) -> str:
    """The report as one HTML page that needs nothing else.

    Args:
        content: of summary.json.
        table: of the cells.
    """
    kind = content["study"]
    figure = {"montecarlo": _trials, "sweep": _sweep, "bootstrap": _bootstrap, "multistart": _starts}[kind](
        content, table)
    return document(
        "study.html", content=content, kind=kind, title=TITLES[kind], none=NONE, number=_number, unit=unit_text,
        figure=Markup(svg(figure, kind)), failures=_failures(content),
        settings=[(key, _word(value)) for key, value in content["settings"].items()])


def _number(value: float | None, digits: int = 4) -> str:
    return NONE if value is None else plain(value, digits)


def _word(value: Any) -> str:
    return str(value) if isinstance(value, str) else str(value).strip("{}[]").replace("'", "")


def _failures(content: Mapping[str, Any]) -> list[str]:
    failures = [one for part in content.get("points", [content]) for one in part["failures"]]
    return [f"{len(one['cells'])} cells failed: {one['error']}" for one in failures]


def _trials(content: Mapping[str, Any], table: Table) -> Figure:
    """Coverage of every parameter, and the distribution of the errors of validation forces."""
    (point,) = content["points"]
    rows = [row for row in point["parameters"] if row["coverage"] is not None]
    actuators = list(point["prediction"])
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, 3.4))
        left, right = figure.subplots(1, 2, gridspec_kw={"width_ratios": (1.6, 1.0)})
        if rows:
            half = point["coverage_half_width"]
            left.axhspan(100 * (0.95 - half), min(100 * (0.95 + half), 100), color=GREEN, alpha=0.13, lw=0)
            left.axhline(95, color=GREY, lw=0.8)
            left.plot([100 * row["coverage"] for row in rows], ls="none", marker="o", ms=3.2, color=BLUE)
        left.set(title="coverage of 95 % intervals; shaded: 95 % within chance", ylabel="%",
                 xlabel="parameter, in the order of the table")
        for colour, name in zip(_cycle(len(actuators)), actuators, strict=True):
            values = table.column(f"{name}.rms")
            values = np.sort(values[np.isfinite(values)])
            if values.size:
                right.step(values, np.arange(1, len(values) + 1) / len(values) * 100, color=colour, label=name)
        right.set(title="RMS error of noise-free validation forces", xlabel="σ of the force's sensors",
                  ylabel="cells up to here [%]")
        right.set_xlim(left=0)
        left.xaxis.set_major_locator(MaxNLocator(integer=True))
        right.legend(loc="lower right")
        figure.subplots_adjust(left=0.06, right=0.99, top=0.9, bottom=0.14, wspace=0.18)
    return figure


def _sweep(content: Mapping[str, Any], table: Table) -> Figure:
    """Prediction and coverage over the first quantity varied, a line for each combination of the others."""
    del table
    points = content["points"]
    names = list(content["settings"]["vary"])
    first, others = names[0], names[1:]
    lines: dict[str, list[Mapping[str, Any]]] = {}
    for point in points:
        lines.setdefault(", ".join(f"{key} {point['values'][key]:g}" for key in others), []).append(point)
    actuators = list(points[0]["prediction"])
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, 3.2))
        axes = figure.subplots(1, len(actuators) + 1, squeeze=False)[0]
        for colour, (label, some) in zip(_cycle(len(lines)), lines.items(), strict=True):
            x = [point["values"][first] for point in some]
            for ax, name in zip(axes, actuators, strict=False):
                low, middle, high = (_floats(point["prediction"][name][key] for point in some)
                                     for key in ("q05", "median", "q95"))
                ax.fill_between(x, low, high, color=colour, alpha=0.15, lw=0)
                ax.plot(x, middle, color=colour, marker="o", ms=3.5, label=label)
                ax.set(title=name, xlabel=first, ylabel="RMS error of validation forces [σ]")
                ax.set_ylim(bottom=0)
            axes[-1].plot(x, 100 * _floats(point["coverage"] for point in some), color=colour, marker="o", ms=3.5)
        axes[-1].axhline(95, color=GREY, lw=0.8)
        axes[-1].set(title="coverage of 95 % intervals", xlabel=first, ylabel="%")
        if others:
            axes[0].legend()
        figure.subplots_adjust(left=0.06, right=0.99, top=0.9, bottom=0.15, wspace=0.25)
    return figure


def _bootstrap(content: Mapping[str, Any], table: Table) -> Figure:
    """Scatter over stated σ of parameters and base parameters."""
    del table
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, 3.0))
        axes = figure.subplots(1, 2, sharey=True)
        for ax, key, title in zip(axes, ("parameters", "base_parameters"), ("parameters", "base parameters"),
                                  strict=True):
            ax.axhline(1, color=GREY, lw=0.8)
            ax.plot(_floats(row["scatter_over_stated"] for row in content[key]), ls="none", marker="o", ms=3.2,
                    color=BLUE)
            ax.set(title=title, xlabel="in the order of the table")
        axes[0].set_ylabel("scatter / stated σ")
        axes[0].set_ylim(bottom=0)
        figure.subplots_adjust(left=0.06, right=0.99, top=0.9, bottom=0.15, wspace=0.05)
    return figure


def _starts(content: Mapping[str, Any], table: Table) -> Figure:
    """Squared errors of the optima over the starts, the best first, and the ranges of the parameters."""
    rows = [row for row in content["parameters"] if row["std"]]
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, 3.2))
        left, right = figure.subplots(1, 2, gridspec_kw={"width_ratios": (1.0, 1.6)})
        costs = np.sort(table.column("cost"))
        left.plot(costs, color=BLUE, marker="o", ms=3.2)
        left.set(title="squared errors at the optima", xlabel="start, the best first",
                 yscale="log" if costs[-1] > 10 * costs[0] > 0 else "linear")
        for key in ("lowest_std", "highest_std"):
            right.plot([row[key] for row in rows], ls="none", marker="_", color=BLUE)
        right.axhline(0, color=GREY, lw=0.8)
        right.set(title="range about the best", xlabel="parameter, in the order of the table",
                  ylabel="standard deviations", yscale="symlog")
        for ax in (left, right):  # powers of ten would appear as TeX
            ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
            ax.yaxis.set_minor_formatter(NullFormatter())
            ax.xaxis.set_major_locator(MaxNLocator(integer=True))
        figure.subplots_adjust(left=0.07, right=0.99, top=0.9, bottom=0.15, wspace=0.2)
    return figure


def _cycle(count: int) -> list[str]:
    return [COLOURS[k % len(COLOURS)] for k in range(count)]


def _floats(values: Any) -> Any:
    some: Sequence[float | None] = list(values)
    return np.array([math.nan if value is None else value for value in some])
