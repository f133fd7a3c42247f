"""Channels that tell nothing: without a number, or a force that never changes while its joint moves."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hydroopt.logs.log import Log
from hydroopt.logs.quality import Finding
from hydroopt.machine.machine import Machine

MOVES = 0.05
"""Part of its range that a joint must cover before constant forces are dead."""
TANK = 1e6
"""Pressure [Pa] below which one chamber may be constant, because it is open to the tank."""


def without_dead_channels(machine: Machine, log: Log) -> Log:
    """A log without channels that hold no number and forces that are dead, and a finding of each.

    A force is dead if it never changes although the joint of its actuator moves. One pressure of two, below 10 bar, may
    be that of a chamber which is open to the tank, and stays.

    >>> import numpy as np
    >>> from hydroopt.logs.log import Log
    >>> from hydroopt.machine.machine_file import load_machine
    >>> t = np.arange(100) / 50
    >>> log = Log("run", t, {"boom.q": 0.5 + 0.3 * np.sin(t), "boom_cylinder.p_head": np.full(100, 2.5e7),
    ...                      "boom_cylinder.p_rod": 1e6 + 1e5 * np.sin(t)})
    >>> alive = without_dead_channels(load_machine("cat215b"), log)
    >>> list(alive.channels)
    ['boom.q', 'boom_cylinder.p_rod']
    >>> alive.findings[0].text
    'boom_cylinder.p_head reads 2.5e+07 Pa in all samples while boom moves; left out'
    """
    extremes = {channel: log.extremes(channel) for channel in log.channels}
    found = {channel: Finding("empty", channel, *log.rows, log.size, f"{channel}: no number in any row; left out")
             for channel, (low, high) in extremes.items() if low > high}
    for actuator in machine.measured_actuators:
        moving = [joint for joint in machine.moved_by(actuator) if _moves(machine, extremes, joint)]
        still = {channel: low for channel in actuator.effort_factors if channel in extremes
                 for low, high in [extremes[channel]] if low == high}
        for channel, value in still.items() if moving else ():
            if len(still) == len(actuator.effort_factors) or abs(value) > TANK:
                text = (f"{channel} reads {value:.4g} {log.units[channel]} in all samples while {moving[0]} moves; "
                        "left out")
                found[channel] = Finding("dead", channel, *log.rows, log.size, text)
    return log.without(found, tuple(found.values())) if found else log


def _moves(machine: Machine, extremes: Mapping[str, tuple[float, float]], joint: str) -> bool:
    ranges = position_ranges(machine, joint)
    return any(high - low > MOVES * ranges[name] for name, (low, high) in extremes.items() if name in ranges)


def position_ranges(machine: Machine, joint: str) -> dict[str, float]:
    """By channel that tells a joint's position, its own or a cylinder's length: from end to end."""
    return {f"{joint}.q": float(np.ptp(machine.link(joint).joint.range))} | {
        f"{cylinder.name}.length": cylinder.stroke for cylinder in machine.cylinders
        if joint in machine.moved_by(cylinder)}
