"""One page for what changed between two sessions, or for the payload that one of them carried."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from hydroopt.report.intervals import spread
from hydroopt.report.numbers import p_value, plain, quantity, unit_text
from hydroopt.report.page import document
from hydroopt.report.scene import SceneView, Tint

if TYPE_CHECKING:
    from hydroopt.estimation.dynamic.change import Change, Difference
    from hydroopt.estimation.dynamic.payload import Payload
    from hydroopt.estimation.dynamic.session_answer import Quantity, SessionAnswer
    from hydroopt.estimation.dynamic.stored_information import StoredInformation
    from hydroopt.estimation.dynamic.two_session_answer import TwoSessionAnswer
    from hydroopt.machine.machine import Machine


def render_change(change: Change) -> str:
    """The page of two sessions compared; it needs nothing else."""
    rows = [_difference_row(one, _reach(change.differences, one.unit)) for one in change.differences]
    return _page(change, "what has changed", rows, change.differences, sessions=("before", "after"))


def render_payload(load: Payload) -> str:
    """The page of a payload; it needs nothing else."""
    rows = [_row(one, _reach(load.quantities, one.unit)) for one in load.quantities]
    return _page(load, "load", rows, load.quantities, sessions=("without the load", "with the load"), link=load.link)


def _page(answer: TwoSessionAnswer, title: str, rows: Sequence[dict[str, Any]],
          numbers: Sequence[Quantity], *, sessions: tuple[str, str], link: str = "") -> str:
    name = "payload" if link else "comparison"
    return sessions_page(
        "comparison.html", answer, title, sessions, f"{name}.json and {name}.csv", load=bool(link), link=link,
        notes=answer.notes, rank=answer.rank, statistic=plain(answer.statistic, 3),
        freedom=plain(answer.degrees_of_freedom, 3), p=p_value(answer.p_value), phi=plain(answer.split_half, 2),
        p_repeat=p_value(answer.p_value_repeat), rows=rows,
        tints=() if link else _tints(numbers))


def sessions_page(template: str, answer: SessionAnswer, title: str, roles: Iterable[str], files: str, *,
                  notes: Sequence[str] = (), tints: tuple[Tint, ...] = (), **more: Any) -> str:
    """A page on sessions: what all such pages have, and what its template needs beside.

    Args:
        template: extends sessions.html.
        answer: about the sessions.
        title: beside the machine's name.
        roles: what the sessions are called.
        files: in which the numbers stand.
        notes: how it was computed, in sentences.
        tints: ways to colour the machine.
        more: values for the template.
    """
    return document(
        template, scene=SceneView(answer.scene, tints=tints), verdict=answer.verdict, machine=answer.machine,
        title=title, contradictions=answer.contradictions, files=files, notes=notes,
        answers=[finding.text for finding in answer.findings], diagnostics=answer.diagnostics,
        logs=[_session_row(role, each, answer.machine)
              for role, each in zip(roles, answer.sessions.values(), strict=True)], **more)


def _reach(rows: Sequence[Quantity], unit: str) -> float:
    """Largest end of an interval in some unit."""
    ends = [abs(end) for one in rows if one.unit == unit and np.isfinite(one.std) for end in (one.value, *one.ci95)]
    return max(ends, default=0.0)


def _tints(rows: Sequence[Quantity]) -> tuple[Tint, ...]:
    """Colours by the largest value of a part's numbers over its standard deviation; none without any."""
    parts: dict[str, float] = {}
    for one in rows:
        owner = one.name.rpartition(".")[0].removesuffix(".barrel").removesuffix(".rod")
        if one.std > 0 and np.isfinite(one.value):
            parts[owner] = max(parts.get(owner, 0.0), abs(one.value) / one.std)
    return (Tint("change", "largest change / σ", "σ", 6.0, values=parts),) * bool(parts)


def _row(one: Quantity, reach: float) -> dict[str, Any]:
    shown, striking = quantity(one.value, one.std, one.ci95), bool(getattr(one, "changed", False))
    return {"figure": spread(one.value, one.ci95, reach, unit_text(one.unit), striking=striking),
            "name": one.name, "unit": unit_text(one.unit), "value": shown.value, "std": shown.std,
            "interval": shown.interval}


def _difference_row(one: Difference, reach: float) -> dict[str, Any]:
    return _row(one, reach) | {"p": p_value(one.p_holm), "changed": one.changed,
                        "detectable": plain(one.detectable, 2), "finding": one.finding.text}


def _session_row(role: str, session: StoredInformation, machine: Machine) -> dict[str, Any]:
    """Logs and weights of a session."""
    return {"role": role, "inputs": session.inputs,
            "weights": [(name, plain(one["sigma"]), plain(one["correlation_time"], 3), one["samples"])
                        for name, one in session.weights(machine).items()]}
