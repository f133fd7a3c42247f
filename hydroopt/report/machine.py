"""A machine as its file describes it: the side view, lever arms and transmission ratios over the range, its tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from hydroopt.report.charts import Curves
from hydroopt.report.drawing import View, drawn
from hydroopt.report.page import document
from hydroopt.report.scene import SceneView
from hydroopt.results.diagnostic import Diagnostic

if TYPE_CHECKING:
    from hydroopt.machine.machine import Machine
    from hydroopt.model.over_range import Curve
    from hydroopt.model.scene_graph import SceneGraph
    from hydroopt.model.vertical_plane import SidePostures

SIDE = "in the middle of its ranges, and faint at the limits of each joint"
TABLES = {"joints": "Joints", "cylinders": "Cylinders", "spans": "Cylinders that move several joints together",
          "linkages": "Linkages", "couplings": "Couplings",
          "sensors": "Sensors", "parameters": "Parameters"}
"""Which facts a page shows as tables, with their titles."""


def curves(machine: Machine, arms: Sequence[Curve], ratios: Sequence[Curve]) -> list[Curves]:
    """Lever arms of cylinders and transmission ratios of loops, each over the joint that it moves or follows."""
    named = [(curve, _arm_of(machine, curve), "predicted") for curve in arms]
    named += [(curve, f"d {curve.subject} / d {curve.joint}", "other") for curve in ratios]
    made = []
    for curve, title, look in named:
        turns = machine.link(curve.joint).joint.type == "revolute"
        made.append(Curves(title, f"{curve.joint} [{'deg' if turns else 'm'}]",
                           np.degrees(curve.position) if turns else curve.position, ((title, look, curve.value),)))
    return made


def _arm_of(machine: Machine, curve: Curve) -> str:
    turns = machine.link(curve.joint).joint.type == "revolute"
    return f"{curve.subject}: {'lever arm [m]' if turns else 'length per travel'}"


def render(scene: SceneGraph, facts: Mapping[str, Any], side: SidePostures, arms: Sequence[Curve],
           ratios: Sequence[Curve]) -> str:
    """A page of its own that needs nothing else.

    Args:
        scene: the machine in space.
        facts: what `hydroopt show --json` prints.
        side: the middle of its ranges, then the limits of each joint.
        arms, ratios: see `hydroopt.model.over_range`.
    """
    machine = scene.machine
    seen = drawn(scene, scene.tree_positions(side.q), View.side(side.plane))
    return document(
        "machine.html", scene=SceneView(scene), charts={"range": curves(machine, arms, ratios)}, machine=machine,
        diagnostics=[Diagnostic.from_dict(each) for each in facts["diagnostics"]],
        identifiability=facts["identifiability"],
        side_view=seen.svg(seen.told(machine.name, SIDE), axes=True), ratios=ratios,
        tables=[(title, facts[key]) for key, title in TABLES.items() if facts[key]])
