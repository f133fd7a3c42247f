"""The load that the actuators of a machine hold at its tip beside the machine itself."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from hydroopt.machine.actuators import Actuator, Drive
from hydroopt.machine.machine import Machine
from hydroopt.spatial.inertia import Array

WORKING_PRESSURE = 2e7
"""Pressure [Pa] up to which an actuator works at least that states no relief pressure."""
LOADED = 1e-6
"""Part of the largest effect of a load from which on it counts as loading a balance or joint."""


class Capacity(NamedTuple):
    """What the actuators hold in one posture.

    Attributes:
        load: [kg] beside the machine itself; NaN where a drive states no limit.
        holder: names of the actuators that hold no more, joined by "and".
        pressure: least relief pressure [Pa] of the holder, stated or assumed; None of drives.
        missing: names of those of the holder whose limit is not stated.
    """

    load: float
    holder: str
    pressure: float | None
    missing: tuple[str, ...]

    @property
    def owner(self) -> str:
        """Whose limits are missing, before the name of the limit."""
        return "its" if len(self.missing) == 1 and self.missing[0] == self.holder else f"{' and '.join(self.missing)}'s"


def capacity(machine: Machine, force: Array, effect: Array, shares: Array, reached: Mapping[str, float]) -> Capacity:
    """The load that the actuators hold at the tip in one posture, and which of them holds no more.

    A cylinder pushes with its head side's area and pulls with its rod side's. Passive joints hold nothing and hang.

    Args:
        machine: with relief pressures and torques.
        force: (r,) that holds the machine itself; `effect` (r,) of a load per its mass.
        shares: (r, a) of the actuators in the balances.
        reached: highest pressure [Pa] of actuators in logs by name, which they work at if they state no relief.
    """
    found = []
    loaded = np.abs(effect) > LOADED * np.max(np.abs(effect))
    for balance, f, e, share in zip(machine.balances, force, effect, shares, strict=True):
        if not balance.actuators or not loaded[machine.balances.index(balance)]:
            continue
        acting = [(actuator, part) for actuator, part in zip(machine.actuators, share.tolist(), strict=True) if part]
        push = sum(abs(part) * _limits(actuator, reached)[part < 0] for actuator, part in acting)
        pull = sum(abs(part) * _limits(actuator, reached)[part > 0] for actuator, part in acting)
        room = max(0.0, (push - f) / e if e > 0 else (pull + f) / -e) if -pull <= f <= push else 0.0
        actuators = [actuator for actuator, _ in acting]
        pressures = [_pressure(each, reached) for each in actuators if not isinstance(each, Drive)]
        found.append(Capacity(np.nan if np.isnan(push) else float(room), " and ".join(each.name for each in actuators),
                              min(pressures, default=None), tuple(each.name for each in actuators if _unstated(each))))
    return min(found, key=lambda each: -1.0 if np.isnan(each.load) else each.load)


def _unstated(actuator: Actuator) -> bool:
    return (actuator.max_torque if isinstance(actuator, Drive) else actuator.relief_pressure) is None


def _pressure(actuator: Actuator, reached: Mapping[str, float]) -> float:
    assert not isinstance(actuator, Drive)
    return actuator.relief_pressure or max(WORKING_PRESSURE, reached.get(actuator.name, 0.0))


def _limits(actuator: Actuator, reached: Mapping[str, float]) -> tuple[float, float]:
    """Greatest positive and negative force [N or N·m] in magnitude; NaN where a drive states none."""
    if isinstance(actuator, Drive):
        torque = np.nan if actuator.max_torque is None else actuator.max_torque
        return torque, torque
    pressure = _pressure(actuator, reached)
    return actuator.areas[0] * pressure, actuator.areas[1] * pressure
