"""Loops that nothing drives and that carry nothing, beside a cylinder on the link that they seem to move."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import NamedTuple

from hydroopt.machine.loops import Loop
from hydroopt.machine.machine import BASE, Machine
from hydroopt.machine.quantity import ImpossibleError


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


def check(machine: Machine, stated: Collection[str]) -> None:
    """Refuse loops of which the file states that they move a link, where a cylinder passes them by.

    Raises:
        ImpossibleError: one of the loops named `stated` is idle.
    """
    for each in idle_linkages(machine):
        if each.loop in stated:
            raise ImpossibleError(each.what, each.remedy, f"loops[{each.loop}]")


def _around(machine: Machine, loop: Loop) -> list[str]:
    """The links of a loop: first the one that all others stand on."""

    def down(name: str) -> list[str]:
        path = [name]
        while path[-1] != BASE:
            path.append(machine.link(path[-1]).parent)
        return path[::-1]

    one, other = down(loop.link), down(loop.to.link)
    shared = sum(a == b for a, b in zip(one, other, strict=False))
    return [one[shared - 1], *one[shared:], *other[shared:]]
