"""The parts of a machine, each with the rules that hold for it alone: frozen, in SI.

A number may be given as a string with its unit wherever a part is built: ``Joint(a="5.18 m")``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Literal, Self

import numpy as np
from pydantic import Field, ValidationInfo, field_validator, model_validator

from hydroopt.machine.mass_statements import Shape
from hydroopt.machine.quantity import (
    Angle,
    AngularCompliance,
    AngularSpeed,
    AngularViscosity,
    Area,
    Force,
    ImpossibleError,
    Inertia,
    Length,
    Lengths,
    LinearViscosity,
    Mass,
    MassMoment,
    Name,
    Noun,
    Number,
    Pressure,
    Quantity,
    Six,
    Speed,
    Torque,
    TorquePerPressure,
    Volume,
    keyed,
)
from hydroopt.machine.valves import Circuit
from hydroopt.spatial import inertia
from hydroopt.spatial.inertia import Array

Plane = Literal["xy", "xz", "yz"]
"""A plane of a body's frame."""


class Note(Noun):
    """Prior information about a number: its confidence, its bounds and where it comes from."""

    sigma: float | None = None
    relative: bool = False
    lower: float | None = None
    upper: float | None = None
    source: str = ""

    def spread(self, *values: float) -> float | None:
        """Standard deviation of a number, or of each of a vector's, a relative one of the largest; None if unstated."""
        if self.sigma is None:
            return None
        return self.sigma * max(abs(value) for value in values) if self.relative else self.sigma


class Body(Noun):
    """A rigid body: mass, centre of mass or first moment, inertia about either, in the owner's frame.

    Moments of inertia stand in the order xx, xy, xz, yy, yz, zz (Eq. 4.12). `shape` bounds where its mass is, and
    `symmetric` names the planes of the frame about which it is spread evenly; both bind what is identified.
    """

    m: Mass = Field(ge=0)
    com: Lengths | None = None
    mc: tuple[MassMoment, MassMoment, MassMoment] | None = None
    inertia_com: Six | None = None
    inertia: Six | None = None
    shape: Shape | None = None
    symmetric: tuple[Plane, ...] = ()

    @field_validator("symmetric", mode="before")
    @classmethod
    def _planes(cls, stated: Any) -> Any:
        return (stated,) if isinstance(stated, str) else stated

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        if (self.com is None) != (self.inertia_com is None) or (self.mc is None) != (self.inertia is None):
            raise ImpossibleError("a body is stated by 'com' with 'inertia_com' or by 'mc' with 'inertia'",
                                  "give exactly one of these pairs")
        if (self.com is None) == (self.mc is None):
            raise ImpossibleError("a body needs one of 'com' with 'inertia_com' and 'mc' with 'inertia'",
                                  "give exactly one of these pairs")
        return self

    @model_validator(mode="after")
    def _as_stated(self) -> Self:
        phi = self.phi
        if self.shape and self.m > 0 and self.shape.depth(phi[1:4] / self.m) < -1e-6:
            raise ImpossibleError("the centre of mass lies outside the shape", "correct one of the two", "shape")
        length = math.sqrt(max(abs(phi[[4, 7, 9]].sum()) / max(self.m, 1e-9), 1e-12))  # as of a radius of gyration
        size = self.m * np.array([length] * 3 + [length**2] * 6)
        for plane in self.symmetric:
            odd = list(inertia.ODD_MOMENTS[plane])
            if np.any(np.abs(phi[odd]) > 1e-6 * size[np.array(odd) - 1]):
                names = ", ".join(inertia.NAMES[k] for k in odd)
                raise ImpossibleError(f"the body's numbers are not symmetric about {plane}: of {names} one is not zero",
                                      "correct them or leave the symmetry out", "symmetric")
        return self

    @property
    def phi(self) -> Array:
        """The ten inertial parameters about the frame's origin (Eq. 4.14)."""
        if self.com is not None and self.inertia_com is not None:
            phi: Array = inertia.from_centre_of_mass(self.m, self.com, self.inertia_com)
            return phi
        assert self.mc is not None
        assert self.inertia is not None
        return np.array([self.m, *self.mc, *self.inertia])


class JointFriction(Noun):
    """Friction about or along a joint; a term that is not stated is not modelled."""

    coulomb: Torque | None = Field(None, ge=0)
    viscous: AngularViscosity | None = Field(None, ge=0)


class Joint(Noun):
    """Modified Denavit-Hartenberg joint and link: Trans(z,d)·Rot(z,θ)·Trans(x,a)·Rot(x,α)·Rot(y,β) (Eq. 3.8).

    The joint variable adds to `theta` (revolute) or `d` (prismatic); a locked joint has none. Under the torque of
    gravity the joint gives way by `compliance` times that torque.
    """

    type: Literal["revolute", "prismatic", "locked"]
    theta: Angle = 0.0
    d: Length = 0.0
    a: Length = 0.0
    alpha: Angle = 0.0
    beta: Angle = 0.0
    lower: float | None = Field(None, allow_inf_nan=False)
    upper: float | None = Field(None, allow_inf_nan=False)
    max_speed: float | None = Field(None, gt=0, allow_inf_nan=False)
    max_acceleration: float | None = Field(None, gt=0, allow_inf_nan=False)
    compliance: AngularCompliance | None = Field(None, ge=0)
    friction: JointFriction = JointFriction()

    @model_validator(mode="before")
    @classmethod
    def _limits(cls, data: Any, info: ValidationInfo) -> Any:
        # the unit of a limit depends on the joint's type, so that a field's annotation cannot state it
        if not isinstance(data, Mapping) or data.get("type") not in ("revolute", "prismatic", "locked"):
            return data
        unit = "m" if data["type"] == "prismatic" else "rad"
        units = {"lower": unit, "upper": unit, "max_speed": f"{unit}/s", "max_acceleration": f"{unit}/s^2"}
        data = dict(data)
        for key, si in units.items():
            if data.get(key) is not None:
                if data["type"] == "locked":
                    raise ImpossibleError("a locked joint has a limit", "remove it or let the joint move", key)
                data[key] = keyed(Quantity(si), data[key], info, key)
        return data

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.type == "locked":
            return self
        if self.lower is None or self.upper is None:
            raise ImpossibleError("a moving joint needs 'lower' and 'upper'", "state both limits")
        if self.lower >= self.upper:
            factor, unit = (180 / math.pi, "deg") if self.type == "revolute" else (1.0, "m")
            raise ImpossibleError(f"the lower limit, {factor * self.lower:.6g} {unit}, is not below the upper one, "
                                  f"{factor * self.upper:.6g} {unit}", "exchange or correct them")
        return self

    @property
    def range(self) -> tuple[float, float]:
        """Lower and upper limit [rad or m] of a moving joint."""
        assert self.lower is not None
        assert self.upper is not None
        return self.lower, self.upper


class Link(Noun):
    """A link with the joint that moves it; its body stands in P_i = Trans(z,d)·Rot(z,θ)."""

    name: Name
    parent: str
    joint: Joint
    body: Body | None = None


class Attachment(Noun):
    """One end of a cylinder: pin (3,) [m] in the link's frame P_i (or the base frame), and the end's body.

    The barrel's frame lies at the barrel's pin and the rod's at the rod's, both with x along the centre line from
    barrel pin to rod pin and z as near as possible to the axis of the driven joint.
    """

    link: str
    pin: Lengths
    body: Body | None = None


class CylinderFriction(Noun):
    """Friction of a cylinder and the offset of its force reading (Eq. 4.54); unstated terms are not modelled.

    Where `coulomb_reverse` or `viscous_reverse` is stated, it holds while the cylinder retracts, and `coulomb` or
    `viscous` only while it extends. `stribeck` is the friction at breakaway in excess of Coulomb friction, which
    vanishes well above the `stribeck_speed` (Armstrong-Hélouvry et al. 1994). `seal` is the friction per pressure in
    both chambers together (Bonchis et al. 1999). Slower than `dead_zone` there is no dry friction: neither Coulomb's
    nor Stribeck's nor the seals'.
    """

    offset: Force | None = None
    coulomb: Force | None = Field(None, ge=0)
    coulomb_reverse: Force | None = Field(None, ge=0)
    viscous: LinearViscosity | None = Field(None, ge=0)
    viscous_reverse: LinearViscosity | None = Field(None, ge=0)
    stribeck: Force | None = Field(None, ge=0)
    stribeck_speed: Speed | None = Field(None, gt=0)
    seal: Area | None = Field(None, ge=0)
    dead_zone: Speed | None = Field(None, gt=0)
    barrel_pin: Torque | None = Field(None, ge=0)
    rod_pin: Torque | None = Field(None, ge=0)

    @model_validator(mode="after")
    def _whole(self) -> Self:
        _refuse_half_friction(self)
        return self


def _refuse_half_friction(friction: CylinderFriction | TorqueFriction) -> None:
    if (friction.stribeck is None) != (friction.stribeck_speed is None):
        missing = "stribeck" if friction.stribeck is None else "stribeck_speed"
        raise ImpossibleError("the Stribeck effect is incomplete", f"state '{missing}' as well, or neither",
                              missing)
    dry = [friction.coulomb, friction.coulomb_reverse, friction.stribeck, getattr(friction, "seal", None)]
    if friction.dead_zone is not None and all(term is None for term in dry):
        raise ImpossibleError("there is no dry friction that a dead zone could take away",
                              "state a dry friction such as 'coulomb', or remove it", "dead_zone")


class Cylinder(Noun):
    """A hydraulic cylinder, or several equal jacks side by side, between two links.

    Areas and diameters are those of one jack and are multiplied by `jacks`; bodies, friction and forces are those of
    all jacks together, which move as one. `dead_length` is the pin distance when fully retracted.
    """

    name: Name
    barrel: Attachment
    rod: Attachment
    jacks: int = Field(1, ge=1, le=100)
    head_area: Area | None = Field(None, gt=0)
    rod_area: Area | None = Field(None, gt=0)
    bore: Length | None = Field(None, gt=0)
    rod_diameter: Length | None = Field(None, gt=0)
    dead_length: Length = Field(gt=0)
    stroke: Length = Field(gt=0)
    max_speed: Speed | None = Field(None, gt=0)
    relief_pressure: Pressure | None = Field(None, gt=0)
    friction: CylinderFriction = CylinderFriction()
    circuit: Circuit | None = None

    @model_validator(mode="after")
    def _areas(self) -> Self:
        by_area = self.head_area is not None and self.rod_area is not None
        by_diameter = self.bore is not None and self.rod_diameter is not None
        stated = sum(v is not None for v in (self.head_area, self.rod_area, self.bore, self.rod_diameter))
        if stated != 2 or by_area == by_diameter:
            raise ImpossibleError("piston areas are not stated in one way",
                                  "give 'head_area' and 'rod_area', or 'bore' and 'rod_diameter'")
        if self.areas[1] >= self.areas[0] or self.areas[1] <= 0:
            raise ImpossibleError("the rod side's area must lie between zero and the head side's",
                                  "exchange or correct the two")
        if self.friction.seal is not None and self.friction.seal >= self.areas[1]:
            raise ImpossibleError("the seals hold the piston against any pressure: their friction grows as fast as "
                                  "the rod side's force", f"state less than {self.areas[1]:.4g} m^2", "friction.seal")
        return self

    @property
    def areas(self) -> tuple[float, float]:
        """Head side and rod side area [m²] of all jacks together."""
        if self.head_area is not None and self.rod_area is not None:
            return self.jacks * self.head_area, self.jacks * self.rod_area
        assert self.bore is not None
        assert self.rod_diameter is not None
        quarter = self.jacks * math.pi / 4
        return quarter * self.bore**2, quarter * (self.bore**2 - self.rod_diameter**2)


    @property
    def chambers(self) -> tuple[str, str]:
        """Channels of the pressures in the head side's and the rod side's chamber."""
        return f"{self.name}.p_head", f"{self.name}.p_rod"

    @property
    def effort_factors(self) -> dict[str, float]:
        """Channels that the force is measured by, with the factor of each [N/Pa] (Eq. 4.33)."""
        return _by_pressures(self)

    @property
    def effort_symbol(self) -> Literal["f"]:
        """What the names of parameters of its force begin with, after the dot."""
        return "f"


class TorqueFriction(Noun):
    """Friction of a rotary actuator and the offset of its torque reading (Eq. 4.53); see `CylinderFriction`."""

    offset: Torque | None = None
    coulomb: Torque | None = Field(None, ge=0)
    coulomb_reverse: Torque | None = Field(None, ge=0)
    viscous: AngularViscosity | None = Field(None, ge=0)
    viscous_reverse: AngularViscosity | None = Field(None, ge=0)
    stribeck: Torque | None = Field(None, ge=0)
    stribeck_speed: AngularSpeed | None = Field(None, gt=0)
    dead_zone: AngularSpeed | None = Field(None, gt=0)

    @model_validator(mode="after")
    def _whole(self) -> Self:
        _refuse_half_friction(self)
        return self


class Motor(Noun):
    """A hydraulic motor on a joint: torque = torque_per_pressure · gear · (p_a − p_b) (Eq. 4.61)."""

    name: Name
    joint: str
    torque_per_pressure: TorquePerPressure = Field(gt=0)
    gear: Number = Field(1.0, gt=0)
    relief_pressure: Pressure | None = Field(None, gt=0)
    friction: TorqueFriction = TorqueFriction()
    circuit: Circuit | None = None

    @property
    def areas(self) -> tuple[float, float]:
        """What sides a and b displace per radian of the joint [m³/rad]."""
        return (self.torque_per_pressure * self.gear,) * 2

    @property
    def chambers(self) -> tuple[str, str]:
        """Channels of the pressures at sides a and b."""
        return f"{self.name}.p_a", f"{self.name}.p_b"

    @property
    def effort_factors(self) -> dict[str, float]:
        """Channels that the torque is measured by, with the factor of each [N·m/Pa] (Eq. 4.61)."""
        return _by_pressures(self)

    @property
    def effort_symbol(self) -> Literal["tau"]:
        """What the names of parameters of its torque begin with, after the dot."""
        return "tau"


def _by_pressures(actuator: Cylinder | Motor) -> dict[str, float]:
    (a, b), (first, second) = actuator.areas, actuator.chambers
    return {first: a, second: -b}


class Drive(Noun):
    """A joint driven directly by a sensed torque, as in an electric arm; torques are those on the joint's side."""

    name: Name
    joint: str
    gear: Number = Field(1.0, gt=0)
    max_torque: Torque | None = Field(None, gt=0)
    rotor_inertia: Inertia | None = Field(None, ge=0)
    friction: TorqueFriction = TorqueFriction()

    @property
    def effort_factors(self) -> dict[str, float]:
        """The channel that the torque is measured by, with its factor."""
        return {f"{self.joint}.tau": 1.0}

    @property
    def effort_symbol(self) -> Literal["tau"]:
        """What the names of parameters of its torque begin with, after the dot."""
        return "tau"


class GasCylinder(Noun):
    """A passive cylinder on a gas volume (accumulator counterbalance) between two links.

    Pressure is `precharge` at `reference_length` and follows p·Vⁿ = const with the exponent n = `polytropic`; the
    force is p·`area`. A `pull` cylinder compresses the gas when it lengthens, a `push` cylinder when it shortens.

    What acts is the pressure above ambient, what follows the law is the absolute one. `precharge` stands for both, as
    in the source of the KR300's counterbalance: it is taken as absolute and its difference to ambient is neglected, an
    error of 1 bar in 163 there. The ends carry no body yet.
    """

    name: Name
    barrel: Attachment
    rod: Attachment
    acts: Literal["pull", "push"]
    area: Area = Field(gt=0)
    volume: Volume = Field(gt=0)
    reference_length: Length = Field(gt=0)
    precharge: Pressure = Field(ge=0)
    polytropic: Number = Field(1.0, ge=1.0, le=1.67)

    def gas_volume(self, length: Any) -> Any:
        """Volume of the gas [m³] at pin distances [m]: numbers or symbols."""
        return self.volume + (1 if self.acts == "push" else -1) * self.area * (length - self.reference_length)

    @model_validator(mode="after")
    def _no_bodies(self) -> Self:
        for end, attachment in (("barrel", self.barrel), ("rod", self.rod)):
            if attachment.body is not None:
                raise ImpossibleError("the ends of a gas cylinder carry no body yet",
                                      "remove it or add its mass to the link it is pinned to", f"{end}.body")
        return self
