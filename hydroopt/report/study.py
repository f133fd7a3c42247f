"""The page of a study: its summary in one figure and a few tables."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence, Sized
from functools import partial
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np

from hydroopt.report.charts import LOOKS, Curves
from hydroopt.report.numbers import NONE, plain, unit_text
from hydroopt.report.page import document
from hydroopt.spatial.inertia import Array
from hydroopt.study.study import Study
from hydroopt.study.table import Table
from hydroopt.support.files import write_files

SCHEMA = 1
"""Version of summary.json; it changes when a key changes its meaning or goes."""

ORDER = "parameter, in the order of the table"
TITLES = {"montecarlo": "Monte Carlo", "sweep": "sweep", "bootstrap": "block bootstrap"}


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
    charts = {"montecarlo": _trials, "sweep": _sweep, "bootstrap": _bootstrap}[kind](
        content, table)
    return document(
        "study.html", charts={"study": charts}, content=content,
        kind=kind, title=TITLES[kind], none=NONE, number=_number, unit=unit_text,
        failures=_failures(content),
        settings=[(key, _word(value)) for key, value in content["settings"].items()])


def _number(value: float | None, digits: int = 4) -> str:
    return NONE if value is None else plain(value, digits)


def _word(value: Any) -> str:
    return str(value) if isinstance(value, str) else str(value).strip("{}[]").replace("'", "")


def _failures(content: Mapping[str, Any]) -> list[str]:
    failures = [one for part in content.get("points", [content]) for one in part["failures"]]
    return [f"{len(one['cells'])} cells failed: {one['error']}" for one in failures]


def _trials(content: Mapping[str, Any], table: Table) -> list[Curves]:
    """Coverage of every parameter, and the distribution of the errors of validation forces."""
    (point,) = content["points"]
    rows, made = [row for row in point["parameters"] if row["coverage"] is not None], []
    if rows:
        half = point["coverage_half_width"]
        made.append(Curves("coverage of 95 % intervals [%], and 95 % within chance", ORDER, _numbers(rows), (
            ("coverage", "predicted", np.array([100 * row["coverage"] for row in rows])),), dots=True,
            limits=(100 * (0.95 - half), 95.0, min(100 * (0.95 + half), 100.0))))
    for name in point["prediction"]:
        values = table.column(f"{name}.rms")
        values = np.sort(values[np.isfinite(values)])
        if values.size > 1:
            made.append(Curves(f"{name}: cells up to this error [%]", "RMS error of noise-free validation forces [σ]",
                               values, (("cells", "predicted", np.arange(1, len(values) + 1) / len(values) * 100),)))
    return made


def _sweep(content: Mapping[str, Any], table: Table) -> list[Curves]:
    """Prediction and coverage over the first quantity varied, a line for each combination of the others."""
    del table
    points, names = content["points"], list(content["settings"]["vary"])
    first, others = names[0], names[1:]
    lines: dict[str, list[Mapping[str, Any]]] = {}
    for point in points:
        label = ", ".join(f"{key} {point['values'][key]:g}" for key in others)
        lines.setdefault(label or "median", []).append(point)
    x = np.array(sorted({float(point["values"][first]) for point in points}))

    def over(some: Sequence[Mapping[str, Any]], value: Callable[[Mapping[str, Any]], float | None]) -> Array:
        known = {float(point["values"][first]): value(point) for point in some}
        return _floats(known.get(float(at)) for at in x)

    made = []
    for name in points[0]["prediction"]:
        q05, median, q95 = ({label: over(some, partial(_prediction, name, key)) for label, some in lines.items()}
                            for key in ("q05", "median", "q95"))
        made.append(Curves(f"{name}: RMS error of validation forces [σ]", first, x, tuple(
            (label, look, values) for (label, values), look in zip(median.items(), cycle(LOOKS), strict=False)),
            bands=tuple((look, low, high) for low, high, look in zip(q05.values(), q95.values(), cycle(LOOKS),
                                                                      strict=False))))
    return [*made, Curves("coverage of 95 % intervals [%]", first, x, tuple(
        (label, look, 100 * over(some, lambda point: point["coverage"]))
        for (label, some), look in zip(lines.items(), cycle(LOOKS), strict=False)), limits=(95.0,))]


def _prediction(name: str, key: str, point: Mapping[str, Any]) -> float | None:
    found: float | None = point["prediction"][name][key]
    return found


def _bootstrap(content: Mapping[str, Any], table: Table) -> list[Curves]:
    """Scatter over stated σ of parameters and base parameters."""
    del table
    return [Curves(f"{title}: scatter / stated σ", ORDER, _numbers(content[key]), (
        ("scatter / stated σ", "predicted", _floats(row["scatter_over_stated"] for row in content[key])),),
        limits=(1.0,), dots=True) for key, title in (("parameters", "parameters"),
                                                     ("base_parameters", "base parameters"))]


def _numbers(rows: Sized) -> Array:
    return np.arange(1.0, len(rows) + 1)


def _floats(values: Iterable[float | None]) -> Array:
    return np.array([math.nan if value is None else value for value in values])
