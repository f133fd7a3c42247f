"""The page of loads that were weighed in motion: masses over time, statuses, and the machine; computes nothing."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from hydroopt.report.charts import Line, TimeChart
from hydroopt.report.numbers import quantity
from hydroopt.report.page import document
from hydroopt.report.panels import positions
from hydroopt.report.samples import Recording, joined
from hydroopt.report.scene import SceneView
from hydroopt.results.verdict import NORMAL
from hydroopt.weighing.course import Weighable

if TYPE_CHECKING:
    from hydroopt.weighing.weighing import LoadWeighed, Weighing


def render(weighing: Weighing) -> str:
    """The page; it needs nothing else."""
    model, table = weighing.scale.model, weighing.table
    machine = weighing.scale.machine
    good = np.array([each.status is Weighable.OK for each in weighing.readings])
    believed = {key: np.where(good, table[f"{key} [kg]"], np.nan) for key in ("mass", "low", "high")}
    unbelieved = np.where(good, np.nan, table["mass [kg]"])
    shown = np.concatenate([believed["low"][good], believed["high"][good], [0.0]])
    margin = 0.05 * weighing.scale.load.full_scale
    courses, recordings, first = {**believed, "not weighable": unbelieved, "misfit": table["misfit"]}, [], 0
    for each in weighing.logs:
        here = slice(first, first := first + len(each.readings))
        recordings.append(Recording("weighing", each.log.name, each.t, each.equations.smoothed.stretch, {
            **positions(machine.joints, each.equations.smoothed.q),
            **{key: values[here] for key, values in courses.items()}}))
    samples = joined(recordings)
    lines = (Line("mass", "mass"), Line("not weighable", "not weighable", "measured", dots=True))
    chart = TimeChart("mass [kg]", lines,
                      span=(float(shown.min() - margin), float(shown.max() + margin)),
                      shaded=(("predicted", "low", "high"),))
    misfit = TimeChart("residuals / expected residuals", (Line("misfit", "misfit"),), limits=(1.0,))
    return document(
        "weighing.html", samples=samples, charts={"course": [chart, misfit]}, answer=weighing,
        scene=SceneView(model.scene_graph, tuple(f"{joint}.q" for joint in machine.joints)), machine=machine,
        answers=[each.text for each in weighing.findings],
        loads=[_row(weighing, each) for each in weighing.loads],
        statuses=[(str(status), count) for status in Weighable
                  if (count := sum(each.status is status for each in weighing.readings))])


def _row(weighing: Weighing, load: LoadWeighed) -> dict[str, Any]:
    mass, std = load.mass, load.mass_std
    shown = quantity(mass, std, (mass - NORMAL * std, mass + NORMAL * std))
    centre, spread = weighing.centre(load.reading.weighed)
    cells = [quantity(value, sigma, (value - NORMAL * sigma, value + NORMAL * sigma))
             for value, sigma in zip(centre.tolist(), spread.tolist(), strict=True)] if load.ok else []
    return {"name": load.name, "ok": load.ok, "begin": f"{load.begin:.1f}", "end": f"{load.end:.1f}",
            "mass": shown.value, "std": shown.std, "interval": shown.interval, "status": str(load.reading.status),
            "centre": ", ".join(f"{each.value} ± {each.std}" for each in cells)}
