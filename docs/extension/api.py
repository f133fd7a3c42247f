"""The reference of all public names, from their docstrings, by the room that defines them."""

from __future__ import annotations

import inspect

from pydantic import BaseModel

import hydroopt

ROOMS = {"machine": "Machines", "model": "Models", "parameters": "Models", "logs": "Logs and poses",
         "simulation": "Simulation", "estimation.dynamic": "Bodies and friction",
         "estimation.kinematic": "Geometry",
         "estimation.motion": "Sensors", "estimation.hydraulic": "Valves and oil",
         "excitation": "What to measure next", "solving": "Solve", "results": "Answers",
         "viewing": "Pages and figures", "plots": "Pages and figures",
         "estimation.inference": "Solvers", "errors": "Errors"}
"""Headings, in the order of the page, by the modules of the names below them."""

OTHERS = "Further names"
HEAD = """# Python interface

All public names stand in the package itself: `import hydroopt as ho`, then `ho.Model`. Examples below run
with the tests.
"""


def pages() -> dict[str, str]:
    """Text of the page by its path below ``docs/generated``."""
    below: dict[str, list[str]] = {title: [] for title in (*ROOMS.values(), OTHERS)}
    for name in sorted(hydroopt.__all__, key=str.lower):
        module = getattr(hydroopt, name).__module__.removeprefix("hydroopt.")
        title = next((title for room, title in ROOMS.items() if f"{module}.".startswith(f"{room}.")), OTHERS)
        below[title].append(name)
    sections = [f"## {title}\n\n" + "\n".join(map(_entry, names)) for title, names in below.items() if names]
    return {"api.md": "\n".join([HEAD, *sections])}


def _entry(name: str) -> str:
    value = getattr(hydroopt, name)
    if inspect.isclass(value):
        kind = "autoexception" if issubclass(value, Exception) else "autoclass"
        stated = "(**parts)" if issubclass(value, BaseModel) else ""  # one argument a key of the machine file
        lines = [f".. {kind}:: hydroopt.{name}{stated}", "   :members:", "   :exclude-members: model_config"]
    else:
        lines = [f".. autofunction:: hydroopt.{name}"]
    return "\n".join(["```{eval-rst}", *lines, "```", ""])
