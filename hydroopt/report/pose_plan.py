"""The page of planned poses: the machine in each of them, and the accuracy to expect."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from hydroopt.report.charts import Chart, Line, TimeChart
from hydroopt.report.numbers import NONE, percent, plain
from hydroopt.report.page import document
from hydroopt.report.panels import SMALL, shown
from hydroopt.report.samples import Samples, Span
from hydroopt.report.scene import SceneView
from hydroopt.results.json_file import FILES

if TYPE_CHECKING:
    from hydroopt.excitation.selection.pose_plan import PosePlan
    from hydroopt.results.parameter_table import ParameterRow


def render(plan: PosePlan, template: str = "pose_plan.html", **more: Any) -> str:
    """The page as one HTML document that needs nothing else; `more` is what another template shows beside the plan."""
    joints, degrees = plan.joints, {joint: _printed(plan, joint) for joint in plan.joints}
    numbers = np.arange(1.0, len(plan.q) + 1)
    columns = {f"{joint}.q": plan.q[:, k] for k, joint in enumerate(joints)}
    columns |= {joint: degrees[joint][1] * plan.q[:, k] for k, joint in enumerate(joints)}
    changes = [0, *(np.flatnonzero(plan.stage[1:] != plan.stage[:-1]) + 1).tolist(), len(plan.q)]
    spans = tuple(Span(a, b - 1, str(plan.stage[a]), str(plan.fixture[a]))
                  for a, b in pairwise(changes) if b > a)
    charts: list[Chart] = [TimeChart(f"{joint} [{degrees[joint][0]}]", (Line(joint, joint, dots=True),))
                           for joint in joints if np.ptp(columns[joint]) > 0]
    return document(
        template, samples=Samples("pose, in the order of measuring", numbers, columns, spans),
        charts={"joints": charts}, scene=SceneView(plan.scene, tuple(f"{joint}.q" for joint in joints)),
        answer=plan, plan=plan, sheet=plan.sheet(),
        condition=plain(plan.observability.condition_number, 3),
        file=FILES[plan.job],
        rows=[_row(one) for one in plan.parameters.rows if one.identifiability != "fixed"], **more)


def _printed(plan: PosePlan, joint: str) -> tuple[str, float]:
    return shown(plan.machine.channel_units.get(f"{joint}.q", "rad"), SMALL)


def _row(one: ParameterRow) -> tuple[str, str, str, str, str, str]:
    """Name, unit, standard deviation before and after, what is left of it [%], and identifiability."""
    unit, factor = shown(one.unit, SMALL)
    before, after = (np.nan if x is None else factor * x for x in (one.prior_std, one.std))
    return (one.name, unit, plain(before, 3), plain(after, 3), percent(after / before) if before > 0 else NONE,
            one.identifiability)
