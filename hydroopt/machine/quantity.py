"""Physical quantities as pydantic fields: a number in SI, or a string with its unit."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import cache
from typing import Annotated, Any, Self

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationInfo, model_validator

from hydroopt.units import ImplausibleError, UnitError, implausible, plausible, to_si

CHANNEL_UNITS = {"q": ("rad", "m"), "qd": ("rad/s", "m/s"), "qdd": ("rad/s^2", "m/s^2"), "tau": ("N*m", "N"),
                 "length": ("m",), "force": ("N",), "p_head": ("Pa",), "p_rod": ("Pa",), "p_a": ("Pa",), "p_b": ("Pa",),
                 "p_supply": ("Pa",), "p_tank": ("Pa",), "u": ("V", "1", "A"), "x": ("m",), "y": ("m",), "z": ("m",),
                 "distance": ("m",), **dict.fromkeys(("fx", "fy", "fz"), ("N",)),
                 **dict.fromkeys(("mx", "my", "mz"), ("N*m",)), **dict.fromkeys(("rx", "ry", "rz"), ("rad",)),
                 **dict.fromkeys(("qw", "qx", "qy", "qz"), ("1",)),
                 **dict.fromkeys(("gyro_x", "gyro_y", "gyro_z"), ("rad/s",)),
                 **dict.fromkeys(("accel_x", "accel_y", "accel_z"), ("m/s^2",)),
                 **dict.fromkeys(("roll", "pitch"), ("rad",))}
"""SI units that a channel may have, by the part of its name after the dot; the first is the usual one."""


class Noun(BaseModel):
    """Base of all parts of a machine: frozen, no unknown keys."""

    model_config = ConfigDict(frozen=True, extra="forbid", defer_build=True)

    @model_validator(mode="after")
    def _possible(self) -> Self:
        for mistake in self._mistakes():
            raise mistake
        return self

    def _mistakes(self) -> Iterator[ImpossibleError]:
        """What no machine can fulfil of what its keys state together; the first mistake is raised."""
        yield from ()


class ImpossibleError(ValueError):
    """A statement that no machine can fulfil; `description` adds the place and raises a MachineError.

    `key` names the one at fault where a rule over several keys finds it.
    """

    def __init__(self, what: str, remedy: str, key: str = "") -> None:
        self.what, self.remedy, self.key = what, remedy, key
        super().__init__(f"{what}; {remedy}")


class Quantity:
    """Marks a field as a physical quantity: its SI unit, and the reading of ``"27.8 deg"``."""

    def __init__(self, si: str, *others: str) -> None:
        self.si, self.others = si, others

    @property
    def sliding(self) -> str:
        """The unit where it belongs to a joint that slides, not turns."""
        return self.others[0] if self.others else self.si

    def __call__(self, value: Any, info: ValidationInfo) -> Any:
        """SI value of a string with unit; a bare number passes only where code, not a file, states it."""
        if isinstance(value, str):
            problem: UnitError | None = None
            for si in (self.si, *self.others):
                try:
                    return to_si(value, si, where="")
                except UnitError as error:
                    problem = error if isinstance(error, ImplausibleError) else problem or error
            assert problem is not None
            raise ImpossibleError(problem.what, problem.remedy)
        if isinstance(value, bool):
            raise ImpossibleError(f"{str(value).lower()} is not a number", "write a number with its unit")
        if self.si != "1" and isinstance(value, int | float) and (info.context or {}).get("from_file"):
            raise ImpossibleError(f"{value:.9g} has no unit", f"write it as {with_likely_units(value, self.si)}" + (
                f', or as "{value:.9g} {self.sliding}" if it slides' if self.sliding != self.si else ""))
        if (isinstance(value, int | float) and (info.context or {}).get("from_file") and math.isfinite(value)
                and not plausible(value, self.si)):
            raise ImpossibleError(implausible(value, self.si), "correct it")
        return value


_WRITTEN = {"rad": ("deg", "rad"), "m": ("m", "mm"), "Pa": ("bar", "Pa"), "rad/s": ("deg/s", "rad/s")}
"""Units in which people mostly write quantities of an SI unit."""


LONGEST = 50.0
"""Length [m] of a link or cylinder, or distance of a pin, beyond those of machines."""
_BEYOND = {"rad": math.tau, "rad/s": math.tau, "m": LONGEST}
"""Size from which on a number is not in this unit but in another one of `_WRITTEN`."""


def with_likely_units(value: float, si: str) -> str:
    """A number without a unit, with each one that it may have.

    >>> with_likely_units(-20.0, "rad"), with_likely_units(0.35, "rad"), with_likely_units(90.0, "m")
    ('"-20 deg"', '"0.35 deg" or "0.35 rad"', '"90 mm"')
    """
    likely = [unit for unit in _WRITTEN.get(si, (si,))
              if abs(value) <= _BEYOND.get(unit, math.inf) and (unit != "mm" or abs(value) >= 1)]
    return " or ".join(f'"{value:.9g} {unit}"' for unit in likely)


def longer_than_machines(length: float) -> str:
    """What is probably wrong of a length [m] that no machine has, to add to a sentence; empty for others.

    >>> longer_than_machines(2.5), longer_than_machines(600.0)
    ('', ' (probably in mm)')
    """
    return " (probably in mm)" if length > LONGEST else ""


class Displacement(Quantity):
    """Marks what a motor displaces per angle, which is also its torque per pressure."""

    @property
    def sliding(self) -> str:
        """The same: the second unit is another way to write it."""
        return self.si

    def __call__(self, value: Any, info: ValidationInfo) -> Any:
        """As of any quantity; a volume alone, which has the dimension of torque per pressure, is refused."""
        found = super().__call__(value, info)
        if isinstance(value, str) and "/" not in value and "-1" not in value:
            raise ImpossibleError(f"'{value.strip()}' is a volume without the angle in which the motor displaces it",
                                  f"write it as \"{value.strip()}/rev\" or \"{value.strip()}/rad\"")
        return found


@cache
def quantity_of(kind: type[BaseModel], key: str) -> Quantity | None:
    """What marks a field, or the entries of its tuple or table, as a physical quantity; None of any other field."""
    field = kind.model_fields[key]
    return next((mark for mark in (*field.metadata, *_marks(field.annotation)) if isinstance(mark, Quantity)), None)


def _marks(annotation: Any) -> Iterator[Any]:
    for argument in getattr(annotation, "__args__", ()):
        yield from _marks(argument)
    yield from getattr(annotation, "__metadata__", ())


def _quantity(si: str, *others: str) -> tuple[Quantity, BeforeValidator]:
    mark = Quantity(si, *others)
    return mark, BeforeValidator(mark)


_finite = Field(allow_inf_nan=False)
Number = Annotated[float, *_quantity("1"), _finite]
Length = Annotated[float, *_quantity("m"), _finite]
Angle = Annotated[float, *_quantity("rad"), _finite]
Area = Annotated[float, *_quantity("m^2"), _finite]
Volume = Annotated[float, *_quantity("m^3"), _finite]
Pressure = Annotated[float, *_quantity("Pa"), _finite]
Force = Annotated[float, *_quantity("N"), _finite]
Torque = Annotated[float, *_quantity("N*m", "N"), _finite]  # of a joint: a force where the joint slides
PinTorque = Annotated[float, *_quantity("N*m"), _finite]
Mass = Annotated[float, *_quantity("kg"), _finite]
MassMoment = Annotated[float, *_quantity("kg*m"), _finite]
Inertia = Annotated[float, *_quantity("kg*m^2"), _finite]
Acceleration = Annotated[float, *_quantity("m/s^2"), _finite]
AngularViscosity = Annotated[float, *_quantity("N*m*s/rad", "N*s/m"), _finite]
LinearStiffness = Annotated[float, *_quantity("N/m"), _finite]
Stiffness = Annotated[float, *_quantity("N*m/rad", "N/m"), _finite]  # of a joint that turns or slides
AngularCompliance = Annotated[float, *_quantity("rad/(N*m)", "m/N"), _finite]
_displacement = Displacement("N*m/Pa", "m^3/rad")
TorquePerPressure = Annotated[float, _displacement, BeforeValidator(_displacement), _finite]
Flow = Annotated[float, *_quantity("m^3/s"), _finite]
Speed = Annotated[float, *_quantity("m/s"), _finite]
AngularSpeed = Annotated[float, *_quantity("rad/s", "m/s"), _finite]
JointAcceleration = Annotated[float, *_quantity("rad/s^2", "m/s^2"), _finite]
AngularRate = Annotated[float, *_quantity("rad/s"), _finite]
AngularRateDensity = Annotated[float, *_quantity("rad/s/Hz^0.5"), _finite]
AccelerationDensity = Annotated[float, *_quantity("m/s^2/Hz^0.5"), _finite]
Position = Annotated[float, *_quantity("rad", "m"), _finite]  # of a joint that turns or slides
Ratio = Annotated[float, *_quantity("1", "m/rad", "rad/m"), _finite]
Rate = Annotated[float, *_quantity("Hz"), _finite]
Duration = Annotated[float, *_quantity("s"), _finite]
LeakageConductance = Annotated[float, *_quantity("m^3/(s*Pa)"), _finite]
Command = Annotated[float, *_quantity("1", "V", "A"), _finite]  # of a valve
Reading = Annotated[float, *_quantity("1", *sorted({unit for units in CHANNEL_UNITS.values() for unit in units})),
                    _finite]  # of a channel
Name = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,62}$")]
Lengths = tuple[Length, Length, Length]
Six = tuple[Inertia, Inertia, Inertia, Inertia, Inertia, Inertia]


class Part(Noun):
    """A part of a machine, or a statement about some, that has a name of its own."""

    name: Name
    """Its name, which no other part has."""
