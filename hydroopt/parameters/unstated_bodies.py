"""Bodies that no forces can be computed of: a file states none, or what programs write where nothing is known."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from hydroopt.machine.links import Note
from hydroopt.machine.machine import Machine
from hydroopt.parameters.dynamic import Owned, bodies, carried
from hydroopt.spatial import inertia
from hydroopt.spatial.inertia import Array

LONG = 0.1
"""Length [m] from which on a link without a body is no mere axis."""


def unstated_bodies(machine: Machine) -> dict[str, str]:
    """Links, and ends of cylinders, whose bodies are missing or placeholders, each with the reason in words.

    A link that a joint moves lacks a body where neither it nor what is locked to it states a mass, unless it is a mere
    axis on the way to a further joint. A placeholder has numbers that no link has: all bodies of the machine have one
    mass, the three moments of inertia are one number, or the radius of gyration exceeds both the link and half of the
    machine's reach. A file that states how well mass, centre of mass and inertia are known means these numbers; but
    where all masses together may be off by more than their sum, it states none.

    >>> import hydroopt as ho
    >>> unstated_bodies(ho.load_machine("cat215b"))
    {}
    """
    return dict(_missing(machine)) | dict(_placeholders(machine))


def joints_of_unstated_bodies(machine: Machine) -> frozenset[str]:
    """Joints of q that carry such bodies, or a mass that may be off by more than itself: nominal forces there mean
    nothing."""
    unstated, own, found = unstated_bodies(machine), carried(machine), bodies(machine)
    loads: dict[str, set[str]] = {joint: set() for joint in machine.joints}
    for link in machine.links:
        for joint in {joint for each in machine.ancestry(link.name) for joint in machine.followed.get(each, ())}:
            loads[joint] |= {link.name, *own.get(link.name, ())}
    return frozenset(joint for joint, load in loads.items() if unstated.keys() & load or _unknown(
        machine, [found[owner] for owner in load if owner in found]))


def link_sizes(machine: Machine) -> dict[str, float]:
    """Distance [m] from each link's origin to its far end or to the farthest pin on it."""
    sizes = {link.name: abs(link.joint.a) for link in machine.links}
    for part in machine.pinned:
        for end in (part.barrel, part.rod):
            sizes[end.link] = max(sizes.get(end.link, 0.0), math.hypot(*end.pin))
    return sizes


def reach(machine: Machine) -> float:
    """Length [m] of all links in a row, with what slides fully extended."""
    sliding = (link.joint.range for link in machine.links if link.joint.independent and link.joint.type == "prismatic")
    return sum(math.hypot(link.joint.a, link.joint.d) for link in machine.links) + sum(
        max(map(abs, each)) for each in sliding)


def _missing(machine: Machine) -> Iterator[tuple[str, str]]:
    for joint in machine.joints:
        rigid = {joint}
        for link in machine.links:
            if link.parent in rigid and link.joint.type == "locked":
                rigid.add(link.name)
        stated = [machine.link(name).body for name in rigid]
        if joint in machine.base_joints or any(body is not None and body.m > 0 for body in stated):
            continue
        last = not any(link.parent in rigid and link.joint.moving for link in machine.links)
        if last or sum(abs(machine.link(name).joint.a) for name in rigid) > LONG:
            yield joint, "without a mass"


def _placeholders(machine: Machine) -> Iterator[tuple[str, str]]:
    found = {owner: owned for owner, owned in bodies(machine).items() if owned.body.m > 0}
    masses, unknown = {owned.body.m for owned in found.values()}, _unknown(machine, list(found.values()))
    sizes, half, ends = link_sizes(machine), reach(machine) / 2, {
        owner: link for link, owners in carried(machine).items() for owner in owners}
    for owner, owned in found.items():
        m, moments = owned.body.m, _central_moments(owned)
        size = max(sizes.get(ends.get(owner, ""), 0.0), half, math.hypot(*owned.body.phi[1:4]) / m, LONG)
        if unknown:
            yield owner, f"of {m:.3g} kg with a larger sigma"
        elif all(_note(machine, owned, *keys).sigma for keys in (("m",), ("com", "mc"), ("inertia_com", "inertia"))):
            continue
        elif len(found) > 1 and len(masses) == 1:
            yield owner, f"of {m:.3g} kg, all alike"
        elif np.allclose(moments, moments[2], atol=0.0):
            yield owner, "with three equal moments of inertia"
        elif m * size**2 < moments[2] <= moments[0] + moments[1]:  # else it is no body at all
            yield owner, f"with a radius of gyration beyond {size:.2g} m"


def _unknown(machine: Machine, load: Sequence[Owned]) -> bool:
    """Whether the masses of some bodies may together be off by more than their sum; ±100 % where no sigma is stated."""
    masses = [owned.body.m for owned in load]
    spreads = [m if (spread := _note(machine, owned, "m").spread(m)) is None else spread
               for m, owned in zip(masses, load, strict=True)]
    return math.hypot(*spreads) > sum(masses)


def _note(machine: Machine, owned: Owned, *keys: str) -> Note:
    return next((note for key in keys if (note := machine.notes.get(f"{owned.path}.{key}"))), Note())


def _central_moments(owned: Owned) -> Array:
    """Principal moments of inertia (3,) [kg·m²] about the centre of mass, ascending."""
    phi = owned.body.phi
    com = phi[1:4] / phi[0]
    return np.linalg.eigvalsh(inertia.tensor(phi[4:]) - phi[0] * (com @ com * np.eye(3) - np.outer(com, com)))
