"""What the hydraulics make of every joint over the workspace: a table, figures, and a page of its own."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from hydroopt.report.charts import Curves
from hydroopt.report.page import document
from hydroopt.report.scene import SceneView

if TYPE_CHECKING:
    from hydroopt.model.plant import Plant
    from hydroopt.model.workspace import Sweep

KEYS = ("frequency", "damping", "gain")


def rows(plant: Plant, sweeps: Sequence[Sweep]) -> list[dict[str, Any]]:
    """One row a joint and direction: what was found in the middle of all ranges, and the extremes anywhere."""
    table = []
    for sweep in sweeps:
        unit, factor = _unit(plant, sweep.joint)
        row: dict[str, Any] = {"joint": sweep.joint, "actuator": " and ".join(sweep.actuators),
                               "speed": sweep.speed * factor, "speed_unit": f"{unit}/s",
                               "gain_unit": _gain_unit(plant, sweep)}
        for key in KEYS:
            values = sweep.each(key) * (factor if key == "gain" else 1.0)
            reached = values[np.isfinite(values)]
            row |= {key: _finite(values[len(values) // 2, 0]),
                    f"{key}_min": _finite(reached.min(initial=np.inf)),
                    f"{key}_max": _finite(reached.max(initial=-np.inf))}
        row |= {"unreachable": int(np.sum(~np.isfinite(sweep.each("gain")))), "reason": sweep.reason}
        table.append(row)
    return table


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _unit(plant: Plant, joint: str) -> tuple[str, float]:
    prismatic = plant.machine.link(joint).joint.type == "prismatic"
    return ("m", 1.0) if prismatic else ("deg", 180 / np.pi)


def _gain_unit(plant: Plant, sweep: Sweep) -> str:
    command = plant.machine.circuits[sweep.actuators[0]].valve.command
    unit = f"{_unit(plant, sweep.joint)[0]}/s"
    return unit if command == "1" else f"{unit} per {command}"


def charts(plant: Plant, sweeps: Sequence[Sweep]) -> list[Curves]:
    """Frequency, damping and gain of every joint over its range; bands are what the other joints' postures make."""
    made = []
    for joint in dict.fromkeys(sweep.joint for sweep in sweeps):
        unit, factor = _unit(plant, joint)
        own = [sweep for sweep in sweeps if sweep.joint == joint]
        for key, title in zip(KEYS, ("natural frequency [Hz]", "damping, of critical", "steady gain"), strict=True):
            lines, bands = [], []
            for sweep in own:
                look = "predicted" if sweep.speed > 0 else "other"
                values = np.abs(sweep.each(key)) * (factor if key == "gain" else 1.0)
                lines.append(("towards the upper limit" if sweep.speed > 0 else "towards the lower limit", look,
                              values[:, 0]))
                least, most = (np.where(np.any(np.isfinite(values), axis=1), edge, np.nan) for edge in (
                    np.min(np.where(np.isfinite(values), values, np.inf), axis=1),
                    np.max(np.where(np.isfinite(values), values, -np.inf), axis=1)))
                bands.append((look, least, most))
            named = f"{title} [{_gain_unit(plant, own[0])}]" if key == "gain" else title
            made.append(Curves(f"{joint}: {named}", f"{joint} [{unit}]", factor * own[0].position, tuple(lines),
                               bands=tuple(bands)))
    return made


def render(plant: Plant, sweeps: Sequence[Sweep]) -> str:
    """A page of its own that needs nothing else."""
    return document("hydraulics.html", machine=plant.machine, hydraulics=rows(plant, sweeps),
                    charts={"hydraulics": charts(plant, sweeps)}, scene=SceneView(plant.model.scene_graph))
