"""One page for what changed over several sessions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import matplotlib
import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from hydroopt.report.comparison import sessions_page
from hydroopt.report.figures import BLUE, GREY, ORANGE, STYLE, panels, svg
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
        rows=[_row(one) for one in history.histories], figure=Markup(svg(courses(drawn), "courses")) if drawn else "")


def courses(histories: Sequence[ParameterHistory]) -> Figure:
    """Each parameter over the sessions, its change since the first with 95 % intervals, and its step or drift."""
    with matplotlib.rc_context(STYLE):
        figure, axes = panels(len(histories), 2.3)
        for ax, one in zip(axes, histories, strict=True):
            number = np.arange(1, len(one.values) + 1)
            change, ends = np.array([each.change for each in one.values]), np.array([each.ci95 for each in one.values])
            ax.axhline(0, color=GREY, lw=0.8)
            if one.course in ("step", "drift"):
                shape = one.alternatives[0].shape
                path = shape.course(len(number)) * one.value
                # a step and a drift have only one size: what it starts from is the mean of the rest
                start = float(np.nanmean(change - path))
                ax.plot(number, path + start, color=ORANGE, lw=1.4,
                        drawstyle="steps-mid" if shape.session is not None else "default")
            ax.vlines(number, ends[:, 0], ends[:, 1], colors=BLUE, lw=1.6)
            ax.scatter(number, change, s=18, c=BLUE, zorder=3)
            ax.set(title=one.name, xlabel="session", ylabel=f"change [{unit_text(one.unit)}]",
                   xlim=(0.6, len(number) + 0.4))
            ax.xaxis.set_major_locator(MaxNLocator(nbins=min(len(number), 10), integer=True))
            ax.grid(axis="x", visible=False)
        figure.tight_layout()
    return figure


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
