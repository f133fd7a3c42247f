"""The report of identified valves and oil: free runs beside the readings; computes nothing."""

from __future__ import annotations

from itertools import groupby
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from markupsafe import Markup

from hydroopt.report import hydraulics
from hydroopt.report.charts import Chart, Line, TimeChart
from hydroopt.report.intervals import interval
from hydroopt.report.numbers import NONE, Row, percent, plain, unit_text
from hydroopt.report.page import document
from hydroopt.report.panels import SMALL, printed
from hydroopt.report.samples import Recording, joined
from hydroopt.report.scene import SceneView

if TYPE_CHECKING:
    from hydroopt.estimation.hydraulic.estimate import HydraulicEstimate
    from hydroopt.results.fit import Fit

class Parameter(NamedTuple):
    """One line of the parameter table."""

    name: str
    unit: str
    numbers: Row
    identifiability: str
    bound: str
    figure: Markup


def render(estimate: HydraulicEstimate) -> str:
    """The report as one HTML page that needs nothing else."""
    problem, found = estimate.problem, estimate.adjustment
    lines = [Parameter(name, *printed(each), each.identifiability, each.bound or "", interval(each))
             for name, each in estimate.parameters.items()]
    machine = problem.plant.machine
    return document(
        "valves.html", samples=joined(_recordings(estimate)), charts=_charts(estimate), verdict=estimate.verdict,
        scene=SceneView(problem.plant.model.scene_graph, tuple(f"{joint}.q" for joint in machine.joints)),
        machine=machine,
        estimate=estimate, diagnostics=estimate.diagnostics,
        hydraulics=hydraulics.rows(problem.plant, estimate.sweeps) if estimate.sweeps else None, fit=_fit(estimate),
        groups=[(owner, list(rows)) for owner, rows in groupby(lines, lambda p: p.name.rpartition(".")[0])],
        counts={kind: sum(p.identifiability == kind for p in lines) for kind in ("full", "combination", "none")},
        balances=[(name, plain(misfit, 3), plain(6e4 * density, 3)) for name, misfit, density in zip(
            estimate.actuators, found.misfit, found.density, strict=True)],
        logs=[(role, log.path or log.name, log.size, plain(log.duration), log.sha256, [f.text for f in log.findings])
              for role, logs in (("training", problem.logs), ("validation", problem.validation)) for log in logs])


def _or_nan(value: float | None) -> float:
    return np.nan if value is None else value


def _in_print(value: float, unit: str) -> tuple[str, str]:
    name, factor = SMALL.get(unit, (unit_text(unit), 1.0))
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


def _commands(estimate: HydraulicEstimate) -> list[str]:
    return list(estimate.problem.plant.inputs)


def _recordings(estimate: HydraulicEstimate) -> list[Recording]:
    """Commands, joint positions of the free run, and each channel measured and in free run, of all stretches."""
    problem = estimate.problem
    machine, states = problem.plant.machine, problem.plant.states
    found = []
    for role, runs in estimate.runs.items():
        for run in runs:
            columns = {f"{joint}.q": run.states[:, states.index(f"{joint}.q")] for joint in machine.joints}
            columns |= {f"{name} command": run.u[:, k] for k, name in enumerate(_commands(estimate))}
            for k, channel in enumerate(problem.channels):
                factor = SMALL.get(machine.channel_units[channel], ("", 1.0))[1]
                columns |= {f"{channel} measured": factor * run.y[:, k],
                            f"{channel} free": factor * run.outputs[:, k]}
            found.append(Recording("training" if role == "train" else role, role, run.t,
                                   np.zeros(len(run.t), dtype=np.int64), columns))
    return found


def _charts(estimate: HydraulicEstimate) -> dict[str, list[Chart]]:
    """Commands, and every channel measured and in free run."""
    problem, units = estimate.problem, estimate.problem.plant.machine.channel_units

    def unit(name: str) -> str:
        return SMALL.get(units[name], (unit_text(units[name]), 1.0))[0]

    free: list[Chart] = [TimeChart(f"{channel} [{unit(channel)}]", (
        Line(f"{channel} measured", "measured", "measured"), Line(f"{channel} free", "free run")))
        for channel in problem.channels]
    commands: list[Chart] = [TimeChart(f"{name} [{unit(name)}]", (Line(f"{name} command", name, "third"),))
                             for name in _commands(estimate)]
    shown = {"free": free, "commands": commands}
    if estimate.sweeps:
        shown["hydraulics"] = [*hydraulics.charts(problem.plant, estimate.sweeps)]
    return shown
