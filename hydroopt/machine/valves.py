"""What is between pump and piston: the oil, and for each actuator its valve, hoses and leaks.

Ports are called as on every valve: P supply, T tank, A the head side of a cylinder or side a of a motor, B the other.
A number with a `sigma` is identified from logs, one without is exact; so are in any case those that only define others
or a shape: the commands in neutral and at full opening, rounding, drops, delay and the air's exponent. What is not
stated is not modelled.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, Self

from pydantic import Field, ValidationInfo, model_validator

from hydroopt.machine.quantity import (
    Duration,
    Flow,
    ImpossibleError,
    LeakageConductance,
    Noun,
    Number,
    Pressure,
    Quantity,
    Rate,
    Volume,
    keyed,
)

EDGES = ("flow_pa", "flow_at", "flow_pb", "flow_bt")
"""The four metering edges of a valve: from P to A, A to T, P to B and B to T."""


class Oil(Noun):
    """The fluid: its bulk modulus without air, and the part of its volume at ambient pressure that is free air.

    The air follows p·Vⁿ = const with the exponent n = `polytropic`: 1 where it takes its time, 1.4 where it has none.
    """

    bulk_modulus: Pressure = Field(gt=0)
    air: Number = Field(0.0, ge=0, le=0.5)
    polytropic: Number = Field(1.4, ge=1.0, le=1.67)


class Valve(Noun):
    """A proportional directional valve with four metering edges.

    A command off `neutral` by more than the `dead_band` (`dead_band_reverse` on the side that retracts) moves the
    spool; at `full` it is fully spool_position towards P→A and B→T, which extends a cylinder and turns a motor
    positively, and as far on the other side of `neutral` towards P→B and A→T. These three and the dead bands have the
    unit `command`. An edge opens when the spool has travelled `overlap`, a part of its full travel; a negative one is
    an underlap. `rounding`, likewise a part of the travel, is the range over which dead band and edges set in: the
    clearance between spool and housing (Eryilmaz and Wilson 2006). Fully open, an edge lets its flow pass at the
    pressure drop `rated_drop`; `rated_flow` is that of all edges for which none is stated. Below `laminar_drop` an
    edge's flow is laminar. The spool follows as a system of second order with `natural_frequency` and `damping`, or at
    once if these are not stated; commands arrive later by `delay`.
    """

    command: Literal["1", "V", "A"] = "1"
    neutral: float = Field(0.0, allow_inf_nan=False)
    full: float = Field(1.0, allow_inf_nan=False)
    dead_band: float = Field(0.0, ge=0, allow_inf_nan=False)
    dead_band_reverse: float | None = Field(None, ge=0, allow_inf_nan=False)
    overlap: Number = Field(0.0, gt=-1, lt=1)
    rounding: Number = Field(0.01, gt=0, le=0.2)
    rated_flow: Flow | None = Field(None, gt=0)
    flow_pa: Flow | None = Field(None, gt=0)
    flow_at: Flow | None = Field(None, gt=0)
    flow_pb: Flow | None = Field(None, gt=0)
    flow_bt: Flow | None = Field(None, gt=0)
    rated_drop: Pressure = Field(gt=0)
    laminar_drop: Pressure = Field(5e4, gt=0)
    natural_frequency: Rate | None = Field(None, gt=0)
    damping: Number | None = Field(None, gt=0, le=10)
    delay: Duration = Field(0.0, ge=0, le=10)

    @model_validator(mode="before")
    @classmethod
    def _commands(cls, data: Any, info: ValidationInfo) -> Any:
        # the unit of a command is stated beside it, so that a field's annotation cannot state it
        if not isinstance(data, Mapping) or data.get("command", "1") not in ("1", "V", "A"):
            return data
        data = dict(data)
        for key in ("neutral", "full", "dead_band", "dead_band_reverse"):
            if data.get(key) is not None:
                data[key] = keyed(Quantity(data.get("command", "1")), data[key], info, key)
        return data

    @model_validator(mode="after")
    def _whole(self) -> Self:
        if self.neutral == self.full:
            raise ImpossibleError("the valve is fully open at its neutral command", "correct one of the two", "full")
        for key in ("dead_band", "dead_band_reverse"):
            if (getattr(self, key) or 0.0) >= abs(self.full - self.neutral):
                raise ImpossibleError(f"the dead band of {getattr(self, key):.6g} {self.command} leaves nothing of the "
                                      f"{abs(self.full - self.neutral):.6g} {self.command} between neutral and full",
                                      "correct one of them", key)
        missing = [key for key in EDGES if getattr(self, key) is None]
        if missing and self.rated_flow is None:
            raise ImpossibleError(f"the flow of {', '.join(missing)} is not stated", "state it, or 'rated_flow'",
                                  missing[0])
        if not missing and self.rated_flow is not None:
            raise ImpossibleError("every edge states its own flow, so that the rated flow has no effect", "remove it",
                                  "rated_flow")
        if (self.natural_frequency is None) != (self.damping is None):
            absent = "damping" if self.damping is None else "natural_frequency"
            raise ImpossibleError("the dynamics of the spool are incomplete", f"state '{absent}' as well, or neither",
                                  absent)
        return self

    @property
    def span(self) -> float:
        """Command between neutral and full opening, with its sign."""
        return self.full - self.neutral


class Circuit(Noun):
    """What feeds one actuator: its valve, hoses and leaks.

    `volume_a` and `volume_b` are those of the hoses and dead spaces at the ports A and B, `hose_modulus` is that of
    their walls: the pressure that would widen them by their own volume. `leakage` passes the piston, `leakage_a` and
    `leakage_b` leave the chambers for the tank. `air_a` and `air_b` are free air in the oil of a chamber and its hose,
    as a part of its volume at ambient pressure, where there is more or less of it than in the rest. With
    `anticavitation` check valves let oil follow from the tank when a chamber's pressure falls below the tank's.
    """

    valve: Valve
    volume_a: Volume = Field(gt=0)
    volume_b: Volume = Field(gt=0)
    hose_modulus: Pressure | None = Field(None, gt=0)
    leakage: LeakageConductance | None = Field(None, ge=0)
    leakage_a: LeakageConductance | None = Field(None, ge=0)
    leakage_b: LeakageConductance | None = Field(None, ge=0)
    air_a: Number | None = Field(None, ge=0, le=0.9)
    air_b: Number | None = Field(None, ge=0, le=0.9)
    anticavitation: bool = False
