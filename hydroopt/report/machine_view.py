"""A machine in space whose joints a reader moves, beside what an answer says of it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hydroopt.report.page import document
from hydroopt.report.panels import SI
from hydroopt.report.scene import SceneView, Tint
from hydroopt.report.tables import parameter

if TYPE_CHECKING:
    from hydroopt.model.scene_graph import SceneGraph
    from hydroopt.results.answer import Answer
    from hydroopt.results.parameter_table import ParameterTable

BARREL_OR_ROD = (".barrel", ".rod")


def render(scene: SceneGraph, answer: Answer | None = None) -> str:
    """The page of a machine, and of the answer that it is from."""
    rows = [] if answer is None else [parameter(one, SI) for one in answer.parameters.rows]
    tints = () if answer is None else mass_tints(answer.parameters)
    return document("view.html", scene=SceneView(scene, tints=tints), machine=scene.machine, answer=answer, rows=rows)


def mass_tints(parameters: ParameterTable) -> tuple[Tint, ...]:
    """Colours by the uncertainty of masses; none where no mass was estimated."""
    parts: dict[str, float] = {}
    for one in parameters.rows:
        owner, _, element = one.name.rpartition(".")
        if element == "m" and one.value and one.std:
            for end in BARREL_OR_ROD:
                owner = owner.removesuffix(end)
            parts[owner] = max(parts.get(owner, 0.0), 100 * abs(one.std / one.value))
    return (Tint("uncertainty of masses", "standard deviation / mass", "%", 50.0, values=parts),) * bool(parts)
