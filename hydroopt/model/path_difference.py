"""How far apart two geometries place a point along one motion (Eq. 3.44, 3.46): Figures 22 to 25 of the thesis."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from hydroopt.errors import ProblemError
from hydroopt.machine.geometry import Geometry
from hydroopt.machine.machine import BASE, Machine
from hydroopt.machine.machine_file import GivenMachine, machine_of
from hydroopt.machine.mechanism import Mechanism
from hydroopt.spatial.inertia import Array

TIP = "tip"
"""The calibrator's ball."""


class PathDifference(NamedTuple):
    """Places (N, 3) [m] of a point by two geometries, in one frame. See `path_difference`."""

    point: str
    first: Array
    second: Array

    def __repr__(self) -> str:
        return f"PathDifference(of {self.point}: RMS {1e3 * self.rms:.4g} mm at {len(self.first)} places)"

    @property
    def error(self) -> Array:
        """(N, 3) [m] second less first."""
        return np.asarray(self.second - self.first)

    @property
    def rms(self) -> float:
        """Root mean square [m] of the distance between the two places (Eq. 3.44)."""
        return float(np.sqrt(np.mean(np.sum(self.error**2, axis=1))))

    @property
    def vaf(self) -> float:
        """Variance accounted for (Eq. 3.46); NaN where the point rests."""
        spread = float(np.sum((self.first - self.first.mean(axis=0)) ** 2))
        return 1 - float(np.sum(self.error**2)) / spread if spread else float("nan")


def path_difference(first: GivenMachine, second: GivenMachine, angles: Mapping[str, ArrayLike], point: str = TIP, *,
                    seen_from: str = BASE) -> PathDifference:
    """Where two machines of the same links and joints place a point while their joints turn alike.

    Args:
        first: the geometry that counts as right, such as the nominal one.
        second: the other one, such as the calibrated one.
        angles: (N,) of every moving joint [rad, m] between `seen_from` and `point`; others do not matter.
        point: a link, of which the far end is taken, or ``tip``.
        seen_from: a link, from whose far end the point is seen; by default from the base. From the calibrator's last
            link it is the thesis's "calibrator side".

    Raises:
        ProblemError: there is no such link, or the angle of a joint is missing or of another length.

    >>> import hydroopt as ho
    >>> nominal = ho.load_machine("cat215b")
    >>> longer = nominal.with_values({"boom.a": nominal.numbers["boom.a"].value + 0.01})
    >>> angles = {"swing": [0.0, 0.3], "boom": [-0.5, -0.3], "stick": [1.4, 1.2]}
    >>> round(ho.path_difference(nominal, longer, angles, "stick").rms, 6)
    0.01
    """
    places = [_places(machine_of(machine, "path difference"), angles, point, seen_from)
              for machine in (first, second)]
    return PathDifference(point, *places)


def _places(machine: Machine, angles: Mapping[str, ArrayLike], point: str, seen_from: str) -> Array:
    geometry = Geometry(machine)
    at_tip = point == TIP and machine.calibrator is not None
    if point == TIP and not at_tip and all(each.name != TIP for each in machine.links):
        raise ProblemError("it has no calibrator, so that it has no tip", where=f"machine '{machine.name}'",
                           remedy="name a link as the point")
    link = machine.chain[-1].name if at_tip else point
    known = (BASE, *(each.name for each in geometry.links))
    for name in (link, seen_from):
        if name not in known:
            raise ProblemError(f"there is no link '{name}'", where=f"machine '{machine.name}'",
                               remedy=f"use {', '.join(known)}")
    joints = [each.name for each in geometry.links if each.joint.independent]
    q = ca.SX.sym("q", len(joints))
    place = ca.SX(3, 1)
    if link != seen_from or at_tip:
        end = geometry.far_end(link).point(geometry.point(TIP)) if at_tip else geometry.far_end(link).origin
        at = Mechanism(machine).positions(geometry, {name: q[k] for k, name in enumerate(joints)})
        place = geometry.relative_pose(seen_from, link, at).point(end)
    needed = [name for k, name in enumerate(joints) if ca.depends_on(place, q[k])]
    values = {name: np.asarray(angles[name], dtype=float) for name in joints if name in angles}
    sizes = {value.shape for value in values.values()}
    for name in needed:
        if name not in values:
            raise ProblemError(f"the angle of joint '{name}' is missing", where=f"path of '{point}'",
                               remedy="give (N,) angles of every joint before the point")
    if len(sizes) != 1 or len(next(iter(sizes))) != 1:
        raise ProblemError(f"angles have the shapes {sorted(sizes)}", where=f"path of '{point}'",
                           remedy="give one vector (N,) a joint, all of one length")
    count = next(iter(sizes))[0]
    table = np.array([values.get(name, np.zeros(count)) for name in joints])
    return np.asarray(ca.Function("place", [q], [ca.densify(place)]).map(count)(table)).T
