"""Usual sizes of faults that a machine file states: how late, tilted or off its instruments may be."""

from __future__ import annotations

from pydantic import Field

from hydroopt.machine.quantity import Angle, Duration, Noun, Number


class FaultSizes(Noun):
    """Standard deviations of faults: `delay` and `lag` of readings, drift of one `clock` against the other over a log,
    `tilt` of the base, `offset` of an angle, `play` of a joint against its sensor, `gain` of a force reading as a part
    of it, its `drift` over a log and a missing term of `friction` as parts of the RMS force. What is not stated has a
    usual size.

    >>> FaultSizes(delay="10 ms", gain="2 %").gain
    0.02
    """

    delay: Duration | None = Field(None, gt=0)
    lag: Duration | None = Field(None, gt=0)
    clock: Duration | None = Field(None, gt=0)
    tilt: Angle | None = Field(None, gt=0)
    offset: Angle | None = Field(None, gt=0)
    play: Angle | None = Field(None, gt=0)
    gain: Number | None = Field(None, gt=0)
    drift: Number | None = Field(None, gt=0)
    friction: Number | None = Field(None, gt=0)

    def of(self, group: str) -> float | None:
        """The size [SI] stated for a group of faults, None where there is none."""
        size: float | None = getattr(self, group, None)
        return size
