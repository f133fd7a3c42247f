"""What is between pump and piston: the oil, and for each actuator its valve, hoses and leaks.

Ports are called as on every valve: P supply, T tank, A the head side of a cylinder or side a of a motor, B the other.
A number with a `sigma` is identified from logs, one without is exact; so are in any case those that only define others
or a shape: the commands in neutral and at full opening, rounding, drops and the air's exponent. What is not
stated is not modelled.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

from pydantic import Field, StrictBool

from hydroopt.machine.quantity import (
    Command,
    Duration,
    Flow,
    ImpossibleError,
    LeakageConductance,
    Noun,
    Number,
    Pressure,
    Rate,
    Volume,
)

EDGES = ("flow_pa", "flow_at", "flow_pb", "flow_bt")
"""The four metering edges of a valve: from P to A, A to T, P to B and B to T."""


class Oil(Noun):
    """The fluid."""

    bulk_modulus: Pressure = Field(gt=0)
    """Bulk modulus without air."""
    air: Number = Field(0.0, ge=0, le=0.5)
    """Free air, as a part of the volume at ambient pressure."""
    polytropic: Number = Field(1.4, ge=1.0, le=1.67)
    """Exponent n of the air's p·Vⁿ = const: 1 where it takes its time, 1.4 where it has none."""


class Valve(Noun):
    """A proportional directional valve with four metering edges.

    A command off `neutral` by more than the dead band moves the spool; at `full` it is fully displaced towards P→A and
    B→T, which extends a cylinder and turns a motor positively, and as far on the other side of `neutral` towards P→B
    and A→T. The spool follows as a system of second order, or at once if its frequency is not stated.
    """

    command: Literal["1", "V", "A"] = "1"
    """Unit of the command, and of `neutral`, `full` and the dead bands."""
    neutral: Command = 0.0
    """Command at rest."""
    full: Command = 1.0
    """Command at full opening towards P→A and B→T."""
    dead_band: Command = Field(0.0, ge=0)
    """Change of the command off neutral that does not move the spool."""
    dead_band_reverse: Command | None = Field(None, ge=0)
    """The same on the side that retracts; as `dead_band` if not stated."""
    overlap: Number = Field(0.0, gt=-1, lt=1)
    """Travel of the spool, as a part of its full travel, before an edge opens; negative is an underlap."""
    rounding: Number = Field(0.01, gt=0, le=0.2)
    """Range, as a part of the travel, over which dead band and edges set in: the clearance between spool and housing
    (Eryilmaz and Wilson 2006)."""
    rated_flow: Flow | None = Field(None, gt=0)
    """Flow of each edge for which none is stated, fully open at `rated_drop`."""
    flow_pa: Flow | None = Field(None, gt=0)
    """Flow from P to A."""
    flow_at: Flow | None = Field(None, gt=0)
    """Flow from A to T."""
    flow_pb: Flow | None = Field(None, gt=0)
    """Flow from P to B."""
    flow_bt: Flow | None = Field(None, gt=0)
    """Flow from B to T."""
    rated_drop: Pressure = Field(gt=0)
    """Pressure drop over one edge at which the flows hold."""
    laminar_drop: Pressure = Field(5e4, gt=0)
    """Drop below which an edge's flow is laminar."""
    natural_frequency: Rate | None = Field(None, gt=0)
    """Natural frequency of the spool."""
    damping: Number | None = Field(None, gt=0, le=10)
    """Damping of the spool; with `natural_frequency`."""
    delay: Duration = Field(0.0, ge=0, le=10)
    """By what commands arrive later; a number of θ where it is not zero."""

    def _mistakes(self) -> Iterator[ImpossibleError]:
        if self.neutral == self.full:
            yield ImpossibleError("the valve is fully open at its neutral command", "correct one of the two", "full")
        for key in ("dead_band", "dead_band_reverse"):
            if (getattr(self, key) or 0.0) >= abs(self.full - self.neutral):
                yield ImpossibleError(f"the dead band of {getattr(self, key):.6g} {self.command} leaves nothing of the "
                                      f"{abs(self.full - self.neutral):.6g} {self.command} between neutral and full",
                                      "correct one of them", key)
        missing = [key for key in EDGES if getattr(self, key) is None]
        if missing and self.rated_flow is None:
            yield ImpossibleError(f"the flow of {', '.join(missing)} is not stated", "state it, or 'rated_flow'",
                                  missing[0])
        if not missing and self.rated_flow is not None:
            yield ImpossibleError("every edge states its own flow, so that the rated flow has no effect", "remove it",
                                  "rated_flow")
        if (self.natural_frequency is None) != (self.damping is None):
            absent = "damping" if self.damping is None else "natural_frequency"
            yield ImpossibleError("the dynamics of the spool are incomplete", f"state '{absent}' as well, or neither",
                                  absent)

    @property
    def span(self) -> float:
        """Command between neutral and full opening, with its sign."""
        return self.full - self.neutral


class Circuit(Noun):
    """What feeds one actuator: its valve, hoses and leaks."""

    valve: Valve
    """The valve."""
    volume_a: Volume = Field(gt=0)
    """Volume of hose and dead space at port A."""
    volume_b: Volume = Field(gt=0)
    """Volume of hose and dead space at port B."""
    hose_modulus: Pressure | None = Field(None, gt=0)
    """Pressure that would widen the hoses by their own volume."""
    leakage: LeakageConductance | None = Field(None, ge=0)
    """Conductance past the piston."""
    leakage_a: LeakageConductance | None = Field(None, ge=0)
    """Conductance from chamber A to the tank."""
    leakage_b: LeakageConductance | None = Field(None, ge=0)
    """Conductance from chamber B to the tank."""
    air_a: Number | None = Field(None, ge=0, le=0.9)
    """Free air in chamber A and its hose, as a part of its volume at ambient pressure, where it differs from the oil's.
    """
    air_b: Number | None = Field(None, ge=0, le=0.9)
    """Free air in chamber B and its hose, likewise."""
    anticavitation: StrictBool = False
    """Whether check valves let oil follow from the tank when a chamber's pressure falls below the tank's."""
