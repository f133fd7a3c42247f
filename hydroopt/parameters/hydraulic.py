"""The parameters of valves, hoses, leaks and oil: their order, nominal values, bounds and prior."""

from __future__ import annotations

import numpy as np

from hydroopt.machine.machine import Machine
from hydroopt.machine.parameter_kind import ParameterKind as Kind
from hydroopt.machine.valves import EDGES
from hydroopt.parameters.dynamic import Scalar, scalar_block
from hydroopt.parameters.parameter_set import ParameterSet

LEAK = 1e-13
"""Typical conductance of a leak [m³/(s·Pa)]: 0.06 L/min at 100 bar."""

MOST = 0.9
"""Part of the travel that dead band and overlap take at most, if the file states no more: at all, nothing opens."""


def scalars(machine: Machine) -> dict[str, Scalar]:
    """What the machine file states of its hydraulics, the oil first, then actuator by actuator.

    What is positive by nature may be off by a factor of a hundred where the file states no bounds.
    """
    found: dict[str, Scalar] = {}

    def positive(kind: Kind, name: str, value: float | None, unit: str, path: str, upper: float = np.inf) -> None:
        if value is not None:
            found[name] = Scalar(kind, value, unit, path, value / 100, min(100 * value, upper), value)

    def whole(kind: Kind, name: str, value: float | None, unit: str, path: str, upper: float, size: float) -> None:
        if value is not None:
            found[name] = Scalar(kind, value, unit, path, 0.0, upper, size)

    if machine.oil is not None:
        positive(Kind.BULK_MODULUS, "oil.bulk_modulus", machine.oil.bulk_modulus, "Pa", "oil.bulk_modulus")
        whole(Kind.AIR, "oil.air", machine.oil.air, "1", "oil.air", 0.5, 0.01)
    for name, circuit in machine.circuits.items():
        at, valve = f"{name}.circuit", circuit.valve
        for key in ("rated_flow", *EDGES):
            positive(Kind.RATED_FLOW, f"{name}.{key}", getattr(valve, key), "m^3/s", f"{at}.valve.{key}")
        for key in ("dead_band", "dead_band_reverse"):
            whole(Kind.DEAD_BAND, f"{name}.{key}", getattr(valve, key), valve.command, f"{at}.valve.{key}",
                  max(MOST * abs(valve.span), getattr(valve, key) or 0.0), 0.1 * abs(valve.span))
        most = max(MOST, abs(valve.overlap))
        found[f"{name}.overlap"] = Scalar(Kind.OVERLAP, valve.overlap, "1", f"{at}.valve.overlap", -most, most, 0.1)
        positive(Kind.SPOOL_FREQUENCY, f"{name}.natural_frequency", valve.natural_frequency, "Hz",
                 f"{at}.valve.natural_frequency")
        positive(Kind.SPOOL_DAMPING, f"{name}.damping", valve.damping, "1", f"{at}.valve.damping", 10.0)
        for key in ("volume_a", "volume_b"):
            positive(Kind.VOLUME, f"{name}.{key}", getattr(circuit, key), "m^3", f"{at}.{key}")
        positive(Kind.HOSE_MODULUS, f"{name}.hose_modulus", circuit.hose_modulus, "Pa", f"{at}.hose_modulus")
        for key in ("leakage", "leakage_a", "leakage_b"):
            whole(Kind.LEAKAGE, f"{name}.{key}", getattr(circuit, key), "m^3/(s*Pa)", f"{at}.{key}", np.inf, LEAK)
        for key in ("air_a", "air_b"):
            whole(Kind.AIR, f"{name}.{key}", getattr(circuit, key), "1", f"{at}.{key}", 0.9, 0.01)
    return found


def parameter_set(machine: Machine) -> ParameterSet:
    """All hydraulic parameters θ of a machine; empty without circuits."""
    found = scalars(machine)
    blocks = [scalar_block(scalar, machine.notes) for scalar in found.values()]
    nominal, lower, upper, size = (np.array([float(block[k][0]) for block in blocks]) for k in range(4))
    information = np.array([float(block[4][0, 0]) for block in blocks])
    scale = np.where(information > 0, 1 / np.sqrt(np.where(information > 0, information, 1.0)), size)
    return ParameterSet(tuple(found), tuple(scalar.kind for scalar in found.values()),
                        tuple(scalar.unit for scalar in found.values()), nominal, lower, upper, scale,
                        np.diag(information))
