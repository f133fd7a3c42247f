"""The folder of two sessions compared: comparison.json, its table, and a page with a figure; computes nothing."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure

from hydroopt.errors import HydrooptError
from hydroopt.estimation.dynamic.change import Change, Difference
from hydroopt.estimation.dynamic.payload import Payload, Quantity
from hydroopt.estimation.dynamic.stored_information import Session
from hydroopt.files import write_files
from hydroopt.machine.machine import Machine
from hydroopt.report.figures import BLUE, GREY, ORANGE, STYLE, WIDTH, svg
from hydroopt.report.numbers import NONE, plain, quantity, unit_text
from hydroopt.report.page import page
from hydroopt.report.record import SCHEMA, flat, machine_entry, now, number, table
from hydroopt.versions import versions

FILES = ("comparison.json", "report.html", "comparison.csv")
"""Files of a comparison, which the next one replaces."""

COLUMNS = 3


def save(result: Change | Payload, directory: str | Path, *, wall_s: float = float("nan")) -> dict[str, Any]:
    """Write what two sessions show: comparison.json, report.html and the numbers as comparison.csv.

    Each file appears complete or not at all.

    Returns:
        The content of comparison.json.

    Raises:
        ProblemError: the directory cannot be written.
    """
    content = as_dict(result, wall_s)
    names = ("quantities", "friction", "gains") if isinstance(result, Payload) else ("differences",)
    write_files(directory, {"report.html": render(result),
                            "comparison.csv": table([flat(row) for name in names for row in content[name]]),
                            "comparison.json": json.dumps(content, indent=1, allow_nan=False)})
    return content


def save_failure(machine: Machine, error: HydrooptError, directory: str | Path) -> dict[str, Any]:
    """Write a comparison.json that says why there is no comparison; nothing else.

    Raises:
        ProblemError: the directory cannot be written.
    """
    content = {"schema": SCHEMA, "machine": machine_entry(machine), "created": now(), "versions": versions(),
               "status": "failed", "reason": str(error)}
    for name in FILES:
        with contextlib.suppress(OSError):
            (Path(directory) / name).unlink()
    write_files(directory, {"comparison.json": json.dumps(content, indent=1, allow_nan=False)})
    return content


def as_dict(result: Change | Payload, wall_s: float = float("nan")) -> dict[str, Any]:
    """The content of comparison.json; numbers that do not exist are null."""
    machine = result.machine
    head = {"schema": SCHEMA, "kind": "payload" if isinstance(result, Payload) else "change",
            "status": "ok",
            "machine": machine_entry(machine), "created": now(), "versions": versions(),
            "before": _session(machine, result.before), "after": _session(machine, result.after),
            "test": {"statistic": result.statistic, "rank": result.rank, "degrees_of_freedom": result.freedom,
                     "p_value": result.p_value}, "verdicts": verdicts(result)}
    foot = {"notes": list(result.notes), "wall_s": number(wall_s)}
    if isinstance(result, Payload):
        return head | {"link": result.link,
                       "quantities": [_compared(one) for one in (result.mass, *result.com, *result.moment)],
                       "friction": [_compared(one) for one in result.friction],
                       "gains": [_compared(one) for one in result.gains]} | foot
    return head | {"level": result.level, "differences": [
        _compared(one) | {"p_value": number(one.p_value), "p_holm": number(one.p_holm),
                          "detectable": number(one.detectable), "changed": one.changed, "verdict": one.verdict}
        for one in result.differences]} | foot


def _compared(one: Difference | Quantity) -> dict[str, Any]:
    return {"name": one.name, "unit": one.unit, "value": number(one.value), "std": number(one.std),
            "ci95": list(one.ci95) if np.all(np.isfinite(one.ci95)) else None}


def _session(machine: Machine, one: Session) -> dict[str, Any]:
    return {"inputs": [dict(log) for log in one.inputs],
            "weights": {actuator.name: {"sigma": float(sigma), "correlation_time": float(time), "samples": int(samples)}
                        for actuator, sigma, time, samples in zip(machine.actuators, one.sigma, one.times, one.samples,
                                                                  strict=True)}}


def render(result: Change | Payload) -> str:
    """The report as one HTML page that needs nothing else."""
    rows = quantities(result)
    drawn = differences(rows)
    said, load = verdicts(result), isinstance(result, Payload)
    return page("comparison.html").render(
        machine=result.machine, title="load" if load else "what has changed", load=load, said=said,
        link=result.link if isinstance(result, Payload) else "", notes=list(result.notes), rank=result.rank,
        statistic=plain(result.statistic, 3), freedom=plain(result.freedom, 3), p=f"{result.p_value:.2g}",
        rows=[_row(one) for one in rows], figure=Markup(svg(drawn, "differences")) if drawn is not None else "",
        logs=[_logs("before" if not load else "without the load", result.before, result.machine),
              _logs("after" if not load else "with the load", result.after, result.machine)])


def quantities(result: Change | Payload) -> Sequence[Difference | Quantity]:
    """All numbers of a comparison, in the order of its table."""
    if isinstance(result, Change):
        return result.differences
    return (result.mass, *result.com, *result.moment, *result.friction, *result.gains)


def verdicts(result: Change | Payload) -> list[str]:
    """What a comparison found, in sentences."""
    if isinstance(result, Payload):
        return [result.verdict]
    return [said for said in (result.verdict, result.explanation) if said]


def differences(rows: Sequence[Difference | Quantity]) -> Figure | None:
    """Values with their 95 % intervals, a panel for each unit; what has changed stands out."""
    units: dict[str, list[Difference | Quantity]] = {}
    for one in rows:
        if np.isfinite(one.std):
            units.setdefault(one.unit, []).append(one)
    if not units:
        return None
    columns = min(COLUMNS, len(units))
    lines = -(-len(units) // columns)
    height = lines * (0.24 * max(map(len, units.values())) + 0.75)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, height))
        axes = np.asarray(figure.subplots(lines, columns, squeeze=False)).ravel()
        for ax, (unit, some) in zip(axes, units.items(), strict=False):
            at = np.arange(len(some))
            colours = [ORANGE if getattr(one, "changed", False) else BLUE for one in some]
            ax.axvline(0, color=GREY, lw=0.8)
            ax.hlines(at, [one.ci95[0] for one in some], [one.ci95[1] for one in some], colors=colours, lw=1.6)
            ax.scatter([one.value for one in some], at, s=16, c=colours, zorder=3)
            ax.set_yticks(at, [one.name for one in some])
            ax.set(ylim=(len(some) - 0.4, -0.6), xlabel="part of the reading" if unit == "1" else unit_text(unit))
            ax.grid(axis="y", visible=False)
        for ax in axes[len(units):]:
            ax.set_visible(False)
        figure.tight_layout()
    return figure


def _row(one: Difference | Quantity) -> dict[str, Any]:
    shown = quantity(one.value, one.std, one.ci95)
    row = {"name": one.name, "unit": unit_text(one.unit), "value": shown.value, "std": shown.std,
           "interval": shown.interval}
    if isinstance(one, Quantity):
        return row
    return row | {"p": f"{one.p_holm:.2g}" if np.isfinite(one.p_holm) else NONE, "changed": one.changed,
                  "detectable": plain(one.detectable, 2), "verdict": one.verdict}


def _logs(role: str, session: Session, machine: Machine) -> dict[str, Any]:
    return {"role": role, "inputs": session.inputs,
            "weights": [(actuator.name, plain(s), plain(t, 3), int(n)) for actuator, s, t, n in
                        zip(machine.actuators, session.sigma, session.times, session.samples, strict=True)]}
