"""Cylinders, motors, drives and their friction, each with the rules that hold for it alone: frozen, in SI.

What an actuator *is* to the rest of the package, its chambers and how its force follows from their pressures (Eq. 4.33,
4.61), are properties of its type.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, ClassVar, Literal

from pydantic import Field, StrictBool

from hydroopt.machine.links import Attachment
from hydroopt.machine.quantity import (
    AngularSpeed,
    AngularViscosity,
    Area,
    Force,
    ImpossibleError,
    Inertia,
    Length,
    LinearStiffness,
    Noun,
    Number,
    Part,
    PinTorque,
    Pressure,
    Speed,
    Torque,
    TorquePerPressure,
    Volume,
)
from hydroopt.machine.valves import Circuit

SHARED_PRESSURE = 1e7
"""Pressure difference [Pa] by which hydraulic actuators compare with drives where they share a load."""


class TorqueFriction(Noun):
    """Friction of an actuator on the joint's side, and the offset of its torque reading (Eq. 4.53).

    Terms that are not stated are not modelled. Where the joint slides they are forces.
    """

    offset: Torque | None = None
    """Constant error of the torque reading."""
    coulomb: Torque | None = Field(None, ge=0)
    """Dry friction; with `coulomb_reverse` only while turning positively, or extending."""
    coulomb_reverse: Torque | None = Field(None, ge=0)
    """Dry friction while turning negatively, or retracting."""
    viscous: AngularViscosity | None = Field(None, ge=0)
    """Friction per speed; with `viscous_reverse` only while turning positively, or extending."""
    viscous_reverse: AngularViscosity | None = Field(None, ge=0)
    """Friction per speed while turning negatively, or retracting."""
    stribeck: Torque | None = Field(None, ge=0)
    """Friction at breakaway in excess of Coulomb friction (Armstrong-Hélouvry et al. 1994)."""
    stribeck_speed: AngularSpeed | None = Field(None, gt=0)
    """Speed well above which that excess vanishes; needed with `stribeck`."""
    dead_zone: AngularSpeed | None = Field(None, gt=0)
    """Speed below which there is no dry friction: neither Coulomb's nor Stribeck's nor the seals'."""

    def _mistakes(self) -> Iterator[ImpossibleError]:
        if (self.stribeck is None) != (self.stribeck_speed is None):
            missing = "stribeck" if self.stribeck is None else "stribeck_speed"
            yield ImpossibleError("the Stribeck effect is incomplete", f"state '{missing}' as well, or neither",
                                  missing)
        dry = (self.coulomb, self.coulomb_reverse, self.stribeck, getattr(self, "seal", None))
        if self.dead_zone is not None and all(term is None for term in dry):
            yield ImpossibleError("there is no dry friction that a dead zone could take away",
                                  "state a dry friction such as 'coulomb', or remove it", "dead_zone")


class CylinderFriction(TorqueFriction):
    """Friction of a cylinder and the offset of its force reading (Eq. 4.54): forces, and torques in its pins."""

    seal: Area | None = Field(None, ge=0)
    """Friction per pressure in both chambers together (Bonchis et al. 1999)."""
    barrel_pin: PinTorque | None = Field(None, ge=0)
    """Dry friction in the barrel's pin."""
    rod_pin: PinTorque | None = Field(None, ge=0)
    """Dry friction in the rod's pin."""


class Cylinder(Part):
    """A hydraulic cylinder, or several equal jacks side by side, between two links.

    Its areas are stated by `head_area` and `rod_area`, or by `bore` and `rod_diameter`. Bodies, friction and forces are
    those of all jacks together, which move as one.
    """

    effort_symbol: ClassVar = "f"
    """What the names of parameters of its force begin with, after the dot."""
    barrel: Attachment
    """Pin and body of the barrel."""
    rod: Attachment
    """Pin and body of the rod."""
    jacks: int = Field(1, ge=1, le=100, strict=True)
    """Number of equal jacks side by side."""
    head_area: Area | None = Field(None, gt=0)
    """Piston area of one jack on the head side."""
    rod_area: Area | None = Field(None, gt=0)
    """Piston area of one jack on the rod side, less the rod."""
    bore: Length | None = Field(None, gt=0)
    """Diameter of one jack's piston."""
    rod_diameter: Length | None = Field(None, gt=0)
    """Diameter of one jack's rod."""
    dead_length: Length = Field(gt=0)
    """Distance of the pins when fully retracted."""
    stroke: Length = Field(gt=0)
    """What it extends by."""
    max_speed: Speed | None = Field(None, gt=0)
    """Greatest speed."""
    relief_pressure: Pressure | None = Field(None, gt=0)
    """Pressure at which a valve relieves a chamber."""
    measured: StrictBool = True
    """Whether logs hold its pressures or force; its length may be logged all the same."""
    friction: CylinderFriction = CylinderFriction()
    """Friction, and the offset of the force reading."""
    circuit: Circuit | None = None
    """Valve, hoses and leaks."""

    def _mistakes(self) -> Iterator[ImpossibleError]:
        by_area = self.head_area is not None and self.rod_area is not None
        by_diameter = self.bore is not None and self.rod_diameter is not None
        stated = sum(v is not None for v in (self.head_area, self.rod_area, self.bore, self.rod_diameter))
        if stated != 2 or by_area == by_diameter:
            yield ImpossibleError("piston areas are not stated in one way",
                                  "give 'head_area' and 'rod_area', or 'bore' and 'rod_diameter'")
        if self.areas[1] >= self.areas[0] or self.areas[1] <= 0:
            yield ImpossibleError("the rod side's area must lie between zero and the head side's",
                                  "exchange or correct the two")
        if self.friction.seal is not None and self.friction.seal >= self.areas[1]:
            yield ImpossibleError("the seals hold the piston against any pressure: their friction grows as fast as "
                                  "the rod side's force", f"state less than {self.areas[1]:.4g} m^2", "friction.seal")

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
    def capacity(self) -> float:
        """Force [N] by which it shares a load with others: that of `SHARED_PRESSURE` on the head side."""
        return SHARED_PRESSURE * self.areas[0]

    @property
    def chambers(self) -> tuple[str, str]:
        """Channels of the pressures in the head side's and the rod side's chamber."""
        return f"{self.name}.p_head", f"{self.name}.p_rod"

    @property
    def effort_factors(self) -> dict[str, float]:
        """Channels that the force is measured by, with the factor of each [N/Pa] (Eq. 4.33)."""
        return _by_pressures(self)


class Motor(Part):
    """A hydraulic motor on a joint: torque = torque_per_pressure · gear · (p_a − p_b) (Eq. 4.61)."""

    effort_symbol: ClassVar = "tau"
    """What the names of parameters of its torque begin with, after the dot."""
    joint: str
    """Joint that it turns."""
    torque_per_pressure: TorquePerPressure = Field(gt=0)
    """Torque per pressure, which is its displacement: "150 cm^3/rev", or "23.9 cm^3/rad"."""
    gear: Number = Field(1.0, gt=0)
    """Turns of the motor per turn of the joint."""
    measured: StrictBool = True
    """Whether logs hold its pressures or torque."""
    relief_pressure: Pressure | None = Field(None, gt=0)
    """Pressure at which a valve relieves a side."""
    friction: TorqueFriction = TorqueFriction()
    """Friction, and the offset of the torque reading."""
    circuit: Circuit | None = None
    """Valve, hoses and leaks."""

    @property
    def areas(self) -> tuple[float, float]:
        """What sides a and b displace per radian of the joint [m³/rad]."""
        return (self.torque_per_pressure * self.gear,) * 2

    @property
    def capacity(self) -> float:
        """Torque [N·m] by which it shares a load with others: that of `SHARED_PRESSURE`."""
        return SHARED_PRESSURE * self.areas[0]

    @property
    def chambers(self) -> tuple[str, str]:
        """Channels of the pressures at sides a and b."""
        return f"{self.name}.p_a", f"{self.name}.p_b"

    @property
    def effort_factors(self) -> dict[str, float]:
        """Channels that the torque is measured by, with the factor of each [N·m/Pa] (Eq. 4.61)."""
        return _by_pressures(self)


def _by_pressures(actuator: Cylinder | Motor) -> dict[str, float]:
    (a, b), (first, second) = actuator.areas, actuator.chambers
    return {first: a, second: -b}


class Drive(Part):
    """A joint driven directly by a torque, as in an electric arm; torques are those on the joint's side."""

    effort_symbol: ClassVar = "tau"
    """What the names of parameters of its torque begin with, after the dot."""
    joint: str
    """Joint that it moves."""
    gear: Number = Field(1.0, gt=0)
    """Turns of the rotor per turn of the joint."""
    measured: StrictBool = True
    """Whether logs hold its torque."""
    max_torque: Torque | None = Field(None, gt=0)
    """Greatest torque."""
    rotor_inertia: Inertia | None = Field(None, ge=0)
    """Inertia of the rotor, on the rotor's side."""
    friction: TorqueFriction = TorqueFriction()
    """Friction, and the offset of the torque reading."""
    ground: StrictBool = False
    """Whether it stands for the ground, by which a base on a slope or in motion moves; not measured."""

    def _mistakes(self) -> Iterator[ImpossibleError]:
        if self.ground and self.measured:
            yield ImpossibleError("the ground's torque or force is not measured", "state measured = false", "measured")

    @property
    def capacity(self) -> float:
        """Torque [N·m] by which it shares a load with others."""
        return self.max_torque or 1.0

    @property
    def effort_factors(self) -> dict[str, float]:
        """The channel that the torque is measured by, with its factor."""
        return {f"{self.joint}.tau": 1.0}


Actuator = Cylinder | Motor | Drive
"""What moves joints by a force of its own."""


class PassivePart(Part):
    """A part between two pins that nothing drives; its ends carry no body yet."""

    barrel: Attachment
    """Pin of the barrel, or one pin of a spring."""
    rod: Attachment
    """Pin of the rod, or the other pin."""

    def _mistakes(self) -> Iterator[ImpossibleError]:
        for end, attachment in (("barrel", self.barrel), ("rod", self.rod)):
            if attachment.body is not None:
                yield ImpossibleError("the ends of gas cylinders and springs carry no body yet",
                                      "remove it or add its mass to the link it is pinned to", f"{end}.body")


class GasCylinder(PassivePart):
    """A passive cylinder on a gas volume (accumulator counterbalance) between two links.

    Pressure is `precharge` at `reference_length` and follows p·Vⁿ = const with the exponent n = `polytropic`; the
    force is p·`area`. A `pull` cylinder compresses the gas when it lengthens, a `push` cylinder when it shortens.

    What acts is the pressure above ambient, what follows the law is the absolute one. `precharge` stands for both, as
    in the source of the KR300's counterbalance: it is taken as absolute and its difference to ambient is neglected, an
    error of 1 bar in 163 there. The ends carry no body yet.
    """

    acts: Literal["pull", "push"]
    """`pull`: the gas is compressed when it lengthens; `push`: when it shortens."""
    area: Area = Field(gt=0)
    """Area that the gas acts on."""
    volume: Volume = Field(gt=0)
    """Volume of the gas at the reference length."""
    reference_length: Length = Field(gt=0)
    """Distance of the pins at which `precharge` and `volume` hold."""
    precharge: Pressure = Field(ge=0)
    """Pressure of the gas at the reference length."""
    polytropic: Number = Field(1.0, ge=1.0, le=1.67)
    """Exponent n of p·Vⁿ = const."""

    def gas_volume(self, length: Any) -> Any:
        """Volume of the gas [m³] at pin distances [m]: numbers or symbols."""
        return self.volume + (1 if self.acts == "push" else -1) * self.area * (length - self.reference_length)


class Spring(PassivePart):
    """A linear spring between two links, such as a counterbalance; its ends are called as those of cylinders.

    It pulls its pins together with `preload` + `stiffness`·(length − `reference_length`), and pushes them apart where
    this is negative. The ends carry no body.
    """

    stiffness: LinearStiffness = Field(ge=0)
    """Force per length."""
    reference_length: Length = Field(gt=0)
    """Distance of the pins at which it pulls with `preload`; the free length without one."""
    preload: Force | None = None
    """Force at the reference length; not modelled if not stated."""


Pinned = Cylinder | GasCylinder | Spring
"""A part between two pins."""
