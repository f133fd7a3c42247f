"""Usual sizes of faults that a machine file states: how late, tilted or off its instruments may be."""

from __future__ import annotations

from pydantic import Field

from hydroopt.machine.quantity import Angle, Duration, Noun, Number


class FaultSizes(Noun):
    """Standard deviations of faults; what is not stated has a usual size.

    >>> FaultSizes(delay="10 ms", gain="2 %").gain
    0.02
    """

    delay: Duration | None = Field(None, gt=0)
    """Delay of readings."""
    lag: Duration | None = Field(None, gt=0)
    """Lag of readings."""
    clock: Duration | None = Field(None, gt=0)
    """Drift of one clock against the other over a log."""
    tilt: Angle | None = Field(None, gt=0)
    """Tilt of the base."""
    offset: Angle | None = Field(None, gt=0)
    """Offset of an angle."""
    play: Angle | None = Field(None, gt=0)
    """Play of a joint against its sensor."""
    gain: Number | None = Field(None, gt=0)
    """Error of a force reading's gain, as a part of it; intervals of `identify` and `weigh` contain it if stated."""
    drift: Number | None = Field(None, gt=0)
    """Drift of a force reading over a log, as a part of the RMS force."""
    friction: Number | None = Field(None, gt=0)
    """A missing term of friction, as a part of the RMS force."""

    def of(self, group: str) -> float | None:
        """The size [SI] stated for a group of faults, None where there is none."""
        size: float | None = getattr(self, group, None)
        return size
