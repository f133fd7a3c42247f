"""A base that stands on a slope or moves: what a file says of it, as the measured joints that it stands for.

From the frame `base`, which rests, up to six joints lead to the link `chassis`, on which all stands that the file puts
on the base: first the position along x, y, z, then yaw about z, pitch about y and roll about x. The ground moves
them, by forces that nobody measures, so that their equations are eliminated; their positions are measured.
"""

from __future__ import annotations

from typing import Any

from hydroopt.errors import MachineError

CHASSIS = "chassis"
"""The link that carries what stands on a moving base."""
AXES = {"x": "x", "y": "y", "z": "z", "yaw": "z", "pitch": "y", "roll": "x"}
"""Coordinates of a base in the order of their joints, and the axis of each."""
_LIMITS = {"lower", "upper", "max_speed", "max_acceleration"}
_TURN = {"x": ({"beta": "90 deg"}, {"beta": "-90 deg"}), "y": ({"alpha": "-90 deg"}, {"alpha": "90 deg"})}
"""How z turns to an axis, and back."""


def expand(data: dict[str, Any], where: str) -> dict[str, str]:
    """Put joints in the place of the table `base_motion` of a machine's description, whose links state their parents.

    Returns:
        Which place of the machine stands where in the file.

    Raises:
        MachineError: a coordinate or key is unknown, or a name is taken.
    """
    if "base_motion" not in data:
        return {}
    stated, at = data.pop("base_motion"), f"{where}: base_motion"
    if not isinstance(stated, dict) or not stated:
        raise MachineError("must be a table", where=at,
                           remedy="state coordinates such as roll = { lower = \"-10 deg\", upper = \"10 deg\" }")
    for key, limits in stated.items():
        if key not in AXES:
            raise MachineError("this coordinate is unknown", where=f"{at}.{key}", remedy=f"use {', '.join(AXES)}")
        if not isinstance(limits, dict) or not set(limits) <= _LIMITS:
            raise MachineError("must be a table of limits", where=f"{at}.{key}",
                               remedy=f"state {', '.join(sorted(_LIMITS))}")
    _on_chassis(data)
    links: list[dict[str, Any]] = []
    drives: list[dict[str, Any]] = []
    moved: dict[str, str] = {}
    parent = "base"

    def add(name: str, joint: dict[str, Any]) -> None:
        nonlocal parent
        links.append({"name": name, "parent": parent, "joint": joint})
        parent = name

    for key in (key for key in AXES if key in stated):
        name, axis = f"base_{key}", AXES[key]
        back: dict[str, Any] = {}
        if axis in _TURN:
            there, back = _TURN[axis]
            add(f"{name}_axis", {"type": "locked", **there})
        add(name, {"type": "prismatic" if key in "xyz" else "revolute", **back, **stated[key]})
        drives.append({"name": f"{name}_ground", "joint": name, "measured": False})
        moved[f"links[{name}].joint"] = f"base_motion.{key}"
    add(CHASSIS, {"type": "locked"})
    data["links"] = [*links, *data.get("links", [])]
    data["drives"] = [*drives, *data.get("drives", [])]
    return moved


def _on_chassis(data: dict[str, Any]) -> None:
    """Attach to the chassis what the file attaches to the base."""
    def moved(table: Any, key: str) -> None:
        if isinstance(table, dict) and table.get(key) == "base":
            table[key] = CHASSIS

    def parts(key: str) -> list[Any]:
        return found if isinstance(found := data.get(key), list) else []

    for link in parts("links"):
        moved(link, "parent")
    for kind in ("cylinders", "gas_cylinders", "springs"):
        for part in parts(kind):
            for end in ("barrel", "rod"):
                moved(part.get(end) if isinstance(part, dict) else None, "link")
    for loop in parts("loops"):
        moved(loop.get("to") if isinstance(loop, dict) else None, "link")
        moved(loop, "link")
    for obstacle in parts("obstacles"):
        moved(obstacle, "link")
