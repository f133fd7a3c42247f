"""What the hydraulics make of every joint over the workspace: a table, figures, and a page of its own."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import matplotlib
import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from hydroopt.report.figures import BLUE, ORANGE, STYLE, WIDTH, svg
from hydroopt.report.page import document

if TYPE_CHECKING:
    from hydroopt.model.plant import Plant
    from hydroopt.model.workspace import Sweep
    from hydroopt.spatial.inertia import Array

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


def figure(plant: Plant, sweeps: Sequence[Sweep]) -> Figure:
    """Frequency, damping and gain of every joint over its range; bands are what the other joints' postures make."""
    joints = list(dict.fromkeys(sweep.joint for sweep in sweeps))
    with matplotlib.rc_context(STYLE):
        drawn = Figure(figsize=(WIDTH, 0.5 + 1.75 * len(joints)), layout="constrained")
        axes = drawn.subplots(len(joints), len(KEYS), squeeze=False)
        for line, joint in zip(axes, joints, strict=True):
            unit, factor = _unit(plant, joint)
            for sweep in (each for each in sweeps if each.joint == joint):
                colour = BLUE if sweep.speed > 0 else ORANGE
                for ax, key in zip(line, KEYS, strict=True):
                    values = sweep.each(key) * (factor if key == "gain" else 1.0)
                    _band(ax, sweep.position * factor, np.abs(values) if key == "gain" else values, colour)
                line[2].set_ylabel(_gain_unit(plant, sweep))
            for ax, title, label in zip(line, ("natural frequency", "damping", "steady gain"),
                                        ("Hz", "of critical", line[2].get_ylabel()), strict=True):
                ax.set(title=f"{joint}: {title}", xlabel=unit, ylabel=label)
                ax.set_ylim(0, 1.1 * ax.get_ylim()[1])
        drawn.legend(handles=[Line2D([], [], color=BLUE, label="towards the upper limit"),
                              Line2D([], [], color=ORANGE, label="towards the lower limit")],
                     loc="outside upper right", ncols=2)
    return drawn


def _band(ax: Any, x: Array, values: Array, colour: str) -> None:
    ax.plot(x, values[:, 0], color=colour)
    least = np.where(np.isfinite(values), values, np.inf).min(axis=1)
    most = np.where(np.isfinite(values), values, -np.inf).max(axis=1)
    ok = np.isfinite(least)
    ax.fill_between(x[ok], least[ok], most[ok], color=colour, alpha=0.15, linewidth=0)


def section(plant: Plant, sweeps: Sequence[Sweep]) -> dict[str, Any]:
    """What the part ``hydraulics_section.html`` of a page needs."""
    return {"rows": rows(plant, sweeps), "figure": Markup(svg(figure(plant, sweeps), "hydraulics"))}


def render(plant: Plant, sweeps: Sequence[Sweep]) -> str:
    """A page of its own that needs nothing else."""
    return document("hydraulics.html", machine=plant.machine, hydraulics=section(plant, sweeps))
