"""Whether what a machine file states beside its numbers can be meant: its gravity and totals, its confidences and
bounds, and linkages that nothing drives."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import NamedTuple

from hydroopt.machine.environment import CHASSIS
from hydroopt.machine.loops import Loop
from hydroopt.machine.machine import BASE, Machine
from hydroopt.machine.parameter_kind import ParameterKind
from hydroopt.machine.quantity import ImpossibleError

STRONGEST_GRAVITY = 30.0
"""Gravity [m/s²] above that of any planet."""
TOTAL_FACTOR = 10.0
"""How many times a weighed total may differ from the nominal masses before one of them is a mistake."""
_UNBOUNDED = (ParameterKind.FIRST_MOMENT, ParameterKind.MOMENT_OF_INERTIA)


def check(machine: Machine, moving: Collection[str] = ()) -> None:
    """Check what a machine file states beside its numbers: linkages, standard deviations, bounds, totals, gravity.

    Args:
        machine: the machine.
        moving: names of the loops of which the file states that they move a link; no cylinder may pass them by.

    Raises:
        ImpossibleError: names the number, its place and the remedy.
    """
    for mistake in _mistakes(machine, moving):
        raise mistake


def _mistakes(machine: Machine, moving: Collection[str]) -> Iterator[ImpossibleError]:
    for each in idle_linkages(machine):
        if each.loop in moving:
            yield ImpossibleError(each.what, each.remedy, f"loops[{each.loop}]")
    if machine.gravity > STRONGEST_GRAVITY:
        yield ImpossibleError(f"gravity is {machine.gravity:.4g} m/s^2", "on earth it is 9.81 m/s^2", "gravity")
    numbers = tuple(machine.numbers.values())
    used = {"sigma": {*(number.path for number in numbers), *_further_calibrated(machine)},
            "bounds": {number.path for number in numbers if number.kind not in _UNBOUNDED}}
    for path, note in machine.notes.items():
        for what, stated in (("sigma", (note.sigma,)), ("bounds", (note.lower, note.upper))):
            if any(value is not None for value in stated) and path not in used[what]:
                yield ImpossibleError(f"nothing uses the {what} of this number", f"remove the {what}",
                                      machine.place(path))
    masses = {number.name.removesuffix(".m"): number.value for number in numbers if number.kind is ParameterKind.MASS}
    for total in machine.total_masses:
        nominal = sum(masses[body] for body in total.bodies)
        if nominal > 0 and not 1 / TOTAL_FACTOR < total.value / nominal < TOTAL_FACTOR:
            yield ImpossibleError(f"the bodies are weighed as {total.value:.6g} kg together, but their masses in this "
                                  f"file add up to {nominal:.6g} kg", "correct the total, its unit, or the masses",
                                  f"total_masses[{total.name}]")


def _further_calibrated(machine: Machine) -> Iterator[str]:
    """Paths of what estimators use with its sigma, but which is no number of the machine by itself."""
    for number in machine.numbers.values():
        if number.kind is ParameterKind.MASS:
            body = number.path.removesuffix(".m")
            yield from (f"{body}.com", f"{body}.inertia_com")
    yield from (f"{distance.name}.length" for distance in machine.distances)
    yield from (f"{total.name}.value" for total in machine.total_masses)
    yield from CHASSIS
    for stage in machine.stages:
        yield from (f"{stage.name}.locked.{joint}" for joint in stage.locked)
    yield from machine.lags


class IdleLinkage(NamedTuple):
    """A loop whose `bars` only follow the link `moves`, to which the cylinder is pinned itself."""

    loop: str
    cylinder: str
    moves: str
    bars: tuple[str, ...]

    @property
    def what(self) -> str:
        """What is wrong."""
        return (f"{self.cylinder} is pinned to {self.moves} itself and passes the linkage {self.loop} by: nothing "
                f"drives {' and '.join(self.bars)}")

    @property
    def remedy(self) -> str:
        """What to do if the linkage moves the link, and otherwise."""
        return (f"pin {self.cylinder} to {' or '.join(self.bars)}; a linkage that only follows {self.moves} is stated "
                "by its links and [[loops]]")


def idle_linkages(machine: Machine) -> Iterator[IdleLinkage]:
    """Loops of which a cylinder passes by all bars: it stands between the links that bear and that end the linkage.

    A bar is idle if it depends, and no cylinder, spring, motor or coupling, no other link and no other loop is on it. A
    linkage that carries the machine's tip, such as the arms of a platform, is not idle. Locked links count as parts of
    those that they are fixed to.

    >>> from hydroopt.machine.machine_file import load_machine
    >>> list(idle_linkages(load_machine("excavator_bucket")))
    []
    """
    fixed_to = {BASE: BASE}
    for link in machine.links:
        fixed_to[link.name] = link.name if link.joint.moving else fixed_to[link.parent]
    ends = {part.name: {fixed_to[part.barrel.link], fixed_to[part.rod.link]} for part in machine.pinned}
    held = {loop.name: {fixed_to[loop.link], fixed_to[loop.to.link]} for loop in machine.loops}
    busy = {fixed_to[machine.tip]}.union(
        *ends.values(), *(each.joints for each in machine.couplings),
        *map(machine.moved_by, machine.motors), *map(machine.moved_by, machine.drives))
    for loop in machine.loops:
        ground, *moving = dict.fromkeys(fixed_to[name] for name in _around(machine, loop))
        carrying = {fixed_to[each.parent] for each in machine.links if fixed_to[each.name] not in moving}
        others = busy.union(carrying, *(links for name, links in held.items() if name != loop.name))
        for moved in moving:
            bars = tuple(bar for bar in moving if bar != moved)
            idle = others.isdisjoint(bars) and not any(machine.link(bar).joint.independent for bar in bars)
            cylinder = next((each.name for each in machine.cylinders if ends[each.name] == {ground, moved}), None)
            if bars and idle and cylinder:
                yield IdleLinkage(loop.name, cylinder, moved, bars)


def _around(machine: Machine, loop: Loop) -> list[str]:
    """The links of a loop: first the one that all others stand on."""
    one, other = ((BASE, *machine.ancestry(name)[::-1]) for name in (loop.link, loop.to.link))
    shared = sum(a == b for a, b in zip(one, other, strict=False))
    return [one[shared - 1], *one[shared:], *other[shared:]]
