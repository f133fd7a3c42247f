"""What the poses of a calibration are measured with: targets, and the instruments, tapes and datums beside them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Literal

from pydantic import Field

from hydroopt.machine.quantity import CHANNEL_UNITS, Angle, ImpossibleError, Length, Lengths, Name, Noun, Part
from hydroopt.machine.sensors import Measuring

TIP = "tip"
"""The target that a calibrator's tip is; its frame is the tool's."""
SEEN = {axis: CHANNEL_UNITS[axis][0] for axis in ("x", "y", "z", "rx", "ry", "rz", "qw", "qx", "qy", "qz")}
"""Components of a target's measured position, and of its orientation as rotation vector or quaternion; SI units."""


class Target(Part):
    """A prism, a ball, a punched mark or a marker on a link.

    >>> Target(name="stick_prism", link="stick", position=(1.2, 0.3, 0.0)).link
    'stick'
    """

    link: str | None = None
    """Link that carries it, or `base`; if not stated, or `ground`, it rests, also where the base moves."""
    position: Lengths = (0.0, 0.0, 0.0)
    """Place (3,) in the frame in which pins of that link are stated (P_i, or the base frame)."""
    orientation: tuple[Angle, Angle, Angle] = (0.0, 0.0, 0.0)
    """Roll, pitch, yaw there; a point needs none."""


TURNED_UP = math.radians(85.0)
"""Pitch beyond which roll and yaw of an instrument can hardly be distinguished."""


class Instrument(Measuring):
    """What measures places, and maybe orientations, of targets in its own frame.

    Of a target `prism`, an instrument `station` reads ``station.prism.x``, ``.y``, ``.z`` [m], and the orientation of
    the target's frame as a rotation vector ``station.prism.rx``, ``.ry``, ``.rz`` [rad] or a quaternion
    ``station.prism.qw``, ``.qx``, ``.qy``, ``.qz``.

    >>> Instrument(name="station").stands
    False
    """

    link: str | None = None
    """Link that carries it, or `base`; if not stated, or `ground`, it stands on the ground."""
    position: Lengths | None = None
    """Place (3,) of its frame; without it its pose is unknown, and another one in each set-up that a pose table's
    column ``setup`` names."""
    orientation: tuple[Angle, Angle, Angle] | None = None
    """Roll, pitch, yaw of its frame."""

    def channel_units(self, targets: Sequence[str]) -> dict[str, str]:
        """Of each target."""
        return {f"{self.name}.{target}.{axis}": unit for target in targets for axis, unit in SEEN.items()}

    @property
    def stands(self) -> bool:
        """Whether the file states where it is."""
        return self.position is not None

    @property
    def turn(self) -> tuple[float, float, float]:
        """Its stated orientation [rad]."""
        return self.orientation or (0.0, 0.0, 0.0)

    def _mistakes(self) -> Iterator[ImpossibleError]:
        if self.orientation is not None and self.position is None:
            yield ImpossibleError(f"'{self.name}' states its orientation, but not its position",
                                  "state both, or neither if they are not known", "orientation")
        if abs(self.turn[1]) > TURNED_UP:
            yield ImpossibleError(f"'{self.name}' is pitched by {math.degrees(self.turn[1]):.0f} deg, where roll and "
                                  "yaw are the same turn", "leave out its position and orientation: they are estimated",
                                  "orientation")

ACROSS = {"plane": ("z",), "line": ("y", "z")}
"""Along which axes of its frame a datum tells where a target is."""
TILTS = {"plane": ("roll", "pitch"), "line": ("pitch", "yaw")}
"""Turns of its frame that change a datum."""


class Datum(Measuring):
    """A plane, the x-y plane of its frame, or a line, the x axis of its frame.

    The frame is shifted along its own axes by `offset` and turned by `tilt`, which are what a calibration may change:
    with a `sigma`, the datum is known so well only.

    Poses that touch it say so in the columns ``floor.tooth.z`` [m], of a plane `floor` and a target `tooth`, or
    ``edge.tooth.y`` and ``.z`` of a line: zero, or the radius of a touching ball.

    >>> Datum(name="floor", position=(0.0, 0.0, -1.2)).axes
    ('z',)
    """

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

    def channel_units(self, targets: Sequence[str]) -> dict[str, str]:
        """Of each target that touches it."""
        return {f"{self.name}.{target}.{axis}": "m" for target in targets for axis in self.axes}

    @property
    def axes(self) -> tuple[str, ...]:
        """The axes across it."""
        return ACROSS[self.kind]

    @property
    def tilts(self) -> tuple[str, ...]:
        """The turns that change it."""
        return TILTS[self.kind]


class Tracker(Noun):
    """An instrument that tracks the tip in the columns `tip.x`, `tip.y`, `tip.z` of a pose table."""

    position: Lengths = (0.0, 0.0, 0.0)
    """Place (3,) of its frame in the base frame."""
    orientation: tuple[Angle, Angle, Angle] = (0.0, 0.0, 0.0)
    """Roll, pitch, yaw of its frame."""


class Distance(Measuring):
    """A distance between two points."""

    between: tuple[Name, Name]
    """Two fixtures, or two targets of links, base or ground."""
    length: Length | None = Field(None, gt=0)
    """Between fixtures the known length, which determines the scale of a closed chain (Section 3.6.4); between targets
    none: poses read it in the column ``<name>.length``."""

    def channel_units(self, targets: Sequence[str]) -> dict[str, str]:
        """None of a known length."""
        return {f"{self.name}.length": "m"} if self.measured else {}

    @property
    def measured(self) -> bool:
        """Whether poses read it."""
        return self.length is None
