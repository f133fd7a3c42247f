"""Positions of joints by name: in words, and how far two are apart."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hydroopt.machine.machine import Machine


def turns(machine: Machine, joint: str) -> bool:
    """Whether a joint turns, not slides."""
    return machine.link(joint).joint.type == "revolute"


def said_posture(machine: Machine, posture: Mapping[str, float]) -> str:
    """Positions [rad or m] of joints in words."""
    return ", ".join(f"{joint} = {np.degrees(value):.1f} deg" if turns(machine, joint) else f"{joint} = {value:.3f} m"
                     for joint, value in posture.items())


def apart(machine: Machine, joint: str, one: float, other: float) -> float:
    """How far two positions [rad or m] of a joint are apart; whole turns do not count."""
    if not turns(machine, joint):
        return abs(one - other)
    return float(abs(np.arctan2(np.sin(one - other), np.cos(one - other))))
