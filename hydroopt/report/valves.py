"""The folder and the report of identified valves and oil: free runs beside what was measured; computes nothing."""

from __future__ import annotations

import json
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from hydroopt.errors import HydrooptError
from hydroopt.estimation.hydraulic.estimate import FreeRun, HydraulicEstimate, Run
from hydroopt.estimation.hydraulic.problem import HydraulicProblem
from hydroopt.files import write_files
from hydroopt.machine.machine_file import dump_machine
from hydroopt.report.figures import BLUE, GREY, ORANGE, STYLE, WIDTH, Change, changes, svg, thin
from hydroopt.report.folder import forget
from hydroopt.report.hydraulics import over_workspace
from hydroopt.report.numbers import NONE, Row, percent, plain, quantity, unit_text
from hydroopt.report.page import page
from hydroopt.report.record import SCHEMA, flat, machine_entry, now, number, table
from hydroopt.versions import versions

METHOD = "multiple shooting"
PRINTED = {"rad": ("deg", 180 / np.pi), "m": ("mm", 1e3), "Pa": ("bar", 1e-5)}
"""Units that a reader prefers, and what SI is multiplied by."""


class Parameter(NamedTuple):
    """One line of the parameter table."""

    name: str
    unit: str
    numbers: Row
    identifiability: str
    bound: str


def save(estimate: HydraulicEstimate, directory: str | Path, *, wall_s: float = float("nan")) -> dict[str, Any]:
    """Write everything about an estimate; each file appears complete or not at all, estimate.json last.

    Returns:
        The content of estimate.json.

    Raises:
        ProblemError: the directory cannot be written.
        SolverError: a free run came to no end.
    """
    content = as_dict(estimate, wall_s)
    machine_file = f"{estimate.problem.plant.machine.name}.toml"
    files = {"report.html": render(estimate), machine_file: dump_machine(estimate.machine),
             "parameters.csv": table([flat(row) for row in content["parameters"]]),
             "fit.csv": table([{"data": data, "channel": channel, **one} for data, channels in content["fit"].items()
                               for channel, one in channels.items()]),
             "free_run.csv": table(list(_samples(estimate)))}
    forget(directory, machine_file)
    write_files(directory, files | {"estimate.json": json.dumps(content, indent=1, allow_nan=False)})
    return content


def save_failure(problem: HydraulicProblem, error: HydrooptError, directory: str | Path) -> dict[str, Any]:
    """Write an estimate.json that says why there is no estimate; nothing else.

    Raises:
        ProblemError: the directory cannot be written.
    """
    content = _origin(problem) | {"status": "failed", "reason": str(error)}
    forget(directory, f"{problem.plant.machine.name}.toml")
    write_files(directory, {"estimate.json": json.dumps(content, indent=1, allow_nan=False)})
    return content


def as_dict(estimate: HydraulicEstimate, wall_s: float = float("nan")) -> dict[str, Any]:
    """The content of estimate.json; numbers that do not exist are null."""
    problem, found = estimate.problem, estimate.shooting
    parameters, units = problem.parameters, problem.plant.machine.channel_units
    rows = [{"name": name, "unit": parameters.units[k], "nominal": float(parameters.nominal[k]),
             "value": float(found.theta[k]), "std": number(found.std[k]),
             "ci95": [float(v) for v in found.ci95[k]] if np.all(np.isfinite(found.ci95[k])) else None,
             "bound": _bound(estimate, k) or None, "identifiability": found.category(name)}
            for k, name in enumerate(parameters.names)]
    told = np.linalg.eigvalsh(found.data * np.outer(parameters.scale, parameters.scale))
    return _origin(problem) | {
        "status": estimate.status, "parameters": rows, "base_parameters": [],
        "fit": {data: {channel: {"rms": number(fit.rms), "vaf": number(fit.vaf), "relative": number(fit.relative),
                                 "unit": fit.unit, "largest": number(fit.largest), "of_range": number(fit.of_range)}
                       for channel, fit in channels.items()} for data, channels in estimate.fit.items()},
        "conditioning": {"rank": int(np.sum(told > 1e-12 * told[-1])), "parameters": len(parameters),
                         "condition_number": number(np.sqrt(told[-1] / told[0]) if told[0] > 0 else np.inf),
                         "residual_scale": number(found.residual_scale)},
        "physical_consistency": {},
        "weights": {channel: {"sigma": float(sigma), "sensor_sigma": float(sensor), "unit": units[channel]}
                    for channel, sigma, sensor in zip(problem.channels, found.problem.sigma, problem.sigma,
                                                      strict=True)},
        "doubts": list(estimate.doubts), "wall_s": number(wall_s)}


def _origin(problem: HydraulicProblem) -> dict[str, Any]:
    inputs = [{"path": log.path or log.name, "sha256": log.sha256 or None, "samples": log.size, "role": role,
               "first_sample": log.rows[0], "last_sample": log.rows[1], "findings": [f.text for f in log.findings]}
              for role, logs in (("train", problem.logs), ("validation", problem.validation)) for log in logs]
    return {"schema": SCHEMA, "machine": machine_entry(problem.plant.machine), "created": now(), "inputs": inputs,
            "method": METHOD, "versions": versions()}


def _bound(estimate: HydraulicEstimate, k: int) -> str:
    parameters, value = estimate.problem.parameters, estimate.shooting.theta[k]
    if not estimate.shooting.at_bound[k]:
        return ""
    low = value - parameters.lower[k] < parameters.upper[k] - value
    return (f"{parameters.names[k]} {'>=' if low else '<='} {parameters.lower[k] if low else parameters.upper[k]:.9g} "
            f"{parameters.units[k]}")


def _samples(estimate: HydraulicEstimate) -> Iterator[dict[str, Any]]:
    """Every sample of all logs: commands, what was measured, and the free run, in SI."""
    problem = estimate.problem
    inputs = estimate.shooting.problem.dynamics.inputs
    for data, runs in estimate.runs.items():
        for k, run in enumerate(runs):
            for i, t in enumerate(run.record.t):
                row: dict[str, Any] = {"data": data, "stretch": k + 1, "t [s]": float(t)}
                row |= {name: float(u) for name, u in zip(inputs, run.record.u[i], strict=True)}
                for channel, read, value in zip(problem.channels, run.record.y[i], run.outputs[i], strict=True):
                    row |= {channel: number(read), f"{channel} free": float(value)}
                yield row


def render(estimate: HydraulicEstimate) -> str:
    """The report as one HTML page that needs nothing else."""
    problem, found = estimate.problem, estimate.shooting
    parameters = problem.parameters
    lines = [Parameter(name, unit_text(parameters.units[k]),
                       quantity(float(found.theta[k]), float(found.std[k]), (float(found.ci95[k, 0]),
                                float(found.ci95[k, 1])), float(parameters.nominal[k])), found.category(name),
                       _bound(estimate, k)) for k, name in enumerate(parameters.names)]
    drawn = {"runs": free_runs(estimate), "changes": changes(_changes(estimate))}
    psi, theta = (np.asarray(part).ravel() for part in problem.split(found.theta))
    return page("valves.html").render(
        machine=problem.plant.machine, estimate=estimate, doubts=estimate.doubts, failed=estimate.status != "ok",
        method=METHOD, hydraulics=over_workspace(problem.plant, psi, theta), fit=_fit(estimate),
        bodies=problem.bodies.shape[1],
        groups=[(owner, list(rows)) for owner, rows in groupby(lines, lambda p: p.name.rpartition(".")[0])],
        counts={kind: sum(p.identifiability == kind for p in lines) for kind in ("full", "combination", "none")},
        figures={name: Markup(svg(figure, name)) for name, figure in drawn.items() if figure is not None},
        weights=[(channel, *_in_print(sigma, unit), plain(misfit, 3)) for channel, sigma, unit, misfit in zip(
            problem.channels, found.problem.sigma, (problem.plant.machine.channel_units[c] for c in problem.channels),
            estimate.misfit, strict=True)],
        logs=[(role, log.path or log.name, log.size, plain(log.duration), log.sha256, [f.text for f in log.findings])
              for role, logs in (("training", problem.logs), ("validation", problem.validation)) for log in logs])


def _in_print(value: float, unit: str) -> tuple[str, str]:
    name, factor = PRINTED.get(unit, (unit_text(unit), 1.0))
    return plain(factor * value, 3), name


def _fit(estimate: HydraulicEstimate) -> list[dict[str, Any]]:
    """Rows of the fit table: channel, unit, and the cells of training and validation."""
    sets = [estimate.fit.get(name, {}) for name in ("train", "validation")]
    return [{"channel": channel, "unit": _in_print(1.0, next(t[channel].unit for t in sets if channel in t))[1],
             "cells": [_cells(each.get(channel)) for each in sets]}
            for channel in estimate.problem.channels if any(channel in each for each in sets)]


def _cells(fit: FreeRun | None) -> tuple[str, str, str, str]:
    """RMS, largest error, RMS as a part of the range [%], and VAF [%]."""
    if fit is None:
        return NONE, NONE, NONE, NONE
    return (_in_print(fit.rms, fit.unit)[0], _in_print(fit.largest, fit.unit)[0], percent(fit.of_range),
            percent(fit.vaf))


def _changes(estimate: HydraulicEstimate) -> list[tuple[str, list[Change]]]:
    """Changes against the machine file, in standard deviations of its confidences."""
    parameters, found = estimate.problem.parameters, estimate.shooting
    groups: dict[str, list[Change]] = {}
    for k, name in enumerate(parameters.names):
        if np.all(np.isfinite(found.ci95[k])):
            change, low, high = ((float(x) - float(parameters.nominal[k])) / float(parameters.scale[k])
                                 for x in (found.theta[k], *found.ci95[k]))
            owner, _, element = name.rpartition(".")
            groups.setdefault(owner, []).append(Change(element, change, low, high, found.category(name) == "full",
                                                       True))
    return list(groups.items())


def free_runs(estimate: HydraulicEstimate) -> Figure:
    """Commands, and each channel measured and in free run, over all stretches one after the other."""
    problem = estimate.problem
    shown = [(role, run) for role, runs in estimate.runs.items() for run in runs]
    inputs = problem.plant.inputs
    units = problem.plant.machine.channel_units
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, 0.4 + 1.5 * (len(inputs) + len(problem.channels))), layout="constrained")
        axes = figure.subplots(len(inputs) + len(problem.channels), 1, sharex=True, squeeze=False)[:, 0]
        shift = 0.0
        for role, run in shown:
            t = run.record.t - run.record.t[0] + shift
            shift = float(t[-1]) + 0.02 * float(t[-1] - t[0])
            for ax, k in zip(axes, range(len(inputs)), strict=False):
                ax.plot(*thin(t, run.record.u[:, k]), color=GREY, drawstyle="steps-post")
            for k, ax in enumerate(axes[len(inputs) :]):
                _measured_and_free(ax, t, run, k, PRINTED.get(units[problem.channels[k]], ("", 1.0))[1],
                                   BLUE if role == "train" else ORANGE)
        for ax, name in zip(axes, (*inputs, *problem.channels), strict=True):
            ax.set(title=name, ylabel=PRINTED.get(units[name], (unit_text(units[name]),))[0])
        axes[-1].set_xlabel("time, stretches one after the other [s]")
        figure.legend(handles=[Line2D([], [], color=GREY, label="measured"),
                               Line2D([], [], color=BLUE, label="free run, training"),
                               Line2D([], [], color=ORANGE, label="free run, validation")][: 3 if len(
                                   estimate.runs["validation"]) else 2], loc="outside upper right", ncols=3)
    return figure


def _measured_and_free(ax: Any, t: Any, run: Run, k: int, factor: float, colour: str) -> None:
    ax.plot(*thin(t, factor * run.record.y[:, k]), color=GREY, lw=0.7)
    ax.plot(*thin(t, factor * run.outputs[:, k]), color=colour)
