"""The other way in which a loop can be assembled, and whether the machine would fit so, too."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import casadi as ca
import numpy as np

from hydroopt.machine import cylinder_checks, loop_checks
from hydroopt.machine.closures import DyadClosure, SliderClosure
from hydroopt.machine.geometry import Geometry
from hydroopt.machine.machine import Machine
from hydroopt.machine.mechanism import Mechanism
from hydroopt.machine.posture import said_posture
from hydroopt.machine.quantity import ImpossibleError


class OtherWay(NamedTuple):
    """A loop that closes in two ways.

    Attributes:
        loop: its name.
        at: positions of the joints that it follows, in its stated posture, in words.
        own, other: where its dependent joints stand then, as it is assembled and the other way, in words.
        posture: the posture that states the other way.
        broken: why the machine cannot be assembled the other way; empty if it can.
        arms: least and greatest lever arm [m] by name of the cylinders to which it makes a difference, if it can.
    """

    loop: str
    at: str
    own: str
    other: str
    posture: dict[str, float]
    broken: str
    arms: dict[str, tuple[float, float]]

    def __str__(self) -> str:
        here = f"assembled with {self.own} at {self.at}"
        if self.broken:
            return f"{here}; the other way does not fit"
        arms = ", ".join(f"{name} from {low:.3f} to {high:.3f} m" for name, (low, high) in self.arms.items())
        return (f"{here}; the other way, {self.other}, fits as well" + f" (lever arm of {arms})" * bool(arms)
                + ": compare the posture with the machine")


def other_ways(machine: Machine) -> tuple[OtherWay, ...]:
    """Every loop with a closed form, and what becomes of the machine where it is assembled the other way.

    >>> from hydroopt.machine.machine_file import load_machine
    >>> way, = other_ways(load_machine("patu655"))
    >>> print(f"at {way.at}: {way.own}, or {way.other}")
    at tilt = -45.0 deg: rocker = 109.3 deg, coupler = -130.9 deg, or rocker = -28.4 deg, coupler = 130.9 deg
    """
    return tuple(_made(machine, *each) for each in _both(machine))


def remedy(machine: Machine) -> str:
    """What to do where a machine is refused, but fits with a loop assembled the other way; empty if none does."""
    try:
        for name, follows, (own, other) in _both(machine):
            turned = _turned(machine, name, follows | other)
            if not _broken(turned):
                joint = next(iter(own))
                return (f"correct the posture of '{name}': the other way to assemble it, with "
                        f"{said_posture(machine, {joint: other[joint]})} at {said_posture(machine, follows)}, fits; or "
                        "dead length, stroke, pins or limits")
    except ImpossibleError:
        pass
    return ""


def _both(machine: Machine) -> Iterator[tuple[str, dict[str, float], tuple[dict[str, float], dict[str, float]]]]:
    """Name of each loop with a closed form, the posture that it follows, and where its joints stand both ways."""
    mechanism, geometry = Mechanism(machine), Geometry(machine)
    for assembly in mechanism.assemblies:
        closure = assembly.closure
        if isinstance(closure, DyadClosure | SliderClosure):
            stated = mechanism.posture(closure)
            follows = {joint: stated[joint] for joint in closure.follows}
            at = mechanism.positions(geometry, {joint: ca.DM(value) for joint, value in follows.items()})
            own, other = ({joint: float(value) for joint, value in way.solved(geometry, at).positions.items()}
                          for way in (assembly, assembly._replace(branch=-assembly.branch)))  # type: ignore[attr-defined]
            yield closure.loop.name, follows, (own, other)


def _turned(machine: Machine, name: str, posture: dict[str, float]) -> Machine:
    """The machine with one loop assembled as a posture says."""
    return machine.model_copy(update={"loops": tuple(
        loop.model_copy(update={"posture": posture}) if loop.name == name else loop for loop in machine.loops)})


def _broken(machine: Machine) -> str:
    try:
        loop_checks.check(machine)
        cylinder_checks.check(machine)
    except ImpossibleError as error:
        return error.what
    return ""


def _made(machine: Machine, name: str, follows: dict[str, float],
          ways: tuple[dict[str, float], dict[str, float]]) -> OtherWay:
    own, other = ways
    turned = _turned(machine, name, follows | other)
    broken, arms = _broken(turned), {}
    if not broken:
        for cylinder in machine.cylinders:
            here, there = (cylinder_checks.over_range(Geometry(each), cylinder).arms for each in (machine, turned))
            if not np.allclose(here, there, rtol=0, atol=1e-6):
                arms[cylinder.name] = (float(np.abs(there).min()), float(np.abs(there).max()))
    return OtherWay(name, said_posture(machine, follows), said_posture(machine, own), said_posture(machine, other),
                    follows | other, broken, arms)
