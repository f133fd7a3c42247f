"""What a machine file may state about masses besides their values: bounding shapes, total masses, identical parts."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from pydantic import Field

from hydroopt.machine.quantity import ImpossibleError, Length, Lengths, Mass, Name, Noun
from hydroopt.spatial.inertia import Array


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


class TotalMass(Noun):
    """The mass of several bodies together, as of a weighbridge; with a confidence it is a prior, without it exact."""

    name: Name
    """Name of the statement."""
    bodies: tuple[str, ...] = Field(min_length=1)
    """Bodies that were weighed together, such as `boom`, `boom_cylinder.rod`."""
    value: Mass = Field(gt=0)
    """Their mass."""


class Identical(Noun):
    """Identical parts."""

    name: Name
    """Name of the statement."""
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
