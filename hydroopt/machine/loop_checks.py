"""Whether the loops of a machine close over the whole range of its joints, and stay clear of their dead points."""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca
import numpy as np

from hydroopt.machine.assembly import Assembly
from hydroopt.machine.closures import DyadClosure, closures, place, said
from hydroopt.machine.geometry import Geometry
from hydroopt.machine.loops import Loop
from hydroopt.machine.machine import Machine
from hydroopt.machine.mechanism import Mechanism
from hydroopt.machine.posture import said_posture
from hydroopt.machine.quantity import ImpossibleError
from hydroopt.spatial.inertia import Array

POINTS = {1: 721, 2: 61}
FEW = 15
"""Points of each joint's range where a loop follows one or two joints, and where it follows more."""
FLAT = np.radians(1.0)
"""Angle [rad] between the bars of a loop, or between them stretched, below which it is at a dead point."""
PLANAR = 1e-9
"""Length [m], and part of a unit vector, that counts as out of a loop's plane."""


class LoopRange(NamedTuple):
    """A loop, or several that close together, over the ranges of the joints that they follow.

    Attributes:
        assembly: the loop as it is assembled.
        angle: least angle [rad] in the range between its bars, or by which they miss a straight line: its margin to a
            dead point, in general that of `Solved.sine`. Not a number where the loop cannot close.
        at: where this is, in words.
        posture: positions by name of the joints that it follows, where this is.
        ratios: least and greatest speed of each dependent joint per speed of the last joint that it follows.
    """

    assembly: Assembly
    angle: float
    at: str
    posture: dict[str, float]
    ratios: dict[str, tuple[float, float]]


def loop_ranges(machine: Machine) -> tuple[LoopRange, ...]:
    """Every loop of a machine with its margin to the nearest dead point.

    >>> from hydroopt.machine.machine_file import load_machine
    >>> loop_ranges(load_machine("cat215b"))
    ()
    """
    mechanism, geometry, found = Mechanism(machine), Geometry(machine), []
    for assembly in mechanism.assemblies:
        closure = assembly.closure
        joints = closure.follows
        q = ca.SX.sym("q", len(joints))
        at = mechanism.positions(geometry, {joint: q[i] for i, joint in enumerate(joints)})
        sine = assembly.solved(geometry, at).sine
        if sine is None:
            continue
        function = ca.Function("margin", [q], [sine, *(ca.jacobian(at[joint], q[-1]) for joint in closure.joints)])
        points = POINTS.get(len(joints), FEW)
        grid = np.meshgrid(*(np.linspace(*machine.link(joint).joint.range, points) for joint in joints), indexing="ij")
        states = np.stack([values.ravel() for values in grid])
        sines, *slopes = (np.asarray(values).ravel() for values in function(states))
        # where the branch changes its sign the loop passes a dead point
        signed = sines * np.sign(sines[np.argmax(np.isfinite(sines))])
        worst = int(np.argmin(np.where(np.isfinite(signed), signed, -2.0)))
        posture = dict(zip(joints, states[:, worst].tolist(), strict=True))
        found.append(LoopRange(assembly, float(np.arcsin(min(signed[worst], 1.0))), said_posture(machine, posture),
                               posture, {joint: (float(np.min(slope)), float(np.max(slope)))
                                         for joint, slope in zip(closure.joints, slopes, strict=True)}))
    return tuple(found)


def check(machine: Machine) -> None:
    """Check every loop over the ranges of the joints that it follows, on a grid.

    A loop that closes by a pin must be planar. All must close everywhere, and keep away from dead points, where their
    bars lie in one line.

    Raises:
        ImpossibleError: names the loop, the posture and the remedy.
    """
    geometry = Geometry(machine)
    for closure in closures(machine.links, machine.loops, machine.couplings):
        for statement in closure.statements:
            if isinstance(statement, Loop) and statement.closed_by == "pin":
                _planar(geometry, statement, alike=isinstance(closure, DyadClosure))
    mechanism = Mechanism(machine)
    for each in loop_ranges(machine):
        closure = each.assembly.closure
        if not np.isfinite(each.angle):
            why = each.assembly.why_open(geometry, mechanism.positions(geometry, _numbers(each.posture)))
            raise ImpossibleError(f"{said(closure)} cannot close at {each.at}: {why}",
                                  "correct its pins and lengths, or narrow the joints' limits",
                                  place(closure.statements[0]))
        if each.angle < FLAT:
            raise ImpossibleError(f"{said(closure)} would have a dead point at {each.at}, where {each.assembly.dead}",
                                  "correct its pins and lengths, or narrow the joints' limits",
                                  place(closure.statements[0]))


def _numbers(q: dict[str, float]) -> dict[str, ca.DM]:
    return {joint: ca.DM(value) for joint, value in q.items()}


def _planar(geometry: Geometry, loop: Loop, *, alike: bool) -> None:
    """Refuse a loop in space, which shows wherever its joints stand; those of a dyad turn `alike`, to the same side."""
    machine, where = geometry.machine, f"loops[{loop.name}]"
    joints = machine.joints_between(loop.link, loop.to.link)
    turning = [joint for joint in joints if machine.link(joint).joint.type == "revolute"]
    if not turning:
        raise ImpossibleError(f"no joint of the loop '{loop.name}' turns, but it closes on a pin",
                              "close it over a joint that turns", where)
    first = next((joint for joint in turning if machine.link(joint).joint.dependent), turning[0])
    for joint in joints:
        axis: Array = np.asarray(geometry.from_seat(first, joint, {}).rotation)[:, 2]
        if joint not in turning:
            if abs(axis[2]) > PLANAR:
                raise ImpossibleError(f"the joint '{joint}' in the loop '{loop.name}' slides out of the plane in which "
                                      f"'{first}' turns, but a pin closes planar loops only",
                                      "let it slide across the axes of the others", where)
        elif abs((axis[2] if alike else abs(axis[2])) - 1) > PLANAR:
            raise ImpossibleError(f"the axes of '{first}' and '{joint}' in the loop '{loop.name}' do not point the "
                                  "same way, but a pin closes planar loops only",
                                  "make them parallel, to the same side; behind a link with an alpha or beta a locked "
                                  "link carries the pins", where)
    own, target = geometry.loop_ends(loop)
    ends = [geometry.from_seat(first, link, {}).point(end) for link, end in ((loop.link, own), (loop.to.link, target))]
    aside = float(ends[1][2] - ends[0][2])
    if abs(aside) > PLANAR:
        raise ImpossibleError(f"the pins at which the loop '{loop.name}' closes are {1e3 * abs(aside):.4g} mm apart "
                              "along its axes", "let the pin's z, or a joint's d, close this gap", f"{where}.to.pin")
