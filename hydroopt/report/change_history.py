"""One page for what changed over several sessions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from hydroopt.report.charts import Curves
from hydroopt.report.comparison import sessions_page
from hydroopt.report.numbers import NONE, p_value, percent, plain, quantity, unit_text

if TYPE_CHECKING:
    from hydroopt.estimation.dynamic.change_history import ChangeHistory, ParameterHistory, SessionValue


def render_history(history: ChangeHistory) -> str:
    """The page of several sessions compared; it needs nothing else."""
    changed = [one for one in history.histories if one.changed]
    drawn = changed or list(history.single[:1])
    return sessions_page(
        "change_history.html", history, f"changes over {len(history.sessions)} sessions", history.sessions,
        "comparison.json, comparison.csv and sessions.csv", detected=history.detected, p=p_value(history.p_value),
        tests=history.tests, level=plain(100 * history.level, 2), scatter=percent(history.scatter),
        p_scatter=p_value(history.scatter_p_value), alone=bool(drawn) and not changed,
        rows=[_row(one) for one in history.histories], charts={"courses": courses(drawn)})


def courses(histories: Sequence[ParameterHistory]) -> list[Curves]:
    """Each parameter over the sessions, its change since the first with 95 % intervals, and its step or drift."""
    made = []
    for one in histories:
        number = np.arange(1.0, len(one.values) + 1)
        change, ends = np.array([each.change for each in one.values]), np.array([each.ci95 for each in one.values])
        lines = [("change since the first session", "predicted", change)]
        if one.course in ("step", "drift"):
            path = one.alternatives[0].shape.course(len(number)) * one.value
            # a step and a drift have only one size: what it starts from is the mean of the rest
            lines.append((str(one.course), "other", path + float(np.nanmean(change - path))))
        made.append(Curves(f"{one.name} [{unit_text(one.unit)}]", "session", number, tuple(lines),
                           bands=(("predicted", ends[:, 0], ends[:, 1]),)))
    return made


def _row(one: ParameterHistory) -> dict[str, Any]:
    shown = quantity(one.value, one.std, one.ci95)
    course = f"step at session {one.session}" if one.session is not None else str(one.course)
    return {"name": one.name, "unit": unit_text(one.unit), "value": shown.value, "interval": shown.interval,
            "course": course, "changed": one.changed, "p": p_value(one.p_value),
            "detectable": plain(one.largest_detectable, 2), "sessions": [_cell(value) for value in one.values[1:]]}


def _cell(value: SessionValue) -> dict[str, Any]:
    shown = quantity(value.change, value.std)
    return {"text": f"{shown.value} ± {shown.std}" if np.isfinite(value.std) else NONE,
            "outside": value.ci95[0] > 0 or value.ci95[1] < 0}
