"""A base that stands on a slope or moves: what a file says of it, as the measured joints that it stands for.

From the frame `base`, which rests, up to six joints of a free link (`hydroopt.machine.free_links`) lead to the link
`chassis`, on which all stands that the file puts on the base. The ground moves them, by forces that are not measured,
so that their equations are eliminated; their positions are measured.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hydroopt.machine import free_links

CHASSIS = "chassis"
"""The link that carries what stands on a moving base."""


def expand(data: dict[str, Any]) -> dict[str, str]:
    """Put joints in the place of the table `base_motion` of a description that was validated.

    Returns:
        Which place of the machine stands where in the file.
    """
    if "base_motion" not in data:
        return {}
    stated = data.pop("base_motion")
    links = free_links.chain("base", "base", stated)
    moving = [key for key in free_links.AXES if key in stated]
    drives = [{"name": f"base_{key}_ground", "joint": f"base_{key}", "measured": False,
               "ground": True} for key in moving]
    _on_chassis(data)
    links.append({"name": CHASSIS, "parent": links[-1]["name"], "joint": {"type": "locked"}})
    data["links"] = [*links, *data["links"]]
    data["drives"] = [*drives, *data.get("drives", [])]
    return {f"links[base_{key}].joint": f"base_motion.{key}" for key in moving}


def _on_chassis(data: Mapping[str, Any]) -> None:
    """Attach to the chassis what the file attaches to the base."""
    held = [(link, "parent") for link in data["links"]]
    held += [(part[end], "link") for kind in ("cylinders", "gas_cylinders", "springs") for part in data.get(kind, [])
             for end in ("barrel", "rod")]
    held += [(table, "link") for loop in data.get("loops", []) for table in (loop, loop["to"])]
    held += [(part, "link") for kind in ("obstacles", "imus", "targets", "instruments") for part in data.get(kind, [])]
    for table, key in held:
        if table.get(key) == "base":
            table[key] = CHASSIS
