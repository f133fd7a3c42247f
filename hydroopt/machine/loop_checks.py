"""Whether the loops of a machine close over the whole range of its joints, and stay clear of their dead points."""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca
import numpy as np

from hydroopt.machine.geometry import Geometry
from hydroopt.machine.loops import Closure
from hydroopt.machine.machine import Machine
from hydroopt.machine.mechanism import Mechanism, bars, dyad, gap
from hydroopt.machine.quantity import ImpossibleError
from hydroopt.spatial.inertia import Array

POINTS = {1: 721, 2: 61}
"""Points of each joint's range where a loop follows one or two joints; 15 where it follows more."""
FLAT = np.radians(1.0)
"""Angle [rad] between the bars of a loop, or between them stretched, below which it is at a dead point."""
PLANAR = 1e-9
"""Length [m], and part of a unit vector, that counts as out of a loop's plane."""


class LoopRange(NamedTuple):
    """A loop over the ranges of the joints that it follows.

    Attributes:
        closure: the loop, see `Closure`.
        angle: least angle [rad] in the range between its bars, or by which they miss a straight line: its margin to a
            dead point. Not a number where the loop cannot close.
        posture: positions by name of the joints that it follows, where this is.
        ratio: least and greatest speed of the first dependent joint per speed of the last joint that it follows.
    """

    closure: Closure
    angle: float
    posture: dict[str, float]
    ratio: tuple[float, float]

    @property
    def at(self) -> str:
        """The posture in words."""
        return ", ".join(f"{joint} = {np.degrees(value):.1f} deg" for joint, value in self.posture.items())


def loop_ranges(machine: Machine) -> tuple[LoopRange, ...]:
    """Every loop of a machine with its margin to the nearest dead point.

    >>> from hydroopt.machine.machine_file import load_machine
    >>> loop_ranges(load_machine("cat215b"))
    ()
    """
    mechanism, geometry, found = Mechanism(machine), Geometry(machine), []
    for k, closure in enumerate(mechanism.closures):
        joints = closure.follows
        q = ca.SX.sym("q", len(joints))
        at = mechanism.positions(geometry, {joint: q[i] for i, joint in enumerate(joints)})
        made = dyad(geometry, closure, at)
        sine = bars(made, mechanism.branches[k]).sine(made)
        function = ca.Function("margin", [q], [sine, ca.jacobian(at[closure.first], q[-1])])
        points = POINTS.get(len(joints), 15)
        grid = np.meshgrid(*(np.linspace(*machine.link(joint).joint.range, points) for joint in joints), indexing="ij")
        states = np.stack([values.ravel() for values in grid])
        sines, ratios = (np.asarray(values).ravel() for values in function(states))
        sines = np.abs(sines)
        worst = int(np.argmin(np.where(np.isfinite(sines), sines, -1.0)))
        angle = float(np.arcsin(min(sines[worst], 1.0)))
        found.append(LoopRange(closure, angle, dict(zip(joints, states[:, worst].tolist(), strict=True)),
                               (float(np.min(ratios)), float(np.max(ratios)))))
    return tuple(found)


def check(machine: Machine) -> None:
    """Check every loop over the ranges of the joints that it follows, on a grid.

    It must be planar, close everywhere, and keep away from dead points, where its bars lie in one line.

    Raises:
        ImpossibleError: names the loop, the posture and the remedy.
    """
    if not machine.loops:
        return
    geometry, mechanism = Geometry(machine), Mechanism(machine)
    for closure in mechanism.closures:
        _planar(geometry, mechanism, closure)
    for each in loop_ranges(machine):
        loop = each.closure.loop
        if not np.isfinite(each.angle):
            made = dyad(geometry, each.closure, mechanism.positions(geometry, _numbers(each.posture)))
            raise ImpossibleError(f"the loop '{loop.name}' cannot close at {each.at}: {gap(made)}",
                                  "correct its pins and lengths, or narrow the joints' limits", f"loops[{loop.name}]")
        if each.angle < FLAT:
            raise ImpossibleError(f"the loop '{loop.name}' has a dead point at {each.at}, where "
                                  f"'{each.closure.first}' and '{each.closure.second}' lie in one line",
                                  "correct its pins and lengths, or narrow the joints' limits", f"loops[{loop.name}]")


def _numbers(q: dict[str, float]) -> dict[str, ca.DM]:
    return {joint: ca.DM(value) for joint, value in q.items()}


def _planar(geometry: Geometry, mechanism: Mechanism, closure: Closure) -> None:
    machine, loop, first = geometry.machine, closure.loop, closure.first
    middle = {joint: sum(machine.link(joint).joint.range) / 2 for joint in machine.joints}
    q = mechanism.positions(geometry, _numbers(middle))
    for joint in machine.joints_between(loop.link, loop.to.link):
        kind = machine.link(joint).joint.type
        if kind != "revolute":
            raise ImpossibleError(f"the {kind} joint '{joint}' lies in the loop '{loop.name}', which has pins only",
                                  "close the loop over revolute joints", f"loops[{loop.name}]")
        axis: Array = np.asarray(geometry.from_seat(first, joint, q).rotation)[:, 2]
        if abs(axis[2] - 1) > PLANAR:
            raise ImpossibleError(f"the axes of '{first}' and '{joint}' in the loop '{loop.name}' do not point the "
                                  "same way, but a pin closes planar loops only",
                                  "make them parallel and let both turn to the same side", f"loops[{loop.name}]")
    ends = [geometry.from_seat(first, loop.link, q).point(geometry.far_end(loop.link).origin),
            geometry.from_seat(first, loop.to.link, q).point(geometry.point(loop.name))]
    aside = float(ends[1][2] - ends[0][2])
    if abs(aside) > PLANAR:
        raise ImpossibleError(f"the pins at which the loop '{loop.name}' closes are {1e3 * abs(aside):.4g} mm apart "
                              "along its axes", "let the pin's z, or a joint's d, close this gap",
                              f"loops[{loop.name}].to.pin")
