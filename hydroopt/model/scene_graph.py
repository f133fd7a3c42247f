"""A machine in space: its bodies as a tree of joints, the pins between them, and the program that closes its loops."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any, Literal, NamedTuple

import casadi as ca
import numpy as np

from hydroopt.kernels.c_writer import Naming, statements
from hydroopt.kernels.expression_graph import program
from hydroopt.machine.actuators import Cylinder, GasCylinder, Pinned
from hydroopt.machine.geometry import Geometry
from hydroopt.machine.machine import BASE, Machine
from hydroopt.machine.mechanism import Mechanism
from hydroopt.spatial import inertia
from hydroopt.spatial.convex_hull import corners
from hydroopt.spatial.evenly_spread import halton
from hydroopt.spatial.inertia import Array
from hydroopt.spatial.poses import roll_pitch_yaw

Point = tuple[str, tuple[float, float, float]]
"""A body's name, and coordinates (3,) [m] in its frame."""

POSTURES = 60
"""Postures over which the travel of dependent slides is found."""
CARRIED = 0.05
"""A slide whose centre of mass lies further back than this part of its travel is a section that moves in the link
before; any other one runs on a rail of that link."""
OVERLAP = 1.1
"""Length of such a section over its travel."""
BROAD, LONG = 0.5, 1e-6
"""A link whose joint and far end are nearer to each other than `LONG` [m] is an area if its points spread over more
than `BROAD` of their length across it."""
JAVASCRIPT = {"fabs": "Math.abs", "fmin": "Math.min", "fmax": "Math.max"}
"""Operations whose names in JavaScript are not those in C."""


class SceneBody(NamedTuple):
    """A link: `seat` (4, 4) is its frame P_i where its joint stands at zero, in its parent's frame.

    The joint moves it about or along the z axis of P_i by the entry `column` of the tree's joints, None if locked.
    `points` (k, 3) [m] are what the link joins, in P_i, with the ends of rails that it carries, and `far` (3,) is its
    far end, one of them; `section` (2, 3) [m] is the part of a telescope that moves in the link before, None elsewhere.
    `com` (3,) is its centre of mass, None without a body, and among the points of a link that joins nothing else.
    """

    name: str
    parent: str
    seat: Array
    joint: Literal["revolute", "prismatic", "locked"]
    column: int | None
    points: Array
    far: Array
    com: Array | None
    section: Array | None = None

    @property
    def lines(self) -> Array:
        """What it is as lines (k, 2, 3) [m] in P_i, beside its `section`: from its joint to its far end.

        Where these are in one place, it is that section alone, or a line to the point farthest away, or one all around
        a platform. Brackets beside a line are left out.
        """
        if self.section is not None and np.linalg.norm(self.far) <= LONG:
            return np.zeros((0, 2, 3))
        if np.linalg.norm(self.far) > LONG:
            return np.array([[np.zeros(3), self.far]])
        about = self.points - self.points.mean(axis=0)
        axes = np.linalg.svd(about, full_matrices=False)[2]
        along, across = np.ptp(about @ axes[:2].T, axis=0) if len(about) > 2 else (0.0, 0.0)
        if across > BROAD * along:
            rim = self.points[corners(about @ axes[:2].T)]
            return np.stack([rim, np.roll(rim, -1, axis=0)], axis=1)
        farthest = self.points[np.argmax(np.linalg.norm(self.points, axis=1))]
        return np.array([[np.zeros(3), farthest]])


class Strut(NamedTuple):
    """A part between two pins: a cylinder, a gas cylinder, a spring, or the rod of a loop.

    `body` is the length of a barrel and `diameter` its outer one [m].
    """

    name: str
    kind: Literal["cylinder", "gas", "spring", "rod"]
    start: Point
    end: Point
    body: float
    diameter: float


class Closing(NamedTuple):
    """A pin or ball of a loop, as a point of either body that it joins."""

    name: str
    one: Point
    other: Point


class SceneGraph:
    """The bodies of a machine and how they move together.

    Args:
        machine: the machine.
        calibrator: whether the links of its calibrator are bodies, too; their joints follow those of the tree.
        geometry: numbers [SI] by name that replace those of the machine file.

    >>> from hydroopt.machine.machine_file import load_machine
    >>> scene = SceneGraph(load_machine("cat215b"))
    >>> [body.name for body in scene.bodies], [strut.name for strut in scene.struts]
    (['swing', 'boom', 'stick'], ['boom_cylinder', 'stick_cylinder'])
    """

    def __init__(self, machine: Machine, *, calibrator: bool = False,
                 geometry: Mapping[str, float] | None = None) -> None:
        self.machine, self.geometry = machine, Geometry(machine, geometry)
        own = len(machine.links)
        self._links = self.geometry.links if calibrator else self.geometry.links[:own]
        self._carried = calibrator and machine.calibrator is not None
        self.columns = (*machine.tree_joints, *(link.name for link in self._links[own:] if link.joint.moving))

    @cached_property
    def base(self) -> Array:
        """Rotation (3, 3) of the base frame in a world whose z points up."""
        return np.asarray(roll_pitch_yaw(self.machine.orientation))

    @cached_property
    def struts(self) -> tuple[Strut, ...]:
        """Cylinders, springs and rods of loops."""
        rods = tuple(Strut(loop.name, "rod", *self._ends(loop.name), 0.0, 0.05)
                     for loop in self.machine.loops if loop.closed_by == "rod")
        return (*(_strut(each) for each in self.machine.pinned), *rods)

    @cached_property
    def closings(self) -> tuple[Closing, ...]:
        """Pins and balls that close loops."""
        return tuple(Closing(loop.name, *self._ends(loop.name)) for loop in self.machine.loops
                     if loop.closed_by != "rod")

    def _ends(self, name: str) -> tuple[Point, Point]:
        loop = next(each for each in self.machine.loops if each.name == name)
        own, other = self.geometry.loop_ends(loop)
        return (loop.link, _point(own)), (loop.to.link, _point(other))

    @cached_property
    def bodies(self) -> tuple[SceneBody, ...]:
        """All links, each after its parent."""
        seats = {link.name: (self.geometry.seat(link.name) @ self.geometry.joint(link.name, 0.0)).matrix()
                 for link in self._links}
        joined: dict[str, list[Sequence[float]]] = {BASE: [], **{link.name: [(0.0, 0.0, 0.0)] for link in self._links}}
        ends = [point for strut in self.struts for point in (strut.start, strut.end)]
        ends += [point for closing in self.closings for point in (closing.one, closing.other)]
        for body, point in ends:
            joined[body].append(point)
        joined[self.tip[0]].append(self.tip[1])
        for link in self._links:
            joined[link.name].append(_point(self.geometry.far_end(link.name).origin))
            joined[link.parent] += [seats[link.name][:3, 3].tolist(),
                                    _point(self.geometry.seat(link.name).origin)]
        centres = {link.name: inertia.centre_of_mass(link.body.phi) for link in self._links if link.body is not None}
        sections: dict[str, Array] = {}
        pinned = {body for body, _ in ends} | {self.tip[0], *centres}
        for link in self._links:
            if link.joint.type == "prismatic" and (link.name in pinned or np.any(joined[link.name])):
                lower, upper = self._travel[link.name]
                centre = centres.get(link.name)
                if centre is not None and centre[2] < -CARRIED * (upper - lower):
                    sections[link.name] = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -OVERLAP * (upper - lower)]])
                else:
                    joined[link.parent] += [(seats[link.name] @ [0.0, 0.0, at, 1.0])[:3].tolist()
                                            for at in (lower, upper)]
        self._on_base = np.array(joined[BASE]).reshape(-1, 3)
        fixed = {link.parent for link in self._links if not link.joint.moving and np.any(joined[link.name])}
        for name, centre in centres.items():
            if centre is not None and not np.any(joined[name]) and name not in fixed:  # as a robot's last link
                joined[name].append(centre.tolist())
        return tuple(SceneBody(
            link.name, link.parent, seats[link.name], link.joint.type,
            self.columns.index(link.name) if link.joint.moving else None,
            np.unique(np.round(joined[link.name], 9), axis=0),
            np.array(_point(self.geometry.far_end(link.name).origin)), centres.get(link.name), sections.get(link.name))
            for link in self._links)

    @cached_property
    def _travel(self) -> dict[str, tuple[float, float]]:
        """Least and greatest position of each joint; of dependent ones over even postures of the others."""
        found = {link.name: link.joint.range for link in self._links if link.joint.independent}
        if dependent := [joint for joint in self.machine.tree_joints if joint not in found]:
            ranges = np.array([found[joint] for joint in self.machine.joints])
            share = np.vstack([np.zeros(len(ranges)), np.ones(len(ranges)), halton(len(ranges), POSTURES)])
            tree = self.tree_positions(ranges[:, 0] + share * np.ptp(ranges, axis=1))
            tree = tree[np.all(np.isfinite(tree), axis=1)]
            for joint in dependent if len(tree) else ():
                at = tree[:, self.columns.index(joint)]
                found[joint] = (float(np.min(at)), float(np.max(at)))
        return {joint: found.get(joint, (0.0, 0.0)) for joint in self.columns}

    @property
    def tip(self) -> Point:
        """The far end of the machine's last link, or the tip of its calibrator."""
        if self._carried:
            last = self.machine.chain[-1].name
            return last, _point(self.geometry.far_end(last).point(self.geometry.point("tip")))
        return self.machine.tip, _point(self.geometry.far_end(self.machine.tip).origin)

    @property
    def on_base(self) -> Array:
        """Points (k, 3) [m] of the base frame that it joins."""
        _ = self.bodies
        return self._on_base

    @cached_property
    def closure(self) -> ca.Function:
        """q (n,) → positions (t,) of all joints of the tree; not a number where a loop cannot close."""
        q = ca.SX.sym("q", len(self.machine.joints))
        at = Mechanism(self.machine).positions(
            self.geometry, dict(zip(self.machine.joints, ca.vertsplit(q), strict=True)))
        tree = ca.vertcat(*(at[joint] for joint in self.machine.tree_joints))
        return ca.Function("closure", [q], [ca.densify(tree)], ["q"], ["tree"])

    @cached_property
    def closure_script(self) -> str:
        """`closure` as the body of a JavaScript function of `q` that fills the array `tree`."""
        naming = Naming(source=lambda _, k: f"q[{k}]", target=lambda _, k: f"tree[{k}] = {{}};", type="",
                        call=lambda name: JAVASCRIPT.get(name, f"Math.{name}"))
        return "\n".join(statements(program(self.closure), naming)).replace("const  ", "const ")

    def tree_positions(self, q: Array) -> Array:
        """Positions (N, t) of all joints of the tree at joint positions (N, n)."""
        return np.asarray(self.closure.map(len(q))(q.T)).T

    def poses(self, tree: Mapping[str, float]) -> dict[str, Array]:
        """Pose in the world (4, 4) of every body at the positions [rad or m] of the tree's joints by name."""
        base = np.eye(4)
        base[:3, :3] = self.base
        found = {BASE: base}
        for body in self.bodies:
            moved, at = np.eye(4), tree.get(body.name, 0.0)
            if body.joint == "revolute":
                moved[:2, :2] = [[np.cos(at), -np.sin(at)], [np.sin(at), np.cos(at)]]
            else:
                moved[2, 3] = at
            found[body.name] = found[body.parent] @ body.seat @ moved
        return found


def _point(value: Any) -> tuple[float, float, float]:
    x, y, z = np.asarray(ca.DM(value)).ravel().tolist()
    return x, y, z


def _strut(part: Pinned) -> Strut:
    start, end = (part.barrel.link, part.barrel.pin), (part.rod.link, part.rod.pin)
    if isinstance(part, Cylinder):
        bore = 2 * np.sqrt(part.areas[0] / part.jacks / np.pi)
        # a barrel is a little shorter than the retracted cylinder
        return Strut(part.name, "cylinder", start, end, 0.9 * part.dead_length, float(bore))
    if isinstance(part, GasCylinder):  # a length of reference is known, no bore
        return Strut(part.name, "gas", start, end, 0.6 * part.reference_length, 0.06)
    return Strut(part.name, "spring", start, end, 0.0, 0.06)
