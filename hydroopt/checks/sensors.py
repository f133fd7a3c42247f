"""Sensors that cannot be read as they are: stuck at a value, scattering beyond their accuracy, beyond relief."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from hydroopt.checks.alternatives import UNITS
from hydroopt.logs.channels import is_force
from hydroopt.logs.dead_channels import position_ranges
from hydroopt.logs.log import Log
from hydroopt.logs.quality import frozen, held, without_noise
from hydroopt.logs.table import runs
from hydroopt.machine.machine import Machine
from hydroopt.machine.sensors import Sensor
from hydroopt.results.diagnostic import Diagnostic, Meaning
from hydroopt.spatial.inertia import Array

JUMP = 3.0
"""Step at the end of a rest, as a multiple of the largest one elsewhere, that shows a sensor stuck."""
STUCK = 0.05
"""Share of a log's samples that a sensor must be stuck in."""
MOVED, LEAST = 0.05, 0.005
"""Part of what a joint moves in the log, and of its range, that it must move while a sensor is stuck."""
SCATTER = 5.0
"""White noise of a channel, as a multiple of its stated standard deviation, that is no longer its sensor's."""
ALIKE = 0.15
"""Difference of a ratio of scatters from that of two units, as a part of it, up to which it may be that."""
RELIEF = 1.5
"""Pressure as a multiple of the relief pressure that no relief valve allows, however slow."""
OFTEN = 0.02
"""Share of samples beyond relief pressure that is worth a diagnostic."""


def beyond_relief(machine: Machine, log: Log, where: str) -> Iterator[Diagnostic]:
    """Pressures that exceed what relief valves allow."""
    for part in machine.hydraulic_actuators:
        for channel in part.chambers if part.relief_pressure else ():
            share = float(np.mean(log.channels.get(channel, np.zeros(1)) > RELIEF * (part.relief_pressure or 0.0)))
            if share > OFTEN:
                yield Diagnostic.of("beyond relief pressure", (channel,), {
                    "log": where, "share": share, "highest_bar": float(np.nanmax(log.channels[channel])) / 1e5,
                    "relief_bar": (part.relief_pressure or 0.0) / 1e5},
                    "{subject} in {log} is far beyond its relief pressure of {relief_bar:.0f} bar in {share:.0f %} of "
                    "the samples: up to {highest_bar:.0f} bar.",
                    "Correct the unit of this column in the file or its map, or the relief pressure in the machine "
                    "file.", Meaning.CONTRADICTION)


def stuck_sensors(machine: Machine, log: Log, where: str) -> Iterator[Diagnostic]:
    """Forces that rest at one value while their joint moves, and positions while others that go with them move.

    >>> from dataclasses import replace
    >>> from hydroopt.machine.machine_file import load_machine
    >>> from hydroopt.simulation.simulate import random_trajectory, simulate
    >>> machine = load_machine("cat215b")
    >>> log = simulate(machine, random_trajectory(machine, duration=16.0, rate=50.0, seed=1), seed=1)
    >>> list(stuck_sensors(machine, log, "run"))
    []
    >>> head = log.channels["boom_cylinder.p_head"].copy()
    >>> head[400:] = head[400]
    >>> stuck = replace(log, channels={**log.channels, "boom_cylinder.p_head": head})
    >>> [(found.kind, found.subject) for found in stuck_sensors(machine, stuck, "run")]
    [('sensor stuck', ('boom_cylinder.p_head',))]
    """
    if without_noise(log.channels):
        return
    for channel, joints in _movers(machine, log).items():
        stuck, joint = np.zeros(log.size, dtype=bool), ""
        for start, stop in frozen(log.channels[channel], log.segment):
            if moved := [name for name in joints if _moves(machine, log, name, channel, slice(start, stop))]:
                stuck[start:stop], joint = True, joint or moved[0]
        share = float(np.mean(stuck))
        if share >= STUCK:
            at = np.flatnonzero(stuck)
            yield _stuck(log, channel, at, where, f" while {joint} moves")
    for joint in machine.joints:  # read by one sensor alone
        if (channel := f"{joint}.q") in log.channels and channel not in _movers(machine, log):
            at, jump = _before_jumps(log, channel)
            if at.size >= STUCK * log.size:
                yield _stuck(log, channel, at, where, f", then jumps by {jump:.3g} {log.units[channel]}")


def _stuck(log: Log, channel: str, at: NDArray[np.int64], where: str, evidence: str) -> Diagnostic:
    return Diagnostic.of("sensor stuck", (channel,), {
        "log": where, "count": int(at.size), "rows": runs(log.sample[at]), "evidence": evidence,
        "value": float(log.channels[channel][at[0]]), "unit": log.units[channel], "from_s": float(log.t[at[0]]),
        "to_s": float(log.t[at[-1]])},
        "{subject} is stuck at {value:.4g} {unit} in {count} samples of {log} (rows {rows}){evidence}.",
        "Check this sensor and its wiring, record again, or leave these samples out: --treat stuck=drop.",
        Meaning.CONTRADICTION)


def _before_jumps(log: Log, channel: str) -> tuple[NDArray[np.int64], float]:
    """Samples in which a position rests while other channels do not, and then leaves its value by a step that its
    motion has nowhere else; and the largest such step."""
    x = log.channels[channel]
    level = [span for span in frozen(x, log.segment)
             if any(np.ptp(other[slice(*span)]) > 0 for name, other in log.channels.items() if name != channel)]
    steps = np.abs(np.diff(x))
    ends = [stop - 1 for _, stop in level if stop < x.size]
    usual = float(np.max(np.delete(steps, ends), initial=0.0))
    jumped = [(start, stop) for start, stop in level if stop < x.size and steps[stop - 1] > JUMP * usual]
    at = np.concatenate([np.arange(*span) for span in jumped]) if jumped else np.zeros(0, dtype=np.int64)
    return at, max((float(steps[stop - 1]) for _, stop in jumped), default=0.0)


def held_sensors(machine: Machine, log: Log, where: str) -> Iterator[Diagnostic]:
    """Positions that a logger repeats between the samples of a slower sensor."""
    channels = [f"{joint}.q" for joint in machine.joints] + [f"{each.name}.length" for each in machine.cylinders]
    found = {name: every for name in channels if name in log.channels and (every := held(log.channels[name]))}
    if found:
        every = max(found.values())
        step = float(np.median(np.diff(log.t)))
        yield Diagnostic.of("sensor held", tuple(found), {"log": where, "every": every, "rate": 1 / (every * step)}, (
            "{subject}: only one sample in {every} of {log} is a new reading ({rate:.3g} Hz); the others repeat it, "
            "as many loggers do."),
            "Leave the repeated samples out: --treat held=drop; or log each group of sensors with a clock of its own.",
            Meaning.CONTRADICTION)


def _moves(machine: Machine, log: Log, joint: str, channel: str, span: slice) -> bool:
    """Whether a joint moves in some samples, by another channel than the one that may be stuck."""
    return any(np.ptp(log.channels[name][span]) > max(MOVED * np.ptp(log.channels[name]), LEAST * whole)
               for name, whole in position_ranges(machine, joint).items() if name in log.channels and name != channel)


def _movers(machine: Machine, log: Log) -> Mapping[str, tuple[str, ...]]:
    """By channel of forces, and of positions that are measured twice: the joints whose motion it shows."""
    found = {channel: tuple(machine.moved_by(actuator)) for actuator in machine.measured_actuators
             for channel in actuator.effort_factors}
    for cylinder in machine.cylinders:
        alone = machine.moved_by(cylinder)
        twice = [f"{cylinder.name}.length", *(f"{joint}.q" for joint in alone)]
        if len(alone) == 1 and set(twice) <= set(log.channels):
            found |= dict.fromkeys(twice, tuple(alone))
    return {channel: joints for channel, joints in found.items() if channel in log.channels}


def scattering(machine: Machine, log: Log, where: str) -> Iterator[Diagnostic]:
    """Forces that scatter from sample to sample far more than stated, with the unit that would explain it; positions
    are not judged, whose motion is as large as that between two samples."""
    for sensor in machine.sensors:
        ratios = {channel: noise(log.channels[channel], log.segment) / sensor.std for channel in sensor.channels
                  if channel in log.channels and is_force(channel) and sensor.std > 0}
        for channel, ratio in ratios.items():
            if ratio > SCATTER:
                others = [other for name, other in ratios.items() if name != channel]
                usual = float(np.median(others)) if others else 1.0
                yield Diagnostic.of("sensor scatters beyond its accuracy", (channel,), {
                    "log": where, "ratio": ratio, "noise": ratio * sensor.std, "unit": log.units[channel],
                    "others": usual, "reading": _other_unit(sensor, ratio / max(usual, 1 / SCATTER))},
                    "{subject} in {log} scatters by {noise:.3g} {unit} from sample to sample, {ratio:.2g} times its "
                    "stated accuracy{reading}.",
                    "Correct the unit of this column in the file or its map, or the sensor's accuracy in the machine "
                    "file.", Meaning.CONTRADICTION)


def _other_unit(sensor: Sensor, ratio: float) -> str:
    """The mistake of units that makes a channel so many times too large, in words; empty if there is none."""
    if not sensor.channels[0].rpartition(".")[2].startswith("p_"):
        return ""
    fitting = {abs(ratio * factor - 1): words for words, factor in UNITS["pressure"].items()}
    return f", as if its numbers were in {fitting[min(fitting)]}" if min(fitting) < ALIKE else ""


def noise(x: Array, segment: NDArray[np.int64]) -> float:
    """Standard deviation of white noise in a channel (N,), from third differences within stretches; 0 without any.

    >>> rng = np.random.default_rng(0)
    >>> bool(abs(noise(np.linspace(0, 9, 4000) ** 2 + 0.3 * rng.standard_normal(4000), np.zeros(4000)) - 0.3) < 0.02)
    True
    """
    within = segment[3:] == segment[:-3]
    third = np.abs(np.diff(x, 3)[within])
    third = third[np.isfinite(third)]
    return float(1.4826 * np.median(third) / np.sqrt(20.0)) if third.size else 0.0
