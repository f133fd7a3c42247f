"""Targets: points of links, base or ground that instruments see, that tapes join and that touch datums."""

from __future__ import annotations

from hydroopt.machine.quantity import Angle, Lengths, Name, Noun

GROUND = "ground"
"""What rests: the base frame, also of a machine whose own base moves on it."""
TIP = "tip"
"""The target that a calibrator's tip is; its frame is the tool's."""


class Target(Noun):
    """A prism, a ball, a punched mark or a marker on a link.

    >>> Target(name="stick_prism", link="stick", position=(1.2, 0.3, 0.0)).link
    'stick'
    """

    name: Name
    """Name of the target."""
    link: str
    """Link, `base` or `ground` that carries it."""
    position: Lengths = (0.0, 0.0, 0.0)
    """Place (3,) in the frame in which pins of that link are stated (P_i, or the base frame)."""
    orientation: tuple[Angle, Angle, Angle] = (0.0, 0.0, 0.0)
    """Roll, pitch, yaw there; a point needs none."""
