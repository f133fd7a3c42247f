"""The equations of loops and couplings, zero where they close."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca

from hydroopt.machine.closures import Statement
from hydroopt.machine.couplings import Coupling
from hydroopt.machine.geometry import Geometry
from hydroopt.machine.loops import Loop


def closure_equations(geometry: Geometry, statements: Sequence[Statement], q: Mapping[str, Any]) -> ca.SX:
    """Equations (m,) [m, or the unit of a coupling's joint] of loops and couplings at positions of all joints by name.

    A pin has two in the loop's plane, a ball three, and a rod of length L with the vector g between its ends has
    (g·g − L²)/2L.
    """
    rows = []
    for each in statements:
        if isinstance(each, Coupling):
            rows.append(q[each.joint] - each.determined(each.joint, q.__getitem__, _value(geometry, each)))
            continue
        gap = geometry.loop_gap(each, q)
        if each.closed_by == "rod":
            length = geometry.value[f"{each.name}.length"]
            gap = (ca.sumsqr(gap) - length**2) / (2 * length)
        rows.append(gap[:2] if each.closed_by == "pin" else gap)
    return ca.vertcat(*rows)


def directions(geometry: Geometry, statements: Sequence[Statement], q: Mapping[str, Any]) -> ca.SX:
    """The equations, and of a rod the whole vector between its ends: what joints move."""
    rows = [geometry.loop_gap(each, q) if isinstance(each, Loop) and each.closed_by == "rod"
            else closure_equations(geometry, (each,), q) for each in statements]
    return ca.vertcat(*rows)


def _value(geometry: Geometry, coupling: Coupling) -> Any:
    return lambda key: geometry.value[f"{coupling.name}.{key}"]
