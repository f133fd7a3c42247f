"""One page for what changed between two sessions, or for the payload that one of them carried."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import matplotlib
import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure

from hydroopt.report.figures import BLUE, GREY, ORANGE, STYLE, panels, svg
from hydroopt.report.numbers import p_value, plain, quantity, unit_text
from hydroopt.report.page import document

if TYPE_CHECKING:
    from hydroopt.estimation.dynamic.change import Change, Difference
    from hydroopt.estimation.dynamic.payload import Payload
    from hydroopt.estimation.dynamic.session_answer import Quantity, SessionAnswer
    from hydroopt.estimation.dynamic.stored_information import StoredInformation
    from hydroopt.estimation.dynamic.two_session_answer import TwoSessionAnswer
    from hydroopt.machine.machine import Machine


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
    drawn, name = differences(numbers), "payload" if link else "comparison"
    return sessions_page(
        "comparison.html", answer, title, sessions, f"{name}.json and {name}.csv", load=bool(link), link=link,
        notes=answer.notes, rank=answer.rank, statistic=plain(answer.statistic, 3),
        freedom=plain(answer.degrees_of_freedom, 3), p=p_value(answer.p_value), phi=plain(answer.split_half, 2),
        p_repeat=p_value(answer.p_value_repeat), rows=rows,
        figure=Markup(svg(drawn, "differences")) if drawn is not None else "")


def sessions_page(template: str, answer: SessionAnswer, title: str, roles: Iterable[str], files: str, *,
                  notes: Sequence[str] = (), **more: Any) -> str:
    """A page on sessions: what all such pages have, and what its template needs beside.

    Args:
        template: extends sessions.html.
        answer: about the sessions.
        title: beside the machine's name.
        roles: what the sessions are called.
        files: in which the numbers stand.
        notes: how it was computed, in sentences.
        more: values for the template.
    """
    return document(
        template, machine=answer.machine, title=title, contradictions=answer.contradictions, files=files, notes=notes,
        answers=[finding.text for finding in answer.findings], diagnostics=answer.diagnostics,
        logs=[_session_row(role, each, answer.machine)
              for role, each in zip(roles, answer.sessions.values(), strict=True)], **more)


def differences(rows: Sequence[Quantity]) -> Figure | None:
    """Values with their 95 % intervals, a panel for each unit; what has changed stands out."""
    units: dict[str, list[Quantity]] = {}
    for one in rows:
        if np.isfinite(one.std):
            units.setdefault(one.unit, []).append(one)
    if not units:
        return None
    with matplotlib.rc_context(STYLE):
        figure, axes = panels(len(units), 0.24 * max(map(len, units.values())) + 0.75)
        for ax, (unit, some) in zip(axes, units.items(), strict=True):
            at = np.arange(len(some))
            colours = [ORANGE if getattr(one, "changed", False) else BLUE for one in some]
            ax.axvline(0, color=GREY, lw=0.8)
            ax.hlines(at, [one.ci95[0] for one in some], [one.ci95[1] for one in some], colors=colours, lw=1.6)
            ax.scatter([one.value for one in some], at, s=16, c=colours, zorder=3)
            ax.set_yticks(at, [one.name for one in some])
            ax.set(ylim=(len(some) - 0.4, -0.6), xlabel="part of the reading" if unit == "1" else unit_text(unit))
            ax.grid(axis="y", visible=False)
        figure.tight_layout()
    return figure


def _row(one: Quantity) -> dict[str, Any]:
    shown = quantity(one.value, one.std, one.ci95)
    return {"name": one.name, "unit": unit_text(one.unit), "value": shown.value, "std": shown.std,
            "interval": shown.interval}


def _difference_row(one: Difference) -> dict[str, Any]:
    return _row(one) | {"p": p_value(one.p_holm), "changed": one.changed,
                        "detectable": plain(one.detectable, 2), "finding": one.finding.text}


def _session_row(role: str, session: StoredInformation, machine: Machine) -> dict[str, Any]:
    """Logs and weights of a session."""
    return {"role": role, "inputs": session.inputs,
            "weights": [(name, plain(one["sigma"]), plain(one["correlation_time"], 3), one["samples"])
                        for name, one in session.weights(machine).items()]}
