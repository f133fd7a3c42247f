"""One page for what changed over sessions, or for the payload that one of two carried."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from hydroopt.report.charts import Curves
from hydroopt.report.numbers import NONE, p_value, percent, plain, quantity, unit_text
from hydroopt.report.page import document
from hydroopt.report.scene import SceneView, Tint
from hydroopt.report.tables import spread

if TYPE_CHECKING:
    from hydroopt.estimation.dynamic.payload import Payload
    from hydroopt.estimation.dynamic.session_answer import Quantity, SessionAnswer
    from hydroopt.estimation.dynamic.session_comparison import Difference, SessionComparison
    from hydroopt.estimation.dynamic.stored_information import StoredInformation
    from hydroopt.machine.machine import Machine


def render_comparison(answer: SessionComparison) -> str:
    """The page of sessions compared; it needs nothing else."""
    changed = [one for one in answer.differences if one.changed]
    course = answer.shape.course(len(answer.in_order))
    return _page("session_comparison.html", answer, f"changes over {len(answer.in_order)} sessions", answer.sessions,
                 "comparison.json, comparison.csv and sessions.csv", p=p_value(answer.p_value),
                 level=plain(100 * answer.level, 2), scatter=percent(answer.scatter),
                 p_scatter=p_value(answer.scatter_p_value), rows=[_difference_row(one) for one in answer.differences],
                 tints=_tints(changed), charts={"courses": [_course(one, course) for one in changed]})


def render_payload(load: Payload) -> str:
    """The page of a payload; it needs nothing else."""
    rows = [_row(one, _reach(load.quantities, one.unit)) for one in load.quantities]
    return _page("payload.html", load, "load", ("without the load", "with the load"), "payload.json and payload.csv",
                 link=load.link, rank=load.rank, statistic=plain(load.statistic, 3),
                 freedom=plain(load.degrees_of_freedom, 3), p=p_value(load.p_value), phi=plain(load.split_half, 2),
                 p_repeat=p_value(load.p_value_repeat), rows=rows)


def _page(template: str, answer: SessionAnswer, title: str, roles: Iterable[str], files: str, *,
          tints: tuple[Tint, ...] = (), **more: Any) -> str:
    """A page on sessions: what all such pages have, and what its template needs beside."""
    return document(
        template, answer=answer, scene=SceneView(answer.scene, tints=tints), machine=answer.machine,
        title=title, contradictions=answer.contradictions, files=files,
        answers=[finding.text for finding in answer.findings],
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
    shown = quantity(one.value, one.std, one.ci95)
    return {"figure": spread(one.value, one.ci95, reach, unit_text(one.unit)),
            "name": one.name, "unit": unit_text(one.unit), "value": shown.value, "std": shown.std,
            "interval": shown.interval}


def _difference_row(one: Difference) -> dict[str, Any]:
    """The change only where one is stated; else what would have shown."""
    shown = quantity(one.value, one.std, one.ci95)
    return {"name": one.name, "unit": unit_text(one.unit), "changed": one.changed,
            "value": shown.value if one.changed else NONE, "interval": shown.interval if one.changed else NONE,
            "p": p_value(one.p_value), "detectable": NONE if one.changed else plain(one.largest_detectable, 2),
            "differs": p_value(one.differs), "sessions": [_cell(*each) for each in one.sessions[1:]]}


def _cell(change: float, std: float) -> str:
    shown = quantity(change, std)
    return f"{shown.value} ± {shown.std}" if np.isfinite(std) else NONE


def _course(one: Difference, course: np.ndarray) -> Curves:
    """A parameter over the sessions, its change since the first with twice its standard deviation, and its step or
    drift, which starts from the mean of the rest."""
    number, (change, std) = np.arange(1.0, len(course) + 1), np.array(one.sessions).T
    path = course * one.value
    return Curves(f"{one.name} [{unit_text(one.unit)}]", "session", number, (
        ("change since the first session", "predicted", change),
        ("step or drift", "other", path + float(np.nanmean(change - path)))),
        bands=(("predicted", change - 2 * std, change + 2 * std),))


def _session_row(role: str, session: StoredInformation, machine: Machine) -> dict[str, Any]:
    """Logs and weights of a session."""
    return {"role": role, "inputs": session.inputs,
            "weights": [(name, plain(one["sigma"]), plain(one["correlation_time"], 3), one["samples"])
                        for name, one in session.weights(machine).items()]}
