"""The parameters of valves, hoses, leaks and oil: their order, nominal values, bounds and prior."""

from __future__ import annotations

import numpy as np

from hydroopt.machine.addresses import Number
from hydroopt.machine.machine import Machine
from hydroopt.machine.parameter_kind import ParameterKind as Kind
from hydroopt.parameters.dynamic import Scalar, scalar_block
from hydroopt.parameters.parameter_set import ParameterSet

LEAK = 1e-13
"""Typical conductance of a leak [m³/(s·Pa)]: 0.06 L/min at 100 bar."""

LONGEST = 10.0
"""Delay [s] of a valve at most, as in a machine file."""

MOST = 0.9
"""Part of the travel that dead band and overlap take at most, if the file states no more: at all, nothing opens."""


def scalars(machine: Machine) -> dict[str, Scalar]:
    """What the machine file states of its hydraulics, the oil first, then actuator by actuator.

    What is positive by nature may be off by a factor of a hundred where the file states no bounds.
    """
    return {number.name: _bounded(number, machine) for number in machine.hydraulic_numbers}


def _bounded(number: Number, machine: Machine) -> Scalar:
    owner, value = number.name.partition(".")[0], number.value
    if number.kind is Kind.OVERLAP:
        most = max(MOST, abs(value))
        return Scalar(number, -most, most, 0.1)
    if number.kind is Kind.DEAD_BAND:
        span = abs(machine.circuits[owner].valve.span)
        return Scalar(number, 0.0, max(MOST * span, value), 0.1 * span)
    if number.kind is Kind.DELAY:
        return Scalar(number, 0.0, LONGEST, value)
    if number.kind is Kind.LEAKAGE:
        return Scalar(number, 0.0, np.inf, LEAK)
    if number.kind is Kind.AIR:
        return Scalar(number, 0.0, 0.9 if owner in machine.circuits else 0.5, 0.01)
    return Scalar(number, value / 100, min(100 * value, 10.0 if number.kind is Kind.SPOOL_DAMPING else np.inf), value)


def parameter_set(machine: Machine) -> ParameterSet:
    """All hydraulic parameters θ of a machine; empty without circuits."""
    found = scalars(machine)
    blocks = [scalar_block(scalar, machine.notes) for scalar in found.values()]
    nominal, lower, upper, size = (np.array([float(block[k][0]) for block in blocks]) for k in range(4))
    information = np.array([float(block[4][0, 0]) for block in blocks])
    scale = np.where(information > 0, 1 / np.sqrt(np.where(information > 0, information, 1.0)), size)
    return ParameterSet(tuple(found), tuple(scalar.number.kind for scalar in found.values()),
                        tuple(scalar.number.unit for scalar in found.values()), nominal, lower, upper, scale,
                        np.diag(information))
