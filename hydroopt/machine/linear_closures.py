"""A coupling as it determines one joint."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from hydroopt.machine.assembly import Solved
from hydroopt.machine.closures import LinearClosure
from hydroopt.machine.geometry import Geometry


class LinearAssembly(NamedTuple):
    """A coupling, which can be assembled in one way only."""

    closure: LinearClosure

    def solved(self, geometry: Geometry, q: Mapping[str, Any]) -> Solved:
        """Position of its joint, from those before."""
        (joint,) = self.closure.joints
        return Solved({joint: self.moved(geometry, q)}, None)

    def moved(self, geometry: Geometry, of: Mapping[str, Any], *, offset: bool = True) -> Any:
        """Position of its joint; without `offset` its rate or acceleration, from those of the others."""
        coupling = self.closure.coupling
        return coupling.determined(self.closure.joints[0], of.__getitem__,
                                   lambda key: geometry.value[f"{coupling.name}.{key}"], offset=offset)

    def why_open(self, geometry: Geometry, q: Mapping[str, Any]) -> str:
        """Why a coupling's joint has no position: it always has one if the others have."""
        return "a joint that it follows has no position"

    @property
    def dead(self) -> str:
        """A coupling has no dead point."""
        return ""
