"""Targets: points of links, base or ground that instruments see, that tapes join and that touch datums."""

from __future__ import annotations

from typing import Any

from hydroopt.machine.quantity import Angle, Lengths, Name, Noun

TIP = "tip"
"""The target that a calibrator's tip is; its frame is the tool's."""


class Target(Noun):
    """A prism, a ball, a punched mark or a marker on a link.

    >>> Target(name="stick_prism", link="stick", position=(1.2, 0.3, 0.0)).link
    'stick'
    """

    name: Name
    """Name of the target."""
    link: str | None = None
    """Link that carries it, or `base`; if not stated, or `ground`, it rests, also where the base moves."""
    position: Lengths = (0.0, 0.0, 0.0)
    """Place (3,) in the frame in which pins of that link are stated (P_i, or the base frame)."""
    orientation: tuple[Angle, Angle, Angle] = (0.0, 0.0, 0.0)
    """Roll, pitch, yaw there; a point needs none."""


def expand(data: dict[str, Any]) -> None:
    """Leave out the link of what stands on the ground, in a description that was validated: of a machine without a link
    of that name, `ground` is what rests."""
    if all(link["name"] != "ground" for link in data["links"]):
        for part in (*data.get("targets", []), *data.get("instruments", [])):
            if part.get("link") == "ground":
                del part["link"]
