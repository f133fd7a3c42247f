"""Instruments that measure where targets are: total stations, laser trackers, cameras."""

from __future__ import annotations

import math
from typing import Self

from pydantic import model_validator

from hydroopt.machine.quantity import Angle, ImpossibleError, Lengths, Name, Noun

TURNED_UP = math.radians(85.0)
"""Pitch beyond which roll and yaw of an instrument can hardly be distinguished."""


class Instrument(Noun):
    """What measures places, and maybe orientations, of targets in its own frame.

    Of a target `prism`, an instrument `station` reads ``station.prism.x``, ``.y``, ``.z`` [m], and the orientation of
    the target's frame as a rotation vector ``station.prism.rx``, ``.ry``, ``.rz`` [rad] or a quaternion
    ``station.prism.qw``, ``.qx``, ``.qy``, ``.qz``.

    >>> Instrument(name="station").stands
    False
    """

    name: Name
    """Name of the instrument."""
    link: str | None = None
    """Link that carries it, or `base`; if not stated, or `ground`, it stands on the ground."""
    position: Lengths | None = None
    """Place (3,) of its frame; without it its pose is unknown, and another one in each set-up that a pose table's
    column ``setup`` names."""
    orientation: tuple[Angle, Angle, Angle] | None = None
    """Roll, pitch, yaw of its frame."""

    @property
    def stands(self) -> bool:
        """Whether the file states where it is."""
        return self.position is not None

    @property
    def turn(self) -> tuple[float, float, float]:
        """Its stated orientation [rad]."""
        return self.orientation or (0.0, 0.0, 0.0)

    @model_validator(mode="after")
    def _stated(self) -> Self:
        if self.orientation is not None and self.position is None:
            raise ImpossibleError(f"'{self.name}' states its orientation, but not its position",
                                  "state both, or neither if they are not known", "orientation")
        if abs(self.turn[1]) > TURNED_UP:
            raise ImpossibleError(f"'{self.name}' is pitched by {math.degrees(self.turn[1]):.0f} deg, where roll and "
                                  "yaw are the same turn", "leave out its position and orientation: they are estimated",
                                  "orientation")
        return self
