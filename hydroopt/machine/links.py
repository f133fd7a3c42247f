"""Links, joints and bodies, each with the rules that hold for it alone: frozen, in SI.

A number may be given as a string with its unit wherever a part is built: ``Joint(a="5.18 m")``.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any, Literal

import numpy as np
from pydantic import Field, StrictBool, ValidationInfo, field_validator, model_validator

from hydroopt.machine.quantity import (
    Angle,
    AngularCompliance,
    AngularSpeed,
    AngularViscosity,
    ImpossibleError,
    JointAcceleration,
    Length,
    Lengths,
    Mass,
    MassMoment,
    Name,
    Noun,
    Part,
    Position,
    Quantity,
    Six,
    Stiffness,
    Torque,
)
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


class Box(Noun):
    """All points between two corners, with edges along the axes of the frame."""

    lower: Lengths
    """Corner (3,) with the smallest coordinates."""
    upper: Lengths
    """Corner (3,) with the largest coordinates."""

    def _mistakes(self) -> Iterator[ImpossibleError]:
        for axis, low, high in zip("xyz", self.lower, self.upper, strict=True):
            if not low < high:
                yield ImpossibleError(f"along {axis} the lower end, {low:.6g} m, is not below the upper one, "
                                      f"{high:.6g} m", "exchange or correct them")

class Ellipsoid(Noun):
    """All points of an ellipsoid with semi-axes along the axes of the body's frame."""

    centre: Lengths
    """Centre (3,)."""
    semi_axes: Lengths
    """Semi-axes (3,)."""

    def _mistakes(self) -> Iterator[ImpossibleError]:
        if min(self.semi_axes) <= 0:
            yield ImpossibleError("a semi-axis is not above zero", "state half of what the body extends along each "
                                  "axis", "semi_axes")

class Tube(Noun):
    """All points of a cylinder about the x axis of the body's frame."""

    radius: Length = Field(gt=0)
    """Radius."""
    start: Length
    """Place of one end along x."""
    end: Length
    """Place of the other end along x."""

    def _mistakes(self) -> Iterator[ImpossibleError]:
        if not self.start < self.end:
            yield ImpossibleError(f"the cylinder's start, {self.start:.6g} m, is not below its end, {self.end:.6g} m",
                                  "exchange or correct them")

class Shape(Noun):
    """Where a body's mass is, in the frame of the body's numbers: exactly one of these."""

    box: Box | None = None
    """A box."""
    ellipsoid: Ellipsoid | None = None
    """An ellipsoid."""
    cylinder: Tube | None = None
    """A cylinder along x."""

    def _mistakes(self) -> Iterator[ImpossibleError]:
        if (self.box, self.ellipsoid, self.cylinder).count(None) != 2:
            yield ImpossibleError("a shape is one of a box, an ellipsoid and a cylinder",
                                  "give exactly one of 'box', 'ellipsoid' and 'cylinder'")

    @property
    def faces(self) -> Array:
        """(f, 4) rows a with ``a·[x; 1] ≥ 0`` inside: the distance from each flat face, the opposite one's being 1."""
        if self.box:
            lower, upper = np.array(self.box.lower), np.array(self.box.upper)
            normals = np.diag(1 / (upper - lower))
            return np.block([[normals, -normals @ lower[:, None]], [-normals, normals @ upper[:, None]]])
        if self.cylinder:
            start, end = self.cylinder.start, self.cylinder.end
            return np.array([[1.0, 0, 0, -start], [-1.0, 0, 0, end]]) / (end - start)
        return np.empty((0, 4))

    @property
    def ball(self) -> Array | None:
        """(3, 4) matrix B with ``‖B·[x; 1]‖ ≤ 1`` inside: the round part, if there is one."""
        if self.ellipsoid:
            normals = np.diag(1 / np.array(self.ellipsoid.semi_axes))
            return np.column_stack([normals, -normals @ self.ellipsoid.centre])
        if self.cylinder:
            return np.diag([0.0, 1, 1, 0])[:3] / self.cylinder.radius
        return None

    def depth(self, point: Array) -> float:
        """How far a point (3,) lies inside, as a part of the shape's size; negative outside."""
        at = np.append(point, 1.0)
        round_part = [] if self.ball is None else [1 - float(np.linalg.norm(self.ball @ at))]
        return float(min([*(self.faces @ at), *round_part]))


class Body(Noun):
    """A rigid body: mass, centre of mass or first moment, inertia about either, in the owner's frame.

    It is stated by `com` and `inertia_com`, or by `mc` and `inertia`. Moments of inertia stand in the order xx, xy, xz,
    yy, yz, zz (Eq. 4.12).
    """

    m: Mass = Field(ge=0)
    """Mass."""
    com: Lengths | None = None
    """Centre of mass (3,)."""
    mc: tuple[MassMoment, MassMoment, MassMoment] | None = None
    """First moment (3,): mass times centre of mass, with `inertia`."""
    inertia_com: Six | None = None
    """Six moments of inertia about the centre of mass, with `com`."""
    inertia: Six | None = None
    """Six moments of inertia about the frame's origin, with `mc`."""
    shape: Shape | None = None
    """What bounds the places of its mass; binds what is identified."""
    symmetric: tuple[Plane, ...] = ()
    """Planes of the frame about which its mass is spread evenly; binds what is identified."""

    @field_validator("symmetric", mode="before")
    @classmethod
    def _planes(cls, stated: Any) -> Any:
        return (stated,) if isinstance(stated, str) else stated

    def _mistakes(self) -> Iterator[ImpossibleError]:
        if (self.com is None) != (self.inertia_com is None) or (self.mc is None) != (self.inertia is None):
            yield ImpossibleError("a body is stated by 'com' with 'inertia_com' or by 'mc' with 'inertia'",
                                  "give exactly one of these pairs")
        if (self.com is None) == (self.mc is None):
            yield ImpossibleError("a body needs one of 'com' with 'inertia_com' and 'mc' with 'inertia'",
                                  "give exactly one of these pairs")
        phi = self.phi
        if self.shape and self.m > 0 and self.shape.depth(phi[1:4] / self.m) < -1e-6:
            yield ImpossibleError("the centre of mass lies outside the shape", "correct one of the two", "shape")
        length = math.sqrt(max(abs(phi[[4, 7, 9]].sum()) / max(self.m, 1e-9), 1e-12))  # as of a radius of gyration
        size = self.m * np.array([length] * 3 + [length**2] * 6)
        for plane in self.symmetric:
            odd = list(inertia.ODD_MOMENTS[plane])
            if np.any(np.abs(phi[odd]) > 1e-6 * size[np.array(odd) - 1]):
                names = ", ".join(inertia.NAMES[k] for k in odd)
                yield ImpossibleError(f"the body's numbers are not symmetric about {plane}: of {names} one is not zero",
                                      "correct them or leave the symmetry out", "symmetric")

    @property
    def phi(self) -> Array:
        """The ten inertial parameters about the frame's origin (Eq. 4.14)."""
        if self.com is not None and self.inertia_com is not None:
            phi: Array = inertia.from_centre_of_mass(self.m, self.com, self.inertia_com)
            return phi
        assert self.mc is not None
        assert self.inertia is not None
        return np.array([self.m, *self.mc, *self.inertia])


class TotalMass(Part):
    """The mass of several bodies together, as of a weighbridge; with a confidence it is a prior, without it exact."""

    bodies: tuple[str, ...] = Field(min_length=1)
    """Bodies that were weighed together, such as `boom`, `boom_cylinder.rod`."""
    value: Mass = Field(gt=0)
    """Their mass."""


class Identical(Part):
    """Identical parts."""

    bodies: tuple[str, ...] = ()
    """Bodies of equal inertial parameters."""
    friction: tuple[str, ...] = ()
    """Actuators of equal friction."""

    def _mistakes(self) -> Iterator[ImpossibleError]:
        if not (self.bodies or self.friction):
            yield ImpossibleError("no identical parts are named", "name two or more bodies, or actuators under "
                                  "'friction'", "bodies")
        for key, owners in (("bodies", self.bodies), ("friction", self.friction)):
            if len(owners) == 1:
                yield ImpossibleError(f"'{owners[0]}' alone is not like anything", "name two or more", key)


class JointFriction(Noun):
    """Friction about or along a joint; a term that is not stated is not modelled."""

    coulomb: Torque | None = Field(None, ge=0)
    """Dry friction."""
    viscous: AngularViscosity | None = Field(None, ge=0)
    """Friction per speed."""


class JointSpring(Noun):
    """A spring about or along a joint: it turns it back with `preload` + `stiffness`·(q − `reference`)."""

    stiffness: Stiffness = Field(ge=0)
    """Torque per angle, or force per length where the joint slides."""
    reference: Position = 0.0
    """Position in which it only gives `preload`."""
    preload: Torque | None = None
    """Torque or force at the reference; not modelled if not stated."""


class Joint(Noun):
    """Modified Denavit-Hartenberg joint and link: Trans(z,d)·Rot(z,θ)·Trans(x,a)·Rot(x,α)·Rot(y,β) (Eq. 3.8).

    The joint variable adds to `theta` (revolute) or `d` (prismatic); a locked joint has none.
    """

    type: Literal["revolute", "prismatic", "locked"]
    """What the joint does."""
    theta: Angle = 0.0
    """Turn about z before the link's frame P; the joint's zero."""
    d: Length = 0.0
    """Step along z before the link's frame P."""
    a: Length = 0.0
    """Length of the link along x of P."""
    alpha: Angle = 0.0
    """Turn about x behind the length."""
    beta: Angle = 0.0
    """Turn about y behind that; needed between nearly parallel axes."""
    lower: Position | None = None
    """Lower limit; a joint that moves by itself needs both, of a dependent one that slides they are its stroke."""
    upper: Position | None = None
    """Upper limit."""
    max_speed: AngularSpeed | None = Field(None, gt=0)
    """Greatest speed."""
    max_acceleration: JointAcceleration | None = Field(None, gt=0)
    """Greatest acceleration."""
    compliance: AngularCompliance | None = Field(None, ge=0)
    """Angle per torque by which the joint gives way under gravity."""
    dependent: StrictBool = False
    """Whether it follows other joints through a loop or coupling."""
    passive: StrictBool = False
    """Whether it moves by itself although no actuator is there to move it."""
    friction: JointFriction = JointFriction()
    """Friction of the joint itself."""
    spring: JointSpring | None = None
    """A spring about or along the joint."""

    @model_validator(mode="before")
    @classmethod
    def _limits(cls, data: Any, info: ValidationInfo) -> Any:
        # the unit of a limit depends on the joint's type, which its field alone does not contain
        if not isinstance(data, Mapping) or data.get("type") not in ("revolute", "prismatic", "locked"):
            return data
        unit = "m" if data["type"] == "prismatic" else "rad"
        units = {"lower": unit, "upper": unit, "max_speed": f"{unit}/s", "max_acceleration": f"{unit}/s^2"}
        for key, si in units.items():
            if data.get(key) is not None:
                if data["type"] == "locked":
                    raise ImpossibleError("a locked joint has a limit", "remove it or let the joint move", key)
                try:
                    Quantity(si)(data[key], info)
                except ImpossibleError as error:
                    raise ImpossibleError(error.what, error.remedy, key) from None
        return data

    def _mistakes(self) -> Iterator[ImpossibleError]:
        if self.passive and not self.independent:
            yield ImpossibleError(f"a {'dependent' if self.dependent else 'locked'} joint cannot be passive",
                                  "remove 'passive', or let the joint move by itself", "passive")
        if self.dependent:
            if self.type == "locked":
                yield ImpossibleError("a locked joint cannot be dependent", "let it turn or slide", "dependent")
            stroke = () if self.type == "prismatic" else ("lower", "upper")
            for key in (*stroke, "max_speed", "max_acceleration", "compliance"):
                if getattr(self, key) is not None:
                    yield ImpossibleError(f"a dependent joint states '{key}'",
                                          "remove it: the joints that it follows have limits", key)
            if self.lower is None and self.upper is None:
                return
        if self.type == "locked":
            return
        if self.lower is None or self.upper is None:
            yield ImpossibleError("a moving joint needs 'lower' and 'upper'", "state both limits")
        elif self.lower >= self.upper:
            factor, unit = (180 / math.pi, "deg") if self.type == "revolute" else (1.0, "m")
            yield ImpossibleError(f"the lower limit, {factor * self.lower:.6g} {unit}, is not below the upper one, "
                                  f"{factor * self.upper:.6g} {unit}", "exchange or correct them")

    @property
    def moving(self) -> bool:
        """Whether the joint moves, by itself or dependent on others."""
        return self.type != "locked"

    @property
    def independent(self) -> bool:
        """Whether the joint moves by itself: it has a place in the joint vector q."""
        return self.moving and not self.dependent

    @property
    def range(self) -> tuple[float, float]:
        """Lower and upper limit [rad or m] of an independent joint, or one that states its stroke."""
        assert self.lower is not None
        assert self.upper is not None
        return self.lower, self.upper


class Link(Noun):
    """A link with the joint that moves it; its body stands in P_i = Trans(z,d)·Rot(z,θ)."""

    name: Name
    """Name of the link and of its joint."""
    parent: str
    """Link that carries it; the one before it in the file, or `base`, if not stated."""
    pin: Lengths | None = None
    """Point (3,) of the parent's frame P (or the base frame) through which the joint's axis passes, parallel to the
    parent's z; without it the axis is the z axis of the parent's far end."""
    joint: Joint
    """How it moves, and how long it is."""
    body: Body | None = None
    """Its mass and inertia; without it, it has none."""


class Attachment(Noun):
    """One end of a cylinder.

    The barrel's frame lies at the barrel's pin and the rod's at the rod's, both with x along the centre line from
    barrel pin to rod pin and z as near as possible to the axis of the driven joint.
    """

    link: str
    """Link, or `base`, that it is pinned to."""
    pin: Lengths
    """Place (3,) of the pin in the link's frame P_i (or the base frame)."""
    body: Body | None = None
    """Mass and inertia of barrel or rod, in its own frame."""
