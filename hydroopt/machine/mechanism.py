"""From the independent joints q to all joints of the tree: loops and couplings, each as the machine is assembled."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from hydroopt.machine.closures import Closure, closures
from hydroopt.machine.general_loops import WITHIN, GeneralAssembly, apart, assembled
from hydroopt.machine.geometry import Geometry
from hydroopt.machine.loops import Loop
from hydroopt.machine.machine import Machine
from hydroopt.machine.planar_loops import PlanarAssembly
from hydroopt.machine.quantity import ImpossibleError

Assembly = PlanarAssembly | GeneralAssembly
NEAR = 0.5
"""A posture tells how a loop is assembled if it is nearer to one of the two ways than this part of the distance to the
other, and than `WITHIN`."""


class Ways(NamedTuple):
    """Both ways to assemble a planar loop where the joints that it follows stand as its posture states.

    Attributes:
        loop: its name.
        follows: positions [rad or m] of these joints.
        own, other: those of its dependent joints in the way that is taken, and in the other one.
        stated: its dependent joints that the posture states, the one farthest from where it stands first.
        near, far: greatest distances [rad, or m of a joint that slides] of their stated positions from both ways.
    """

    loop: str
    follows: dict[str, float]
    own: dict[str, float]
    other: dict[str, float]
    stated: tuple[str, ...]
    near: float
    far: float


class Mechanism:
    """The loops and couplings of a machine, each with the way in which it is assembled.

    Args:
        at: positions [rad or m] of all joints by name that tell how loops are assembled; their own postures by default.

    Attributes:
        assemblies: in the order of `hydroopt.machine.closures.closures`.
        ways: of planar loops.

    Raises:
        ImpossibleError: a posture does not tell which way a loop is assembled.

    >>> from hydroopt.machine.machine_file import load_machine
    >>> Mechanism(load_machine("cat215b")).assemblies
    ()
    >>> (found,) = Mechanism(load_machine("excavator_bucket")).ways
    >>> found.loop, found.stated, round(float(np.degrees(found.near))), round(float(np.degrees(found.far)))
    ('bucket_linkage', ('rocker',), 0, 91)
    """

    def __init__(self, machine: Machine, at: Mapping[str, float] | None = None) -> None:
        self._machine, self._at = machine, at
        self.assemblies: tuple[Assembly, ...] = ()
        self.ways: tuple[Ways, ...] = ()
        for closure in closures(machine.links, machine.loops, machine.couplings):
            if closure.linear:
                self.assemblies += (GeneralAssembly(closure),)
            elif closure.planar:
                assembly, ways = self._compared(Geometry(machine), closure)
                self.assemblies, self.ways = (*self.assemblies, assembly), (*self.ways, ways)
            else:
                self.assemblies += (self._tracked(Geometry(machine), closure),)

    def positions(self, geometry: Geometry, q: Mapping[str, Any]) -> dict[str, Any]:
        """Positions of all moving joints of the tree by name, from those of the independent ones.

        Closures that follow a joint that `q` leaves out are left out too.
        """
        found = dict(q)
        for each in self.assemblies:
            if all(joint in q for joint in each.closure.follows):
                found |= each.solved(geometry, found)[0]
        return found

    def sines(self, geometry: Geometry, q: Mapping[str, Any]) -> list[ca.SX]:
        """The sine of each closure but couplings: zero at a dead point, not a number where it cannot close.

        Closures that follow a joint that `q` leaves out are left out.
        """
        at = self.positions(geometry, q)
        found = [each.solved(geometry, at)[1] for each in self.assemblies
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

    def _posture(self, closure: Closure) -> tuple[dict[str, float], str]:
        """Positions [rad or m] of joints by name that tell how a closure is assembled, and the place of these.

        Raises:
            ImpossibleError: the stated ones name other joints, or too few.
        """
        loops = [each for each in closure.statements if isinstance(each, Loop)]
        where, known = f"{loops[0].place}.posture", (*closure.follows, *closure.joints)
        if self._at is not None:
            return {joint: self._at[joint] for joint in known}, where
        stated: dict[str, float] = {}
        for each in loops:
            for joint, value in each.posture.items():
                if stated.setdefault(joint, value) != value:
                    raise ImpossibleError(f"the loops that close together have two postures of '{joint}'",
                                          "state one posture of all of them", f"{each.place}.posture.{joint}")
        if strange := next((joint for joint in stated if joint not in known), None):
            raise ImpossibleError(f"the posture of '{loops[0].name}' names '{strange}', which its loop does not move",
                                  f"use {', '.join(sorted(known))}", where)
        missing = [joint for joint in closure.follows if joint not in stated]
        unstated = [joint for joint in closure.joints if joint not in stated]
        if missing or len(unstated) > closure.planar:
            together, word = ("a dependent one stands", " or ") if closure.planar else (
                "its dependent ones stand", " and ")
            said = ", ".join(missing) or f"where {word.join(unstated)} stand{'s' * closure.planar} then"
            raise ImpossibleError(f"the posture of '{loops[0].name}' does not state {said}",
                                  "state one posture: the joints that the loop follows, and about where " + together,
                                  where)
        return stated, where

    def _tracked(self, geometry: Geometry, closure: Closure) -> GeneralAssembly:
        """Loops that close together, by Newton's method."""
        posture, _ = self._posture(closure)
        key = (geometry.machine.model_dump_json(include={"links", "loops", "couplings"}),
               repr((closure.joints, posture)))
        if key not in _KNOWN:
            q = ca.SX.sym("q", len(closure.follows))
            at = self.positions(geometry, dict(zip(closure.follows, ca.vertsplit(q), strict=True)))
            found = assembled(geometry, closure, posture, at, q)
            while len(_KNOWN) >= REMEMBERED:
                _KNOWN.pop(next(iter(_KNOWN)))
            _KNOWN[key] = found
        return _KNOWN[key]

    def _compared(self, geometry: Geometry, closure: Closure) -> tuple[PlanarAssembly, Ways]:
        """The way of assembling a loop that comes nearer to its stated posture, and both."""
        machine, loop, made = geometry.machine, closure.statements[0], [PlanarAssembly(closure, k) for k in (1, -1)]
        posture, where = self._posture(closure)
        stated = tuple(joint for joint in closure.joints if joint in posture)
        follows = {joint: posture[joint] for joint in closure.follows}
        q, at = self.positions(geometry, {name: ca.DM(value) for name, value in follows.items()}), machine.in_words(
            follows)
        turned = [{joint: float(value) for joint, value in way.solved(geometry, q)[0].items()} for way in made]
        if not all(np.isfinite(value) for found in turned for value in found.values()):
            raise ImpossibleError(f"the loop '{loop.name}' cannot close in its own posture, {at}: "
                                  f"{made[0].why_open(geometry, q)}", "correct its pins and lengths, or the posture",
                                  where)
        away = [[apart(machine, joint, found[joint], posture[joint]) for joint in stated] for found in turned]
        best = 0 if max(away[0]) <= max(away[1]) else 1
        beyond = any(distance > WITHIN for joint, distance in zip(stated, away[best], strict=True)
                     if machine.turns(joint))
        near, far = max(away[best]), max(away[1 - best])
        if near > NEAR * far or beyond:
            stands = [machine.in_words({joint: found[joint] for joint in stated}) for found in turned]
            raise ImpossibleError(f"the posture of '{loop.name}' is not near one of the two ways to assemble it: at "
                                  f"{at} stands {' or '.join(stands)}", "state the one that the machine has", where)
        order = sorted(stated, key=lambda joint: -away[best][stated.index(joint)])
        return made[best], Ways(loop.name, follows, turned[best], turned[1 - best], tuple(order), near, far)


_KNOWN: dict[tuple[str, str], GeneralAssembly] = {}
"""What tracking has found of loops, by their links and their posture: the same machine is assembled many times."""
REMEMBERED = 64
