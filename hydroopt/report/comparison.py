"""One page for what changed between two sessions, or for the payload that one of them carried."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import matplotlib
import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure

from hydroopt.report.figures import BLUE, GREY, ORANGE, STYLE, WIDTH, svg
from hydroopt.report.numbers import NONE, plain, quantity, unit_text
from hydroopt.report.page import page
from hydroopt.results.diagnostic import sentences

if TYPE_CHECKING:
    from hydroopt.estimation.dynamic.change import Change, Difference
    from hydroopt.estimation.dynamic.payload import Payload
    from hydroopt.estimation.dynamic.session_answer import Quantity
    from hydroopt.estimation.dynamic.stored_information import StoredInformation
    from hydroopt.estimation.dynamic.two_session_answer import TwoSessionAnswer
    from hydroopt.machine.machine import Machine

COLUMNS = 3


def render_change(change: Change) -> str:
    """The page of two sessions compared; it needs nothing else."""
    rows = [_difference_row(one) for one in change.differences]
    return _page(change, "what has changed", rows, change.differences, sessions=("before", "after"))


def render_payload(load: Payload) -> str:
    """The page of a payload; it needs nothing else."""
    rows = [_row(one) for one in load.quantities]
    return _page(load, "load", rows, load.quantities, sessions=("without the load", "with the load"), link=load.link)


def _page(answer: TwoSessionAnswer, title: str, rows: Sequence[dict[str, Any]],
          numbers: Sequence[Quantity], *, sessions: tuple[str, str], link: str = "") -> str:
    drawn = differences(numbers)
    return page("comparison.html").render(
        machine=answer.machine, title=title, load=bool(link), link=link, status=str(answer.status),
        findings=[finding.text for finding in answer.findings], diagnostics=sentences(answer.diagnostics),
        notes=list(answer.notes), rank=answer.rank, statistic=plain(answer.statistic, 3),
        freedom=plain(answer.degrees_of_freedom, 3), p=f"{answer.p_value:.2g}",
        phi=plain(answer.split_half, 2), p_repeat=f"{answer.p_value_repeat:.2g}", rows=rows,
        file=f"{'payload' if link else 'comparison'}",
        figure=Markup(svg(drawn, "differences")) if drawn is not None else "",
        contradictions=answer.contradictions,
        logs=[session_row(role, each, answer.machine) for role, each in zip(sessions, (answer.before, answer.after),
                                                                            strict=True)])


def differences(rows: Sequence[Quantity]) -> Figure | None:
    """Values with their 95 % intervals, a panel for each unit; what has changed stands out."""
    units: dict[str, list[Quantity]] = {}
    for one in rows:
        if np.isfinite(one.std):
            units.setdefault(one.unit, []).append(one)
    if not units:
        return None
    columns = min(COLUMNS, len(units))
    lines = -(-len(units) // columns)
    height = lines * (0.24 * max(map(len, units.values())) + 0.75)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, height))
        axes = np.asarray(figure.subplots(lines, columns, squeeze=False)).ravel()
        for ax, (unit, some) in zip(axes, units.items(), strict=False):
            at = np.arange(len(some))
            colours = [ORANGE if getattr(one, "changed", False) else BLUE for one in some]
            ax.axvline(0, color=GREY, lw=0.8)
            ax.hlines(at, [one.ci95[0] for one in some], [one.ci95[1] for one in some], colors=colours, lw=1.6)
            ax.scatter([one.value for one in some], at, s=16, c=colours, zorder=3)
            ax.set_yticks(at, [one.name for one in some])
            ax.set(ylim=(len(some) - 0.4, -0.6), xlabel="part of the reading" if unit == "1" else unit_text(unit))
            ax.grid(axis="y", visible=False)
        for ax in axes[len(units):]:
            ax.set_visible(False)
        figure.tight_layout()
    return figure


def _row(one: Quantity) -> dict[str, Any]:
    shown = quantity(one.value, one.std, one.ci95)
    return {"name": one.name, "unit": unit_text(one.unit), "value": shown.value, "std": shown.std,
            "interval": shown.interval}


def _difference_row(one: Difference) -> dict[str, Any]:
    return _row(one) | {"p": f"{one.p_holm:.2g}" if np.isfinite(one.p_holm) else NONE, "changed": one.changed,
                        "detectable": plain(one.detectable, 2), "finding": one.finding.text}


def session_row(role: str, session: StoredInformation, machine: Machine) -> dict[str, Any]:
    """Logs and weights of a session for the template of all pages on sessions."""
    return {"role": role, "inputs": session.inputs,
            "weights": [(name, plain(one["sigma"]), plain(one["correlation_time"], 3), one["samples"])
                        for name, one in session.weights(machine).items()]}
