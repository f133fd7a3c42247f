"""The nouns of a machine and the invariants that hold for any of them: frozen, in SI.

A number may be given as a string with its unit wherever a machine is built: ``Joint(a="5.18 m")``.
"""

from __future__ import annotations

import hashlib
import math
from collections import Counter
from collections.abc import Mapping
from functools import cached_property
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationInfo, model_validator

from hydroopt import inertia
from hydroopt.inertia import Array
from hydroopt.units import UnitError, to_si

BASE = "base"
"""Name of the machine's chassis, the root of the tree; it does not move."""


CHANNEL_UNITS = {"q": ("rad", "m"), "qd": ("rad/s", "m/s"), "tau": ("N*m", "N"), "length": ("m",), "force": ("N",),
                 "p_head": ("Pa",), "p_rod": ("Pa",), "p_a": ("Pa",), "p_b": ("Pa",), "u": ("V", "1")}
"""SI units that a log column may have, by the part of its name after the dot."""


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

    def __call__(self, value: Any, info: ValidationInfo) -> Any:
        """SI value of a string with unit; a bare number passes only where code, not a file, states it."""
        if isinstance(value, str):
            problem: UnitError | None = None
            for si in (self.si, *self.others):
                try:
                    return to_si(value, si, where="")
                except UnitError as error:
                    problem = problem or error
            assert problem is not None
            raise ImpossibleError(problem.what, problem.remedy)
        if isinstance(value, bool):
            raise ImpossibleError(f"{str(value).lower()} is not a number", "write a number with its unit")
        if self.si != "1" and isinstance(value, int | float) and (info.context or {}).get("from_file"):
            raise ImpossibleError(f"{value:.9g} has no unit", f"write it as \"{value:.9g} {self.si}\"")
        return value


def _keyed(quantity: Quantity, value: Any, info: ValidationInfo, key: str) -> Any:
    """A value whose unit only its neighbours tell; errors name its key."""
    try:
        return quantity(value, info)
    except ImpossibleError as error:
        raise ImpossibleError(error.what, error.remedy, key) from None


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
Mass = Annotated[float, *_quantity("kg"), _finite]
MassMoment = Annotated[float, *_quantity("kg*m"), _finite]
Inertia = Annotated[float, *_quantity("kg*m^2"), _finite]
Acceleration = Annotated[float, *_quantity("m/s^2"), _finite]
LinearViscosity = Annotated[float, *_quantity("N*s/m"), _finite]
AngularViscosity = Annotated[float, *_quantity("N*m*s/rad", "N*s/m"), _finite]
TorquePerPressure = Annotated[float, *_quantity("N*m/Pa"), _finite]
Rate = Annotated[float, *_quantity("Hz"), _finite]
Name = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]*$")]
Lengths = tuple[Length, Length, Length]
Six = tuple[Inertia, Inertia, Inertia, Inertia, Inertia, Inertia]


class Noun(BaseModel):
    """Base of all parts of a machine: frozen, no unknown keys."""

    model_config = ConfigDict(frozen=True, extra="forbid", ignored_types=(cached_property,))


class Note(Noun):
    """What is known about a number: its confidence, its bounds and where it comes from."""

    sigma: float | None = None
    relative: bool = False
    lower: float | None = None
    upper: float | None = None
    source: str = ""


class Body(Noun):
    """A rigid body: mass, centre of mass or first moment, inertia about either, in the owner's frame.

    Moments of inertia stand in the order xx, xy, xz, yy, yz, zz (Eq. 4.12).
    """

    m: Mass = Field(ge=0)
    com: Lengths | None = None
    mc: tuple[MassMoment, MassMoment, MassMoment] | None = None
    inertia_com: Six | None = None
    inertia: Six | None = None

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        if (self.com is None) != (self.inertia_com is None) or (self.mc is None) != (self.inertia is None):
            raise ImpossibleError("a body is stated by 'com' with 'inertia_com' or by 'mc' with 'inertia'",
                                  "give exactly one of these pairs")
        if (self.com is None) == (self.mc is None):
            raise ImpossibleError("a body needs one of 'com' with 'inertia_com' and 'mc' with 'inertia'",
                                  "give exactly one of these pairs")
        return self

    @cached_property
    def phi(self) -> Array:
        """The ten inertial parameters about the frame's origin (Eq. 4.14)."""
        if self.com is not None and self.inertia_com is not None:
            phi: Array = inertia.from_centre_of_mass(self.m, self.com, self.inertia_com)
            return phi
        assert self.mc is not None
        assert self.inertia is not None
        return inertia.np.array([self.m, *self.mc, *self.inertia])


class JointFriction(Noun):
    """Friction about or along a joint; a term that is not stated is not modelled."""

    coulomb: Torque | None = Field(None, ge=0)
    viscous: AngularViscosity | None = Field(None, ge=0)


class Joint(Noun):
    """Modified Denavit-Hartenberg joint and link: Trans(z,d)·Rot(z,θ)·Trans(x,a)·Rot(x,α)·Rot(y,β) (Eq. 3.8).

    The joint variable adds to `theta` (revolute) or `d` (prismatic); a locked joint has none.
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
                data[key] = _keyed(Quantity(si), data[key], info, key)
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
    """Friction of a cylinder and the offset of its force reading (Eq. 4.54); unstated terms are not modelled."""

    offset: Force | None = None
    coulomb: Force | None = Field(None, ge=0)
    viscous: LinearViscosity | None = Field(None, ge=0)
    barrel_pin: Torque | None = Field(None, ge=0)
    rod_pin: Torque | None = Field(None, ge=0)


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
    relief_pressure: Pressure | None = Field(None, gt=0)
    friction: CylinderFriction = CylinderFriction()

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


class TorqueFriction(Noun):
    """Friction of a rotary actuator and the offset of its torque reading (Eq. 4.53)."""

    offset: Torque | None = None
    coulomb: Torque | None = Field(None, ge=0)
    viscous: AngularViscosity | None = Field(None, ge=0)


class Motor(Noun):
    """A hydraulic motor on a joint: torque = torque_per_pressure · gear · (p_a − p_b) (Eq. 4.61)."""

    name: Name
    joint: str
    torque_per_pressure: TorquePerPressure
    gear: Number = Field(1.0, gt=0)
    relief_pressure: Pressure | None = Field(None, gt=0)
    friction: TorqueFriction = TorqueFriction()


class Drive(Noun):
    """A joint driven directly by a sensed torque, as in an electric arm; the torque is that on the joint's side."""

    name: Name
    joint: str
    gear: Number = Field(1.0, gt=0)
    rotor_inertia: Inertia | None = Field(None, ge=0)
    friction: TorqueFriction = TorqueFriction()


class GasCylinder(Noun):
    """A passive cylinder on a gas volume (accumulator counterbalance) between two links.

    Pressure is `precharge` at `reference_length` and follows p·Vⁿ = const with the exponent n = `polytropic`. A
    `pull` cylinder compresses the gas when it lengthens, a `push` cylinder when it shortens.
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


class Sensor(Noun):
    """What a set of channels is measured with.

    `accuracy` is the bound of a uniform error, or the standard deviation of a Gaussian one.
    """

    channels: tuple[str, ...] = Field(min_length=1)
    accuracy: float = Field(ge=0, allow_inf_nan=False)
    resolution: float = Field(0.0, ge=0, allow_inf_nan=False)
    rate: Rate | None = Field(None, gt=0)
    distribution: Literal["uniform", "gaussian"] = "uniform"

    @model_validator(mode="before")
    @classmethod
    def _units(cls, data: Any, info: ValidationInfo) -> Any:
        if not isinstance(data, Mapping) or not isinstance(data.get("channels"), list | tuple) or not data["channels"]:
            return data
        data = dict(data)
        for key in ("accuracy", "resolution"):
            if key in data:
                data[key] = cls._reading(data[key], data["channels"], info, key)
        return data

    @staticmethod
    def _reading(value: Any, channels: Any, info: ValidationInfo, key: str) -> Any:
        names = [str(channel) for channel in channels]
        kinds = {CHANNEL_UNITS.get(name.rpartition(".")[2], ()) for name in names}
        if len(kinds) > 1 or () in kinds:
            raise ImpossibleError(
                f"the channels {', '.join(names)} are not of one known kind", "name channels that end alike, in one of "
                + ", ".join(f".{suffix}" for suffix in CHANNEL_UNITS), "channels")
        problem: ImpossibleError | None = None
        for si in kinds.pop():
            try:
                return _keyed(Quantity(si), value, info, key)
            except ImpossibleError as error:
                problem = problem or error
        assert problem is not None
        raise problem

    @property
    def std(self) -> float:
        """Standard deviation of one reading: noise and quantisation together."""
        noise = self.accuracy / math.sqrt(3) if self.distribution == "uniform" else self.accuracy
        return math.hypot(noise, self.resolution / math.sqrt(12))


class Machine(Noun):
    """A manipulator: a tree of links on the base, their actuators, and the sensors.

    `orientation` is roll, pitch, yaw of the base frame in a world whose z points up. Above the frequency `bandwidth`
    the links no longer move as rigid bodies driven by their actuators: measured motion is smoothed at least that much.
    """

    name: Name
    parameter_set: str = ""
    description: str = ""
    gravity: Acceleration = Field(9.80665, ge=0)
    orientation: tuple[Angle, Angle, Angle] = (0.0, 0.0, 0.0)
    bandwidth: Rate | None = Field(None, gt=0)
    links: tuple[Link, ...] = Field(min_length=1)
    cylinders: tuple[Cylinder, ...] = ()
    motors: tuple[Motor, ...] = ()
    drives: tuple[Drive, ...] = ()
    gas_cylinders: tuple[GasCylinder, ...] = ()
    sensors: tuple[Sensor, ...] = ()
    notes: dict[str, Note] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _invariants(self) -> Self:
        self._names()
        self._tree()
        self._actuation()
        self._channels()
        return self

    def _names(self) -> None:
        parts = [*self.links, *self.cylinders, *self.motors, *self.drives, *self.gas_cylinders]
        count = Counter([BASE, *(part.name for part in parts)])
        for name, times in count.items():
            if times > 1:
                raise ImpossibleError(f"the name '{name}' is used {times} times" if name != BASE
                                      else f"the name '{BASE}' is the chassis", "give each part a name of its own")

    def _tree(self) -> None:
        known = {BASE, *(link.name for link in self.links)}
        for link in self.links:
            if link.parent not in known:
                raise ImpossibleError(f"link '{link.name}' hangs on '{link.parent}', which does not exist",
                                      f"name '{BASE}' or another link as its parent")
        placed = {BASE}
        for link in self.links:
            if link.parent not in placed:
                raise ImpossibleError(f"link '{link.name}' comes before its parent '{link.parent}' or hangs on itself "
                                      "in a circle", "list every parent before its children")
            placed.add(link.name)

    def _actuation(self) -> None:
        links = {link.name for link in self.links}
        driven: Counter[str] = Counter()
        for cylinder in (*self.cylinders, *self.gas_cylinders):
            for end, attachment in (("barrel", cylinder.barrel), ("rod", cylinder.rod)):
                if attachment.link not in links | {BASE}:
                    raise ImpossibleError(f"the {end} of '{cylinder.name}' is pinned to '{attachment.link}', which does "
                                          "not exist", "name a link or the base")
            between = self.joints_between(cylinder.barrel.link, cylinder.rod.link)
            if not between:
                raise ImpossibleError(f"no moving joint lies between the two ends of '{cylinder.name}'",
                                      "pin its ends to links that move relative to each other")
            if isinstance(cylinder, Cylinder):
                driven.update(between)
        for actuator in (*self.motors, *self.drives):
            if actuator.joint not in self.joints:
                raise ImpossibleError(f"'{actuator.name}' drives '{actuator.joint}', which is not a moving joint",
                                      "name the link whose joint it drives")
            driven[actuator.joint] += 1
        for joint in self.joints:
            if not driven[joint]:
                raise ImpossibleError(f"nothing drives the joint '{joint}'", "add its actuator or make it locked")
        mains: dict[str, str] = {}
        for actuator in self.actuators:
            joint = self._main_joint(actuator)
            if joint in mains:
                raise ImpossibleError(f"the joint '{joint}' is driven by both '{mains[joint]}' and '{actuator.name}'",
                                      "keep one of them")
            mains[joint] = actuator.name
        if len(self.actuators) != len(self.joints):
            raise ImpossibleError(f"{len(self.actuators)} actuators drive {len(self.joints)} moving joints",
                                  "give every moving joint one actuator")

    def _channels(self) -> None:
        known = self.channel_units
        for sensor in self.sensors:
            for channel in sensor.channels:
                if channel not in known:
                    raise ImpossibleError(f"a sensor reads '{channel}', which this machine does not have",
                                          f"use one of {', '.join(known)}")
        twice = [c for c, n in Counter(c for s in self.sensors for c in s.channels).items() if n > 1]
        if twice:
            raise ImpossibleError(f"the channel '{twice[0]}' has two sensors", "keep one of them")

    @cached_property
    def joints(self) -> tuple[str, ...]:
        """Names of the moving joints (those of their links), in the order of the joint vector q."""
        return tuple(link.name for link in self.links if link.joint.type != "locked")

    @cached_property
    def actuators(self) -> tuple[Cylinder | Motor | Drive, ...]:
        """The actuators in the order of the joints they drive: the order of measured forces."""
        return tuple(sorted((*self.cylinders, *self.motors, *self.drives),
                            key=lambda actuator: self.joints.index(self._main_joint(actuator))))

    def _main_joint(self, actuator: Cylinder | Motor | Drive) -> str:
        # of several joints between a cylinder's ends, the last is what it is there for
        return self.axis_of(actuator) if isinstance(actuator, Cylinder) else actuator.joint

    def link(self, name: str) -> Link:
        """The link of this name."""
        return next(link for link in self.links if link.name == name)

    def ancestry(self, name: str) -> tuple[str, ...]:
        """Links from the one named down to the base, the base left out."""
        chain: list[str] = []
        while name != BASE:
            chain.append(name)
            name = self.link(name).parent
        return tuple(chain)

    def joints_between(self, one: str, other: str) -> tuple[str, ...]:
        """Moving joints on the way between two links, in the order of q."""
        apart = set(self.ancestry(one)) ^ set(self.ancestry(other))
        return tuple(joint for joint in self.joints if joint in apart)

    def axis_of(self, cylinder: Cylinder | GasCylinder) -> str:
        """The joint whose axis orients the cylinder's bodies: the last moving one between its ends."""
        return self.joints_between(cylinder.barrel.link, cylinder.rod.link)[-1]

    @cached_property
    def channel_units(self) -> dict[str, str]:
        """Every channel that a log of this machine may have, with its SI unit."""
        units: dict[str, str] = {}
        for joint in self.joints:
            prismatic = self.link(joint).joint.type == "prismatic"
            units[f"{joint}.q"] = "m" if prismatic else "rad"
            units[f"{joint}.qd"] = "m/s" if prismatic else "rad/s"
            units[f"{joint}.tau"] = "N" if prismatic else "N*m"
        for cylinder in self.cylinders:
            units |= {f"{cylinder.name}.length": "m", f"{cylinder.name}.p_head": "Pa",
                      f"{cylinder.name}.p_rod": "Pa", f"{cylinder.name}.force": "N"}
        for motor in self.motors:
            units |= {f"{motor.name}.p_a": "Pa", f"{motor.name}.p_b": "Pa"}
        return units

    @cached_property
    def sha256(self) -> str:
        """Digest of the description, the same however its file is laid out."""
        return hashlib.sha256(self.model_dump_json().encode()).hexdigest()

    def sensor(self, channel: str) -> Sensor | None:
        """The sensor that reads a channel, if the file states one."""
        return next((s for s in self.sensors if channel in s.channels), None)
