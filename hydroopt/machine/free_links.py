"""Links that joints do not hold: a platform on cylinders, a base in motion; as the chain of joints they stand for.

First comes the position along x, y, z of the link's parent, then yaw about z, pitch about y and roll about x. Of a base
that stands on a slope or moves they lead from the frame `base`, which rests, to the link `chassis`, on which all stands
that the file puts on the base. The ground moves these joints, by forces that are not measured, so that their equations
are eliminated; their positions are measured.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from hydroopt.machine.quantity import AngularSpeed, ImpossibleError, JointAcceleration, Noun, Position


class Coordinate(Noun):
    """Limits of one coordinate of a free link, as of the joint that stands for it."""

    lower: Position | None = None
    """Lower limit; both are needed."""
    upper: Position | None = None
    """Upper limit."""
    max_speed: AngularSpeed | None = None
    """Greatest speed."""
    max_acceleration: JointAcceleration | None = None
    """Greatest acceleration."""


class FreeLink(Noun):
    """Coordinates by which a link moves that no joint holds; a chain of joints stands for those that are stated.

    Of a link `platform` they are `platform_x` … `platform_roll`; of `[base_motion]`, which the ground moves, `base_x` …
    `base_roll`, and the link `chassis` carries what the file puts on the base.
    """

    x: Coordinate | None = None
    """Along x of the parent."""
    y: Coordinate | None = None
    """Along y."""
    z: Coordinate | None = None
    """Along z."""
    yaw: Coordinate | None = None
    """Turn about z, first."""
    pitch: Coordinate | None = None
    """Turn about y, second."""
    roll: Coordinate | None = None
    """Turn about x, third."""

    def _mistakes(self) -> Iterator[ImpossibleError]:
        if not self.model_fields_set:
            yield ImpossibleError("no coordinate is stated",
                                  "state some, such as roll = { lower = \"-10 deg\", upper = \"10 deg\" }")

AXES = {"x": "x", "y": "y", "z": "z", "yaw": "z", "pitch": "y", "roll": "x"}
"""Coordinates in the order of their joints, and the axis of each."""
_TURN = {"x": ({"beta": "90 deg"}, {"beta": "-90 deg"}), "y": ({"alpha": "-90 deg"}, {"alpha": "90 deg"})}
"""How z turns to an axis, and back."""

CHASSIS = "chassis"
"""The link that carries what stands on a moving base."""


def expand(data: dict[str, Any]) -> dict[str, str]:
    """Put chains of joints in the place of the tables `free` of links of a description that was validated.

    Of a link ``platform`` they are ``platform_x`` … ``platform_roll``, those that its table states; the link itself is
    locked to the last one.

    Returns:
        Which place of the machine stands where in the file.
    """
    moved: dict[str, str] = {}
    links: list[dict[str, Any]] = []
    for link in data["links"]:
        if "free" in link:
            name, limits = link["name"], link.pop("free")
            links += chain(name, link["parent"], limits)
            moved |= {f"links[{name}_{key}].joint": f"links[{name}].free.{key}" for key in limits}
            link |= {"parent": links[-1]["name"], "joint": {"type": "locked"}}
        links.append(link)
    data["links"] = links
    return moved


def chain(name: str, parent: str, limits: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The links whose joints stand for coordinates of a free link.

    Args:
        name: what the names of the joints begin with.
        parent: the link that the coordinates refer to.
        limits: of the joints by coordinate.
    """
    made: list[dict[str, Any]] = []

    def add(own: str, joint: dict[str, Any]) -> None:
        made.append({"name": own, "parent": made[-1]["name"] if made else parent, "joint": joint})

    for key in (key for key in AXES if key in limits):
        back: dict[str, Any] = {}
        if AXES[key] in _TURN:
            there, back = _TURN[AXES[key]]
            add(f"{name}_{key}_axis", {"type": "locked", **there})
        add(f"{name}_{key}", {"type": "prismatic" if key in "xyz" else "revolute", **back, **limits[key]})
    return made


def expand_base(data: dict[str, Any]) -> dict[str, str]:
    """Put joints in the place of the table `base_motion` of a description that was validated.

    Returns:
        Which place of the machine stands where in the file.
    """
    if "base_motion" not in data:
        return {}
    stated = data.pop("base_motion")
    links = chain("base", "base", stated)
    moving = [key for key in AXES if key in stated]
    drives = [{"name": f"base_{key}_ground", "joint": f"base_{key}", "measured": False,
               "ground": True} for key in moving]
    _on_chassis(data)
    links.append({"name": CHASSIS, "parent": links[-1]["name"], "joint": {"type": "locked"}})
    data["links"] = [*links, *data["links"]]
    data["drives"] = [*drives, *data.get("drives", [])]
    return {f"links[base_{key}].joint": f"base_motion.{key}" for key in moving}


def _on_chassis(node: Any) -> None:
    """Attach to the chassis what the file attaches to the base."""
    if isinstance(node, dict):
        node |= {key: CHASSIS for key in ("link", "parent") if node.get(key) == "base"}
    for inner in node.values() if isinstance(node, dict) else node if isinstance(node, list) else ():
        _on_chassis(inner)
