"""Links, joints and bodies, each with the rules that hold for it alone: frozen, in SI.

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
    AngularViscosity,
    ImpossibleError,
    Length,
    Lengths,
    Mass,
    MassMoment,
    Name,
    Noun,
    Position,
    Quantity,
    Six,
    Stiffness,
    Torque,
    keyed,
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


class JointSpring(Noun):
    """A spring about or along a joint: it turns it back with `preload` + `stiffness`·(q − `reference`)."""

    stiffness: Stiffness = Field(ge=0)
    reference: Position = 0.0
    preload: Torque | None = None


class Joint(Noun):
    """Modified Denavit-Hartenberg joint and link: Trans(z,d)·Rot(z,θ)·Trans(x,a)·Rot(x,α)·Rot(y,β) (Eq. 3.8).

    The joint variable adds to `theta` (revolute) or `d` (prismatic); a locked joint has none. Under the torque of
    gravity the joint gives way by `compliance` times that torque. A `dependent` joint follows others through a loop or
    coupling. A `passive` joint moves by itself, but no actuator is there to move it.
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
    dependent: bool = False
    passive: bool = False
    friction: JointFriction = JointFriction()
    spring: JointSpring | None = None

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
        if self.passive and not self.independent:
            raise ImpossibleError(f"a {'dependent' if self.dependent else 'locked'} joint cannot be passive",
                                  "remove 'passive', or let the joint move by itself", "passive")
        if self.dependent:
            if self.type == "locked":
                raise ImpossibleError("a locked joint cannot be dependent", "let it turn or slide", "dependent")
            for key in ("lower", "upper", "max_speed", "max_acceleration", "compliance"):
                if getattr(self, key) is not None:
                    raise ImpossibleError(f"a dependent joint states '{key}'",
                                          "remove it: the joints that it follows have limits", key)
            return self
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
    def moving(self) -> bool:
        """Whether the joint moves, by itself or dependent on others."""
        return self.type != "locked"

    @property
    def independent(self) -> bool:
        """Whether the joint moves by itself: it has a place in the joint vector q."""
        return self.moving and not self.dependent

    @property
    def range(self) -> tuple[float, float]:
        """Lower and upper limit [rad or m] of an independent joint."""
        assert self.lower is not None
        assert self.upper is not None
        return self.lower, self.upper


class Link(Noun):
    """A link with the joint that moves it; its body stands in P_i = Trans(z,d)·Rot(z,θ).

    The joint's axis is the z axis of the parent's far end or, where a `pin` (3,) [m] is stated, passes through this
    point of the parent's frame P (or the base frame), parallel to its z axis.
    """

    name: Name
    parent: str
    pin: Lengths | None = None
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
