"""Datums: planes and lines of the ground that targets touch."""

from __future__ import annotations

from typing import Literal

from hydroopt.machine.quantity import Angle, Lengths, Name, Noun

ACROSS = {"plane": ("z",), "line": ("y", "z")}
"""Along which axes of its frame a datum tells where a target is."""
TILTS = {"plane": ("roll", "pitch"), "line": ("pitch", "yaw")}
"""Turns of its frame that change a datum."""


class Datum(Noun):
    """A plane, the x-y plane of its frame, or a line, the x axis of its frame.

    The frame is shifted along its own axes by `offset` and turned by `tilt`, which are what a calibration may change:
    with a `sigma`, the datum is known so well only.

    Poses that touch it say so in the columns ``floor.tooth.z`` [m], of a plane `floor` and a target `tooth`, or
    ``edge.tooth.y`` and ``.z`` of a line: zero, or the radius of a touching ball.

    >>> Datum(name="floor", position=(0.0, 0.0, -1.2)).axes
    ('z',)
    """

    name: Name
    """Name of the datum."""
    kind: Literal["plane", "line"] = "plane"
    """Plane or line."""
    position: Lengths = (0.0, 0.0, 0.0)
    """Place (3,) of its frame in the frame of what rests."""
    orientation: tuple[Angle, Angle, Angle] = (0.0, 0.0, 0.0)
    """Roll, pitch, yaw of its frame."""
    offset: Lengths = (0.0, 0.0, 0.0)
    """Shift (3,) along its own axes."""
    tilt: tuple[Angle, Angle, Angle] = (0.0, 0.0, 0.0)
    """Roll, pitch, yaw about its own axes."""

    @property
    def axes(self) -> tuple[str, ...]:
        """The axes across it."""
        return ACROSS[self.kind]

    @property
    def tilts(self) -> tuple[str, ...]:
        """The turns that change it."""
        return TILTS[self.kind]
