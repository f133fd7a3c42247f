"""Other ways to read a log: signs reversed, channels exchanged, other units, another unit of time, other zeros."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product

import numpy as np

from hydroopt.logs.log import Log
from hydroopt.machine.actuators import Cylinder, Drive
from hydroopt.model.model import Model
from hydroopt.spatial.inertia import Array

UNITS: Mapping[str, Mapping[str, float]] = {
    "angle": {"deg": np.pi / 180, "rad where deg is stated": 180 / np.pi},
    "length": {"mm": 1e-3, "cm": 1e-2, "m where mm is stated": 1e3},
    "pressure": {"bar": 1e5, "psi": 6894.757, "kPa": 1e3, "MPa": 1e6, "Pa where bar is stated": 1e-5,
                 "Pa where psi is stated": 1 / 6894.757, "bar where MPa is stated": 0.1,
                 "MPa where bar is stated": 10.0, "kPa where bar is stated": 0.01, "bar where kPa is stated": 100.0,
                 "kPa where MPa is stated": 1e-3, "psi where bar is stated": 0.06894757,
                 "bar where psi is stated": 14.50377},
    "effort": {"thousand times its unit": 1e3, "a thousandth of its unit": 1e-3},
}
"""Factors that mistaken units make, by the kind of channel."""
ZEROS = (90, -90, 180, -180)
"""Degrees by which another zero of an angle is looked for."""
PRESSURES = (3e5, 1e8)
"""The highest pressure [Pa] of a hydraulic log lies in between: another unit that leads elsewhere is none."""

CLOCKS: Mapping[str, float] = {"milliseconds": 1e-3, "microseconds": 1e-6, "nanoseconds": 1e-9,
                               "seconds where milliseconds are stated": 1e3, "minutes": 60.0}
"""Factors that mistaken units of time make."""


@dataclass(frozen=True)
class Alternative:
    """Another way to read a log.

    Attributes:
        channels: that are read otherwise; ``t`` is the time.
        words: how.
        read: what reads a log so.
        factor: of these channels, where they are multiplied by one.
    """

    channels: tuple[str, ...]
    words: str
    read: Callable[[Log], Mapping[str, Array]]
    factor: float | None = None

    def of(self, log: Log) -> Log:
        """The log read so."""
        read = dict(self.read(log))
        return replace(log, t=read.pop("t", log.t), channels={**log.channels, **read})


def _scaled(channels: tuple[str, ...], factor: float, words: str) -> Alternative:
    """Channels multiplied by a factor: a reversed sign or another unit."""
    return Alternative(channels, words, lambda log: {
        name: factor * (log.t if name == "t" else log.channels[name]) for name in channels}, factor)


def _raised(name: str, by: float, words: str) -> Alternative:
    """A length counted from the fully retracted cylinder instead of from pin to pin, or an angle from another zero."""
    return Alternative((name,), words, lambda log: {name: log.channels[name] + by})


def _counted_from_level(chain: tuple[str, ...], channels: tuple[str, ...]) -> Alternative:
    """Angles of joints about parallel axes counted from the level, as inclinometers do, not from the link before.

    Args:
        chain: channels of these joints in order.
        channels: those that are counted so.
    """
    def read(log: Log) -> dict[str, Array]:
        level, steps = np.zeros(log.size), {}
        for name in chain:
            if name in channels:
                steps[name] = log.channels[name] - level
                level = log.channels[name]
            else:
                level = level + log.channels[name]
        return steps

    return Alternative(channels, f"{', '.join(channels)} counted from the level, not from the link before", read)


def _exchanged(pairs: Sequence[tuple[str, str]], words: str) -> Alternative:
    """Pairs of channels that stand for each other."""
    swapped = [(a, b) for one, other in pairs for a, b in ((one, other), (other, one))]
    return Alternative(tuple(a for a, _ in swapped), words, lambda log: {a: log.channels[b] for a, b in swapped})


def _together(parts: Sequence[Alternative]) -> Alternative:
    """Several mistakes at once that hide one another: units of everything that a log holds."""
    return Alternative(tuple(name for part in parts for name in part.channels), " and ".join(
        part.words for part in parts), lambda log: {name: values for part in parts for name, values in
                                                    part.read(log).items()})


def alternatives(model: Model, log: Log) -> Iterator[Alternative]:
    """All mistakes that are looked for in a log: single ones, and units of everything at once."""
    here, machine = set(log.channels), model.machine
    angles = [f"{joint}.q" for joint in machine.joints if f"{joint}.q" in here]
    turning = [name for name in angles if machine.channel_units[name] == "rad"]
    lengths = {f"{c.name}.length": c for c in machine.cylinders if f"{c.name}.length" in here}
    chambers = [a.chambers for a in machine.measured_actuators if not isinstance(a, Drive) and set(a.chambers) <= here]
    clocks = [_scaled(("t",), factor, f"the time in {unit}") for unit, factor in CLOCKS.items()]
    pressures = _pressure_units(log, [name for pair in chambers for name in pair])
    yield from _signs(angles)
    yield from _units("angle", turning)
    yield from _units("length", [*lengths, *(name for name in angles if name not in turning)])
    yield from clocks
    yield from pressures
    for name, cylinder in lengths.items():
        yield _raised(name, cylinder.dead_length, f"{name} counted from the retracted cylinder")
    yield from (_exchanged([(a, b)], f"{a} and {b} exchanged")
                for group in (turning, list(lengths)) for a, b in combinations(group, 2))
    yield from _from_level(model, turning)
    yield from _zeros(model, log, turning)
    for one, other in chambers:
        yield _exchanged([(one, other)], f"{one} and {other} exchanged")
        yield from (each for name in (one, other) for each in _pressure_units(log, [name]))
    for a, b in combinations(chambers, 2):
        yield _exchanged([*zip(a, b, strict=True)], f"{', '.join(a)} exchanged with {', '.join(b)}")
        yield from (_exchanged([(one, other)], f"{one} and {other} exchanged") for one, other in product(a, b))
    yield from _efforts(model, here, {name for pair in chambers for name in pair})
    degrees = [_scaled(tuple(turning), UNITS["angle"]["deg"], f"{', '.join(turning)} in deg")] if turning else []
    for parts in product([None, *degrees], [None, *pressures], [None, *clocks[:1]]):
        held = tuple(part for part in parts if part is not None)
        if len(held) > 1:
            yield _together(held)


def _from_level(model: Model, turning: list[str]) -> Iterator[Alternative]:
    """All but the first, or one, of the joints that turn about parallel axes, one behind the other."""
    chain: list[str] = []
    for joint in model.machine.joints:
        if f"{joint}.q" in turning:
            chain.append(f"{joint}.q")
        if f"{joint}.q" in turning and model.machine.link(joint).joint.alpha == 0 and joint != model.machine.joints[-1]:
            continue
        if len(chain) > 2:
            yield _counted_from_level(tuple(chain), tuple(chain[1:]))
        yield from (_counted_from_level(tuple(chain), (name,)) for name in chain[1:])
        chain = []


def _zeros(model: Model, log: Log, turning: list[str]) -> Iterator[Alternative]:
    """Other zeros of angles that are mostly beyond their joint's limits."""
    for name in turning:
        low, high = model.machine.link(name[:-2]).joint.range
        if np.mean((log.channels[name] < low) | (log.channels[name] > high)) > 0.5:
            yield from (_raised(name, np.radians(turn), f"{name} counted from a zero {abs(turn)} deg away")
                        for turn in ZEROS)


def _signs(names: list[str]) -> Iterator[Alternative]:
    for name in names:
        yield _scaled((name,), -1.0, f"the sign of {name} reversed")
    if len(names) > 1:
        yield _scaled(tuple(names), -1.0, f"the signs of {', '.join(names)} reversed")


def _units(kind: str, names: list[str]) -> Iterator[Alternative]:
    groups = [(name,) for name in names] + ([tuple(names)] if len(names) > 1 else [])
    for group in groups:
        for unit, factor in UNITS[kind].items():
            yield _scaled(group, factor, f"{', '.join(group)} in {unit}")


def _pressure_units(log: Log, names: list[str]) -> list[Alternative]:
    """Units in which these pressures would be those of a hydraulic machine."""
    highest = max((float(np.nanmax(np.abs(log.channels[name]))) for name in names), default=0.0)
    what = names[0] if len(names) == 1 else "all pressures"
    return [_scaled(tuple(names), factor, f"{what} in {unit}") for unit, factor in UNITS["pressure"].items()
            if PRESSURES[0] <= factor * highest <= PRESSURES[1]]


def _efforts(model: Model, here: set[str], chambers: set[str]) -> Iterator[Alternative]:
    """Mistakes in forces and torques that are read directly."""
    machine = model.machine
    names = [name for a in machine.measured_actuators
             if (name := f"{a.name}.force" if isinstance(a, Cylinder) else f"{a.joint}.tau") in here
             and not chambers & set(a.effort_factors)]
    yield from (_exchanged([(a, b)], f"{a} and {b} exchanged") for a, b in combinations(names, 2))
    yield from _signs(names)
    yield from _units("effort", names)
