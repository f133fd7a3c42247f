"""The flow that a motion demands of the pump: the volume rates of all growing chambers."""

from __future__ import annotations

from typing import Any

import numpy as np

from hydroopt.machine.actuators import Cylinder, Motor
from hydroopt.machine.machine import Machine
from hydroopt.spatial.inertia import Array

TOLERANCE = 1e-3
"""Part of the pump's flow by which a motion that is to be followed may exceed it: the effect of
interpolation between the samples of a designed motion."""


def chamber_flows(actuator: Cylinder | Motor, speed: Any) -> tuple[Any, Any]:
    """Flows [m³/s] that chambers a and b take at a speed [m/s or rad/s]: numbers, arrays or symbols."""
    a, b = actuator.areas
    return a * speed, -b * speed


def demanded_flow(machine: Machine, speed: Array) -> Array:
    """Flow (N,) [m³/s] that the actuators demand of the pump at their speeds (N, a) [m/s or rad/s].

    Example:
        >>> from hydroopt.machine.machine_file import load_machine
        >>> machine = load_machine("cat215b")
        >>> (6e4 * demanded_flow(machine, np.array([[0.0, 0.1, 0.0]]))).round(1)
        array([123.1])
    """
    hydraulic = [(k, each) for k, each in enumerate(machine.actuators) if isinstance(each, Cylinder | Motor)]
    return np.asarray(sum(np.maximum(*chamber_flows(each, speed[:, k])) for k, each in hydraulic))
