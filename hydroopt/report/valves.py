"""The report of identified valves and oil: free runs beside the readings; computes nothing."""

from __future__ import annotations

from itertools import groupby
from typing import TYPE_CHECKING, Any, NamedTuple

import matplotlib
import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from hydroopt.report.figures import BLUE, GREY, ORANGE, STYLE, WIDTH, changes, changes_of, svg, thin
from hydroopt.report.hydraulics import section
from hydroopt.report.numbers import NONE, Row, percent, plain, quantity, unit_text
from hydroopt.report.page import document

if TYPE_CHECKING:
    from hydroopt.estimation.hydraulic.estimate import HydraulicEstimate, Run
    from hydroopt.results.fit import Fit

PRINTED = {"rad": ("deg", 180 / np.pi), "m": ("mm", 1e3), "Pa": ("bar", 1e-5)}
"""Units that a reader prefers, and what SI is multiplied by."""


class Parameter(NamedTuple):
    """One line of the parameter table."""

    name: str
    unit: str
    numbers: Row
    identifiability: str
    bound: str


def render(estimate: HydraulicEstimate) -> str:
    """The report as one HTML page that needs nothing else."""
    problem, found = estimate.problem, estimate.shooting
    lines = [Parameter(name, unit_text(each.unit), quantity(
        _or_nan(each.value), _or_nan(each.std), each.ci95 or (np.nan, np.nan), _or_nan(each.nominal)),
        each.identifiability, each.bound or "") for name, each in estimate.parameters.items()]
    drawn = {"runs": free_runs(estimate), "changes": changes(changes_of(estimate.parameters))}
    return document(
        "valves.html", machine=problem.plant.machine, estimate=estimate, diagnostics=estimate.diagnostics,
        hydraulics=section(problem.plant, estimate.sweeps) if estimate.sweeps else None, fit=_fit(estimate),
        bodies=problem.bodies.shape[1],
        groups=[(owner, list(rows)) for owner, rows in groupby(lines, lambda p: p.name.rpartition(".")[0])],
        counts={kind: sum(p.identifiability == kind for p in lines) for kind in ("full", "combination", "none")},
        figures={name: Markup(svg(figure, name)) for name, figure in drawn.items() if figure is not None},
        weights=[(channel, *_in_print(sigma, unit), plain(misfit, 3)) for channel, sigma, unit, misfit in zip(
            problem.channels, found.problem.sigma, (problem.plant.machine.channel_units[c] for c in problem.channels),
            estimate.misfit, strict=True)],
        logs=[(role, log.path or log.name, log.size, plain(log.duration), log.sha256, [f.text for f in log.findings])
              for role, logs in (("training", problem.logs), ("validation", problem.validation)) for log in logs])


def _or_nan(value: float | None) -> float:
    return np.nan if value is None else value


def _in_print(value: float, unit: str) -> tuple[str, str]:
    name, factor = PRINTED.get(unit, (unit_text(unit), 1.0))
    return plain(factor * value, 3), name


def _fit(estimate: HydraulicEstimate) -> list[dict[str, Any]]:
    """Rows of the fit table: channel, unit, and the cells of training and validation."""
    sets = [estimate.fit.get(name, {}) for name in ("train", "validation")]
    return [{"channel": channel, "unit": _in_print(1.0, next(t[channel].unit for t in sets if channel in t))[1],
             "cells": [_cells(each.get(channel)) for each in sets]}
            for channel in estimate.problem.channels if any(channel in each for each in sets)]


def _cells(fit: Fit | None) -> tuple[str, str, str, str]:
    """RMS, largest error, RMS as a part of the range [%], and VAF [%]."""
    if fit is None:
        return NONE, NONE, NONE, NONE
    return (_in_print(fit.rms, fit.unit)[0], _in_print(_or_nan(fit.largest), fit.unit)[0],
            percent(_or_nan(fit.of_range)),
            percent(fit.vaf))


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
