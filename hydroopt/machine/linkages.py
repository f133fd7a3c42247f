"""Common linkages by name: what a few pins say, as the links and the loop that they stand for.

A rocker and a coupler between a link and the one that its joint moves: the linkage of an excavator's bucket, the tilt
linkage of a log crane, the Z-bar of a wheel loader, the dual link of a knuckle boom.
"""

from __future__ import annotations

from typing import Any

from hydroopt.errors import MachineError
from hydroopt.machine.stated_tables import refuse_keys, tables

_BARS = ("rocker", "coupler")
_KEYS = {"name", "moves", "posture", *_BARS}
_BAR_KEYS = {"name", "pin", "length", "friction", "body"}


def expand(data: dict[str, Any], where: str) -> dict[str, str]:
    """Put links and loops in the place of the linkages of a machine's description, whose links state their parents.

    The rocker turns about its `pin` on the parent of the link that the linkage `moves`, and the coupler connects the
    rocker's far end to the coupler's `pin` on this link.

    Returns:
        Which place of the machine stands where in the file.

    Raises:
        MachineError: a key is unknown or missing, or there is no such link.
    """
    moved: dict[str, str] = {}
    links: list[Any] = stated if isinstance(stated := data.get("links"), list) else []
    for k, linkage in enumerate(tables(data.pop("linkages", []), f"{where}: linkages")):
        at = f"{where}: linkages[{linkage.get('name', k) if isinstance(linkage, dict) else k}]"
        refuse_keys(linkage, _KEYS, _KEYS, at)
        there = next((i for i, link in enumerate(links) if isinstance(link, dict)
                      and link.get("name") == linkage["moves"]), None)
        if there is None:
            raise MachineError(f"the linkage moves '{linkage['moves']}', which is not a link", where=f"{at}.moves",
                               remedy="name the link that it moves")
        names: list[Any] = []
        made: list[dict[str, Any]] = []
        for role in _BARS:
            bar = linkage[role]
            refuse_keys(bar, _BAR_KEYS, {"pin", "length"}, f"{at}.{role}")
            name = bar.get("name", role)
            joint = {"type": "revolute", "dependent": True, "a": bar["length"]}
            joint |= {key: bar[key] for key in ("friction",) if key in bar}
            made.append({"name": name, "parent": names[0] if names else links[there].get("parent"), "joint": joint}
                        | ({} if names else {"pin": bar["pin"]}) | ({"body": bar["body"]} if "body" in bar else {}))
            names.append(name)
            own = f"linkages[{linkage['name']}].{role}"
            moved |= {f"links[{name}].joint.a": f"{own}.length", f"links[{name}].joint.friction": f"{own}.friction",
                      f"links[{name}]": own}
        links[there:there] = made
        loops = tables(data.setdefault("loops", []), f"{where}: loops")
        loops.append({"name": linkage["name"], "link": names[1], "posture": linkage["posture"],
                      "to": {"link": linkage["moves"], "pin": linkage["coupler"]["pin"]}})
        moved |= {f"loops[{linkage['name']}].to.pin": f"linkages[{linkage['name']}].coupler.pin",
                  f"loops[{linkage['name']}]": f"linkages[{linkage['name']}]"}
    return moved
