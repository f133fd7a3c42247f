"""Common linkages by name: what a few pins say, as the links and the loop that they stand for.

A rocker and a coupler between a link and the one that its joint moves: the linkage of an excavator's bucket, the tilt
linkage of a log crane, the Z-bar of a wheel loader, the dual link of a knuckle boom.
"""

from __future__ import annotations

from typing import Any

from pydantic import Field

from hydroopt.errors import MachineError
from hydroopt.machine.links import Body, JointFriction
from hydroopt.machine.quantity import Length, Lengths, Name, Noun, Position

_BARS = ("rocker", "coupler")


class Bar(Noun):
    """A rocker or coupler of a linkage: a link that turns, as long as the distance between its pins."""

    pin: Lengths
    """Of the rocker, on the parent of the link that the linkage moves; of the coupler, on this link."""
    length: Length
    """Distance between its pins."""
    name: Name | None = None
    """Name of its link; `rocker` or `coupler` if not given."""
    friction: JointFriction | None = None
    """Friction of its joint: the rocker's at its pin, the coupler's at the rocker's far end."""
    body: Body | None = None
    """What it weighs, in its link's frame."""


class Linkage(Noun):
    """A rocker and a coupler between a link and the one that its joint moves; two links and a loop stand for them.

    Excavator's bucket, tilt of a log crane, Z-bar of a wheel loader, dual link of a knuckle boom.
    """

    name: Name
    """Name, also of the loop."""
    moves: str
    """The link that it moves."""
    rocker: Bar
    """The bar that turns about its pin on the parent of that link."""
    coupler: Bar
    """The bar between the rocker's far end and its pin on that link."""
    posture: dict[str, Position] = Field(min_length=1)
    """Positions of joints near a posture in which the loop is closed, which tells on which side it is."""


def expand(data: dict[str, Any], where: str) -> dict[str, str]:
    """Put links and loops in the place of the linkages of a description that was validated.

    The rocker turns about its `pin` on the parent of the link that the linkage `moves`, and the coupler connects the
    rocker's far end to the coupler's `pin` on this link.

    Returns:
        Which place of the machine stands where in the file.

    Raises:
        MachineError: there is no such link, or a name is taken.
    """
    moved: dict[str, str] = {}
    links = data["links"]
    for linkage in data.pop("linkages", []):
        at = f"{where}: linkages[{linkage['name']}]"
        there = next((i for i, link in enumerate(links) if link["name"] == linkage["moves"]), None)
        if there is None:
            raise MachineError(f"the linkage moves '{linkage['moves']}', which is not a link", where=f"{at}.moves",
                               remedy="name the link that it moves")
        names: list[str] = []
        made: list[dict[str, Any]] = []
        for role in _BARS:
            bar = linkage[role]
            name = bar.get("name", role)
            if any(link["name"] == name for link in links):
                raise MachineError(f"the name '{name}' is taken", where=f"{at}.{role}",
                                   remedy=f'give it a name of its own: name = "{linkage["name"]}_{role}"')
            joint = {"type": "revolute", "dependent": True, "a": bar["length"]}
            joint |= {key: bar[key] for key in ("friction",) if key in bar}
            made.append({"name": name, "parent": names[0] if names else links[there]["parent"], "joint": joint}
                        | ({} if names else {"pin": bar["pin"]}) | ({"body": bar["body"]} if "body" in bar else {}))
            names.append(name)
            own = f"linkages[{linkage['name']}].{role}"
            moved |= {f"links[{name}].joint.a": f"{own}.length", f"links[{name}].joint.friction": f"{own}.friction",
                      f"links[{name}]": own}
        links[there:there] = made
        data.setdefault("loops", []).append({
            "name": linkage["name"], "link": names[1], "posture": linkage["posture"],
            "to": {"link": linkage["moves"], "pin": linkage["coupler"]["pin"]}})
        moved |= {f"loops[{linkage['name']}].to.pin": f"linkages[{linkage['name']}].coupler.pin",
                  f"loops[{linkage['name']}]": f"linkages[{linkage['name']}]"}
    return moved
