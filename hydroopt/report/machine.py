"""A machine as its file describes it: the side view, lever arms and transmission ratios over the range, its tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from hydroopt.report.charts import Curves
from hydroopt.report.drawing import NARROW, WIDE, View, drawn
from hydroopt.report.numbers import unit_text
from hydroopt.report.page import document
from hydroopt.report.scene import SceneView
from hydroopt.results.diagnostic import Diagnostic
from hydroopt.results.json_file import validated
from hydroopt.results.readable import readable

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


HEADINGS = {"head_area_cm2": "head area [cm²]", "rod_area_cm2": "rod area [cm²]", "length_min_m": "least length [m]",
            "length_max_m": "greatest length [m]", "lever_arm_min_m": "least lever arm [m]",
            "lever_arm_max_m": "greatest lever arm [m]", "ratios": "speed ratios",
            "margin_deg": "to a dead point [deg]", "margin_at": "at",
            "std": "standard deviation", "rate_hz": "rate [Hz]", "prior_std": "prior σ"}
"""How a table heads a fact, where its name alone does not do."""


def curves(machine: Machine, arms: Sequence[Curve], ratios: Sequence[Curve]) -> list[Curves]:
    """Lever arms of cylinders and transmission ratios of loops, each over the joint that it moves or follows."""
    named = [(curve, _arm_of(machine, curve), "predicted") for curve in arms]
    named += [(curve, f"speed ratio {curve.subject} / {curve.joint}", "other") for curve in ratios]
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
        diagnostics=validated(tuple[Diagnostic, ...], facts["diagnostics"]),
        identifiability=facts["identifiability"],
        side_views={kind: seen.svg(seen.description(machine.name, SIDE), axes=True, wide=most)
                    for kind, most in (("wide", WIDE), ("narrow", NARROW))}, ratios=ratios,
        tables=[(title, [_row(row) for row in facts[key]]) for key, title in TABLES.items() if facts[key]])


def _row(facts: Mapping[str, Any]) -> dict[str, Any]:
    """A row of a table by its headings: units in print, and standard deviations of readings with theirs."""
    row = dict(facts)
    if "rate_hz" in row:
        row["std"] = readable(row["std"], row.pop("unit"))
    if "unit" in row:
        row["unit"] = unit_text(row["unit"])
    return {HEADINGS.get(key, key.replace("_", " ")): value for key, value in row.items()}
