"""The report of identified valves and oil: free runs beside the readings; computes nothing."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

import numpy as np

from hydroopt.report import hydraulics
from hydroopt.report.charts import Chart, Line, TimeChart
from hydroopt.report.numbers import plain
from hydroopt.report.page import document
from hydroopt.report.panels import NUMBERS, SMALL, shown
from hydroopt.report.samples import Recording, joined
from hydroopt.report.scene import SceneView
from hydroopt.report.tables import by_owner, fit_rows

if TYPE_CHECKING:
    from hydroopt.estimation.hydraulic.estimate import HydraulicEstimate


def render(estimate: HydraulicEstimate) -> str:
    """The report as one HTML page that needs nothing else."""
    problem, found = estimate.problem, estimate.adjustment
    machine = problem.plant.machine
    return document(
        "valves.html", samples=joined(_recordings(estimate)), charts=_charts(estimate), answer=estimate,
        scene=SceneView(problem.plant.model.scene_graph, tuple(f"{joint}.q" for joint in machine.joints)),
        machine=machine, estimate=estimate,
        hydraulics=hydraulics.rows(problem.plant, estimate.sweeps) if estimate.sweeps else None,
        fit=fit_rows(estimate.fit, SMALL, 3),
        groups=list(by_owner(estimate.parameters, NUMBERS).items()),
        counts=Counter(each.identifiability for each in estimate.parameters.rows),
        balances=[(name, plain(misfit, 3), plain(6e4 * density, 3)) for name, misfit, density in zip(
            estimate.actuators, found.misfit, found.density, strict=True)],
        logs=[(role, log.path or log.name, log.size, plain(log.duration), log.sha256, [f.text for f in log.findings])
              for role, logs in (("training", problem.logs), ("validation", problem.validation)) for log in logs])


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
                _, factor = shown(machine.channel_units[channel], SMALL)
                columns |= {f"{channel} measured": factor * run.y[:, k],
                            f"{channel} free": factor * run.outputs[:, k]}
            found.append(Recording("training" if role == "train" else role, role, run.t,
                                   np.zeros(len(run.t), dtype=np.int64), columns))
    return found


def _charts(estimate: HydraulicEstimate) -> dict[str, list[Chart]]:
    """Commands, and every channel measured and in free run."""
    problem, units = estimate.problem, estimate.problem.plant.machine.channel_units

    def unit(name: str) -> str:
        return shown(units[name], SMALL)[0]

    free: list[Chart] = [TimeChart(f"{channel} [{unit(channel)}]", (
        Line(f"{channel} measured", "measured", "measured"), Line(f"{channel} free", "free run")))
        for channel in problem.channels]
    commands: list[Chart] = [TimeChart(f"{name} [{unit(name)}]", (Line(f"{name} command", name, "third"),))
                             for name in _commands(estimate)]
    made = {"free": free, "commands": commands}
    if estimate.sweeps:
        made["hydraulics"] = [*hydraulics.charts(problem.plant, estimate.sweeps)]
    return made
