"""From the independent joints q to all joints of the tree: loops and couplings, each as the machine is assembled."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from hydroopt.machine.assembly import Assembly
from hydroopt.machine.closures import (
    Closure,
    DyadClosure,
    GeneralClosure,
    LinearClosure,
    SliderClosure,
    closures,
    place,
)
from hydroopt.machine.dyads import DyadAssembly
from hydroopt.machine.general_loops import assembled
from hydroopt.machine.geometry import Geometry
from hydroopt.machine.linear_closures import LinearAssembly
from hydroopt.machine.loops import Loop
from hydroopt.machine.machine import Machine
from hydroopt.machine.posture import apart, said_posture, turns
from hydroopt.machine.quantity import ImpossibleError
from hydroopt.machine.sliders import SliderAssembly

BranchedAssembly = DyadAssembly | SliderAssembly
NEAR, WITHIN = 0.5, np.radians(45.0)
"""A posture tells how a loop is assembled if it is nearer to one of the two ways than this part of the distance to the
other, and than this angle [rad]."""


class Branch(NamedTuple):
    """How clearly a posture states in which of two ways a loop is assembled.

    Attributes:
        loop: its name.
        joint: that of the stated dependent joints that is farthest from where it stands in the way that is taken.
        near, far: greatest distances [rad, or m of a joint that slides] of the stated positions from the way that is
            taken and from the other one.
        stands: the way that is taken, in words.
    """

    loop: str
    joint: str
    near: float
    far: float
    stands: str


class Mechanism:
    """The loops and couplings of a machine, each with the way in which it is assembled.

    Args:
        at: positions [rad or m] of all joints by name that tell how loops are assembled; their own postures by default.

    Attributes:
        assemblies: in the order of `hydroopt.machine.closures.closures`.

    Raises:
        ImpossibleError: a posture does not tell which way a loop is assembled.

    >>> from hydroopt.machine.machine_file import load_machine
    >>> Mechanism(load_machine("cat215b")).assemblies
    ()
    """

    def __init__(self, machine: Machine, at: Mapping[str, float] | None = None) -> None:
        self._machine, self._at = machine, at
        self.assemblies: tuple[Assembly, ...] = ()
        for closure in closures(machine.links, machine.loops, machine.couplings):
            self.assemblies += (_assembled(self, Geometry(machine), closure),)

    def positions(self, geometry: Geometry, q: Mapping[str, Any]) -> dict[str, Any]:
        """Positions of all moving joints of the tree by name, from those of the independent ones.

        Closures that follow a joint that `q` leaves out are left out too.
        """
        found = dict(q)
        for each in self.assemblies:
            if all(joint in q for joint in each.closure.follows):
                found |= each.solved(geometry, found).positions
        return found

    def sines(self, geometry: Geometry, q: Mapping[str, Any]) -> list[ca.SX]:
        """Of each closure but couplings the sine of `Solved`: zero at a dead point, not a number where it cannot close.

        Closures that follow a joint that `q` leaves out are left out.
        """
        at = self.positions(geometry, q)
        found = [each.solved(geometry, at).sine for each in self.assemblies
                 if all(joint in q for joint in each.closure.follows)]
        return [sine for sine in found if sine is not None]

    def turned_round(self, geometry: Geometry, joint: str, other: str, value: float) -> Mechanism | None:
        """The mechanism in which a joint of q follows a dependent one that follows it alone; None if there is none.

        It is assembled as this one is where `joint` stands at `value`.
        """
        at = {name: float(each) for name, each in self.positions(geometry, {joint: ca.DM(value)}).items()}
        flags = {joint: True, other: False}
        links = tuple(link.model_copy(update={"joint": link.joint.model_copy(update={"dependent": flags[link.name]})})
                      if link.name in flags else link for link in self._machine.links)
        own = {each.name for assembly in self.assemblies if assembly.closure.follows == (joint,)
               for each in assembly.closure.statements}
        machine = self._machine.model_copy(update={
            "links": links, "couplings": tuple(each for each in self._machine.couplings if each.name in own),
            "loops": tuple(each for each in self._machine.loops if each.name in own)})
        try:
            return Mechanism(machine, at)
        except ImpossibleError:  # not in a closed form
            return None

    def posture(self, closure: Closure) -> dict[str, float]:
        """Positions [rad or m] of joints by name that tell how a closure is assembled.

        Raises:
            ImpossibleError: the stated ones name other joints, or too few.
        """
        if self._at is not None:
            return {joint: self._at[joint] for joint in (*closure.follows, *closure.joints)}
        stated: dict[str, float] = {}
        for each in closure.statements:
            for joint, value in each.posture.items() if isinstance(each, Loop) else ():
                if stated.setdefault(joint, value) != value:
                    raise ImpossibleError(f"the loops that close together have two postures of '{joint}'",
                                          "state one posture of all of them", f"{place(each)}.posture.{joint}")
        _refuse_posture(closure, stated)
        return stated


def _assembled(before: Mechanism, geometry: Geometry, closure: Closure) -> Assembly:
    match closure:
        case LinearClosure():
            return LinearAssembly(closure)
        case DyadClosure() | SliderClosure():
            return _compared(before, geometry, closure)[0]
        case GeneralClosure():
            return _tracked(before, geometry, closure)


_KNOWN: dict[tuple[str, str], Assembly] = {}
"""What tracking has found of loops, by their links and their posture: the same machine is assembled many times."""
REMEMBERED = 64


def _tracked(before: Mechanism, geometry: Geometry, closure: GeneralClosure) -> Assembly:
    """Loops that close together, by Newton's method."""
    posture = before.posture(closure)
    key = (geometry.machine.model_dump_json(include={"links", "loops", "couplings"}), repr((closure.joints, posture)))
    if key not in _KNOWN:
        q = ca.SX.sym("q", len(closure.follows))
        at = before.positions(geometry, dict(zip(closure.follows, ca.vertsplit(q), strict=True)))
        found = assembled(geometry, closure, posture, at, q)
        while len(_KNOWN) >= REMEMBERED:
            _KNOWN.pop(next(iter(_KNOWN)))
        _KNOWN[key] = found
    return _KNOWN[key]


def _ways(closure: DyadClosure | SliderClosure) -> tuple[BranchedAssembly, BranchedAssembly]:
    """Both ways to assemble a loop."""
    if isinstance(closure, DyadClosure):
        return DyadAssembly(closure, 1), DyadAssembly(closure, -1)
    return SliderAssembly(closure, 1), SliderAssembly(closure, -1)


def branches(machine: Machine) -> tuple[Branch, ...]:
    """How clearly postures state in which of two ways loops are assembled, for every loop that has two.

    >>> from hydroopt.machine.machine_file import load_machine
    >>> found, = branches(load_machine("excavator_bucket"))
    >>> found.loop, found.joint, round(float(np.degrees(found.near))), round(float(np.degrees(found.far)))
    ('bucket_linkage', 'rocker', 0, 91)
    """
    mechanism, geometry = Mechanism(machine), Geometry(machine)
    return tuple(_compared(mechanism, geometry, each.closure)[1] for each in mechanism.assemblies
                 if isinstance(each, DyadAssembly | SliderAssembly))


def _compared(before: Mechanism, geometry: Geometry,
              closure: DyadClosure | SliderClosure) -> tuple[BranchedAssembly, Branch]:
    """The way of assembling a loop that comes nearer to its stated posture, and how clearly it does."""
    loop, ways, machine = closure.loop, _ways(closure), geometry.machine
    posture, where = before.posture(closure), f"{place(loop)}.posture"
    stated = [joint for joint in closure.joints if joint in posture]
    q = before.positions(geometry, {joint: ca.DM(posture[joint]) for joint in closure.follows})
    at = said_posture(machine, {joint: posture[joint] for joint in closure.follows})
    turned = [{joint: float(value) for joint, value in way.solved(geometry, q).positions.items()} for way in ways]
    if not all(np.isfinite(value) for found in turned for value in found.values()):
        raise ImpossibleError(f"the loop '{loop.name}' cannot close in its own posture, {at}: "
                              f"{ways[0].why_open(geometry, q)}", "correct its pins and lengths, or the posture", where)
    away = [[apart(machine, joint, found[joint], posture[joint]) for joint in stated] for found in turned]
    best = 0 if max(away[0]) <= max(away[1]) else 1
    beyond = any(distance > WITHIN for joint, distance in zip(stated, away[best], strict=True) if turns(machine, joint))
    near, far = max(away[best]), max(away[1 - best])
    stands = [said_posture(machine, {joint: found[joint] for joint in stated}) for found in turned]
    if near > NEAR * far or beyond:
        raise ImpossibleError(f"the posture of '{loop.name}' is not near one of the two ways to assemble it: at {at} "
                              f"stands {' or '.join(stands)}", "state the one that the machine has", where)
    return ways[best], Branch(loop.name, stated[int(np.argmax(away[best]))], near, far, stands[best])


def _refuse_posture(closure: Closure, posture: Mapping[str, float]) -> None:
    """Refuse a posture that names joints which its loop does not move, or too few."""
    loop = next(each for each in closure.statements if isinstance(each, Loop))
    where, known = f"{place(loop)}.posture", {*closure.follows, *closure.joints}
    for joint in posture:
        if joint not in known:
            raise ImpossibleError(f"the posture of '{loop.name}' names '{joint}', which its loop does not move",
                                  f"use {', '.join(sorted(known))}", where)
    missing = [joint for joint in closure.follows if joint not in posture]
    together = isinstance(closure, GeneralClosure)
    unstated = [joint for joint in closure.joints if joint not in posture]
    if missing or (unstated if together else len(unstated) == len(closure.joints)):
        wanted = " and ".join(unstated) if together else " or ".join(closure.joints)
        said = ", ".join(missing) or f"where {wanted} stand{'s' * (not together)} then"
        raise ImpossibleError(f"the posture of '{loop.name}' does not state {said}",
                              "state one posture: the joints that the loop follows, and about where "
                              + ("its dependent ones stand" if together else "a dependent one stands"), where)
