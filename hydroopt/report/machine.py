"""A machine as its file describes it: the side view, lever arms and transmission ratios over the range, its tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import matplotlib
import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure

from hydroopt.report import side_view
from hydroopt.report.figures import BLUE, ORANGE, STYLE, panels, svg
from hydroopt.report.page import document
from hydroopt.results.diagnostic import Diagnostic

if TYPE_CHECKING:
    from hydroopt.machine.machine import Machine
    from hydroopt.model.over_range import Curve
    from hydroopt.model.scene import Scene

TABLES = {"joints": "Joints", "cylinders": "Cylinders", "spans": "Cylinders that move several joints together",
          "linkages": "Linkages", "couplings": "Couplings",
          "sensors": "Sensors", "parameters": "Parameters"}
"""Which facts a page shows as tables, with their titles."""


def figure(machine: Machine, arms: Sequence[Curve], ratios: Sequence[Curve]) -> Figure:
    """Lever arms of cylinders and transmission ratios of loops, each over the joint that it moves or follows."""
    with matplotlib.rc_context(STYLE):
        drawn, axes = panels(len(arms) + len(ratios), 2.1)
        named = [(curve, _arm_of(machine, curve), BLUE) for curve in arms]
        named += [(curve, f"d {curve.subject} / d {curve.joint}", ORANGE) for curve in ratios]
        for ax, (curve, title, colour) in zip(axes, named, strict=True):
            turns = machine.link(curve.joint).joint.type == "revolute"
            ax.plot(np.degrees(curve.position) if turns else curve.position, curve.value, color=colour, lw=1.6)
            low, high = ax.get_ylim()
            ax.set(title=title, xlabel=f"{curve.joint} [{'deg' if turns else 'm'}]",
                   ylim=(min(low, 0.0), max(high, 0.0)))
        drawn.tight_layout()
    return drawn


def _arm_of(machine: Machine, curve: Curve) -> str:
    turns = machine.link(curve.joint).joint.type == "revolute"
    return f"{curve.subject}: {'lever arm [m]' if turns else 'length per travel'}"


def render(machine: Machine, facts: Mapping[str, Any], scenes: Sequence[Scene], arms: Sequence[Curve],
           ratios: Sequence[Curve]) -> str:
    """A page of its own that needs nothing else.

    Args:
        machine: the machine.
        facts: what `hydroopt show --json` prints.
        scenes: the machine in the middle of its ranges, then at the limits of each joint.
        arms, ratios: see `hydroopt.model.over_range`.
    """
    drawn = {"side-view": side_view.side_view(machine, scenes, "middle of all ranges", "limits of each joint")}
    if arms or ratios:
        drawn["over-range"] = figure(machine, arms, ratios)
    return document(
        "machine.html", machine=machine, diagnostics=[Diagnostic.from_dict(each) for each in facts["diagnostics"]],
        identifiability=facts["identifiability"],
        figures={name: Markup(svg(each, name)) for name, each in drawn.items()}, ratios=ratios,
        tables=[(title, facts[key]) for key, title in TABLES.items() if facts[key]])
