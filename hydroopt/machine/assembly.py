"""What a closure is once it is known how it is assembled: positions of its joints from those before."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol

import casadi as ca

from hydroopt.machine.closures import Closure
from hydroopt.machine.geometry import Geometry


class Solved(NamedTuple):
    """Positions of a closure's joints by name, not a number where it cannot close.

    `sine` is that of the angle between the directions in which its joints move its pin, or the volume that these
    directions span: 1 at best, 0 at a dead point. A coupling has none.
    """

    positions: dict[str, Any]
    sine: ca.SX | None


class Assembly(Protocol):
    """A closure as it is assembled."""

    @property
    def closure(self) -> Closure:
        """What it assembles."""

    def solved(self, geometry: Geometry, q: Mapping[str, Any]) -> Solved:
        """Positions of its joints from those before, by name."""

    def why_open(self, geometry: Geometry, q: Mapping[str, Any]) -> str:
        """Why it cannot close at positions, in words."""

    @property
    def dead(self) -> str:
        """What happens at a dead point, in words."""
