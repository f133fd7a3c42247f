"""A base that stands on a slope or moves: what a file says of it, as the measured joints that it stands for.

From the frame `base`, which rests, up to six joints of a free link (`hydroopt.machine.free_links`) lead to the link
`chassis`, on which all stands that the file puts on the base. The ground moves them, by forces that are not measured,
so that their equations are eliminated; their positions are measured.
"""

from __future__ import annotations

from typing import Any

from hydroopt.machine import free_links

CHASSIS = "chassis"
"""The link that carries what stands on a moving base."""


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
    links = free_links.chain("base", "base", stated, at)
    moving = [key for key in free_links.AXES if key in stated]
    drives = [{"name": f"base_{key}_ground", "joint": f"base_{key}", "measured": False} for key in moving]
    _on_chassis(data)
    links.append({"name": CHASSIS, "parent": links[-1]["name"], "joint": {"type": "locked"}})
    data["links"] = [*links, *data.get("links", [])]
    data["drives"] = [*drives, *data.get("drives", [])]
    return {f"links[base_{key}].joint": f"base_motion.{key}" for key in moving}


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
    for kind in ("obstacles", "imus", "targets", "instruments"):
        for part in parts(kind):
            moved(part, "link")
