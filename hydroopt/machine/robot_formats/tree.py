"""A robot as its file describes it: links and joints that are one tree, and points that close loops. All in SI."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple

import numpy as np

from hydroopt.errors import MachineError
from hydroopt.spatial.inertia import Array
from hydroopt.support.input_file import similar

Kind = Literal["revolute", "prismatic", "fixed"]


class Mimic(NamedTuple):
    """A joint stands at `ratio` · position of the `master` + `offset` [rad or m]."""

    master: str
    ratio: float
    offset: float


class Spring(NamedTuple):
    """A spring about or along a joint: stiffness [N·m/rad or N/m], and the position where it is slack."""

    stiffness: float
    reference: float


@dataclass(frozen=True)
class TreeJoint:
    """A joint between two links. At the position zero the child's frame is `origin`; it moves along or about `axis`.

    Attributes:
        origin: frame (4, 4) in the parent link's frame.
        axis: unit vector (3,) in that frame, and so in the child's.
        lower, upper, max_speed, max_effort: limits [SI], None where the file states none; `endless` where it turns
            without end.
        viscous, coulomb: friction; zero where the file states none.
        gear, rotor_inertia: of its motor, the latter on the motor's side [kg·m² or kg].
        driven: whether a motor is there to move it.
    """

    name: str
    kind: Kind
    parent: str
    child: str
    origin: Array
    axis: Array = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    lower: float | None = None
    upper: float | None = None
    endless: bool = False
    max_speed: float | None = None
    max_effort: float | None = None
    viscous: float = 0.0
    coulomb: float = 0.0
    gear: float = 1.0
    rotor_inertia: float = 0.0
    spring: Spring | None = None
    driven: bool = True
    mimic: Mimic | None = None


class TreePin(NamedTuple):
    """Two points (3,) [m], each in the frame of a link, that are one, or that a rod of a `length` [m] keeps apart."""

    name: str
    links: tuple[str, str]
    points: tuple[Array, Array]
    length: float | None = None


class RobotTree(NamedTuple):
    """A robot file.

    Attributes:
        file: its name, for errors.
        name: the robot's.
        root: the link that nothing carries.
        masses: pseudo-inertia (4, 4) of each link in its frame; None where the file states no body.
        joints: by name, parents first.
        before: the joint before each link but the root.
        pins: what closes loops.
        posture: positions of joints by name at which the loops are closed.
        lost: what the file says and a machine file cannot, in sentences.
        gravity: [m/s²], None where the format does not state it.
    """

    file: str
    name: str
    root: str
    masses: dict[str, Array | None]
    joints: dict[str, TreeJoint]
    before: dict[str, TreeJoint]
    pins: tuple[TreePin, ...] = ()
    posture: dict[str, float] = {}  # noqa: RUF012 (no default of a class, and never written)
    lost: tuple[str, ...] = ()
    gravity: float | None = None

    def way(self, link: str) -> list[TreeJoint]:
        """Joints from a link down to the root."""
        found: list[TreeJoint] = []
        while link != self.root:
            found.append(self.before[link])
            link = found[-1].parent
        return found


def renamed(tree: RobotTree, links: Mapping[str, str]) -> RobotTree:
    """The tree with other names of some links."""
    joints = {name: replace(joint, parent=links.get(joint.parent, joint.parent), child=links.get(
        joint.child, joint.child)) for name, joint in tree.joints.items()}
    return tree._replace(root=links.get(tree.root, tree.root), joints=joints,
                         masses={links.get(link, link): mass for link, mass in tree.masses.items()},
                         before={joint.child: joint for joint in joints.values()})


def one_tree(file: str, name: str, masses: dict[str, Array | None], joints: Iterable[TreeJoint],
             lost: tuple[str, ...] = ()) -> RobotTree:
    """Links and joints, found to be one tree.

    Raises:
        MachineError: there are no joints, or they make no tree.
    """
    named = {joint.name: joint for joint in joints}
    if not named:
        raise MachineError("it has no joints", where=file, remedy="add a moving joint")
    before: dict[str, TreeJoint] = {}
    carried: dict[str, list[TreeJoint]] = {link: [] for link in masses}
    for joint in named.values():
        where = f"{file}: joint '{joint.name}'"
        if joint.child in before:
            raise MachineError(f"its child link '{joint.child}' is attached to '{before[joint.child].name}' already",
                               where=where, remedy="remove one of the two")
        before[joint.child] = joint
        carried[joint.parent].append(joint)
        _refuse_mimic(joint, named, where)
    roots = [link for link in masses if link not in before]
    if len(roots) > 1:
        raise MachineError(f"the links {', '.join(roots[:6])} all hang on no joint", where=file,
                           remedy="connect all but one of them, the root, by joints")
    reached = roots[:]
    for link in reached:  # grows as it goes
        reached += [joint.child for joint in carried[link]]
    if circle := masses.keys() - reached:
        raise MachineError(f"the links {', '.join(sorted(circle)[:6])} hang on each other in a circle", where=file,
                           remedy="remove one of their joints")
    return RobotTree(file, name, roots[0], masses, {before[link].name: before[link] for link in reached[1:]}, before,
                     lost=lost)


def _refuse_mimic(joint: TreeJoint, joints: dict[str, TreeJoint], where: str) -> None:
    """Refuse a joint that mimics none, or at last itself."""
    seen = [joint.name]
    while (mimic := joints[seen[-1]].mimic) is not None:
        if mimic.master not in joints:
            raise MachineError(f"it mimics '{mimic.master}', which is not a joint", where=where,
                               remedy=f"use {like(mimic.master, joints)}")
        if mimic.master in seen:
            raise MachineError(f"it mimics '{joint.mimic.master if joint.mimic else ''}', and at last itself",
                               where=where, remedy="let one of these joints move by itself")
        seen.append(mimic.master)


def like(name: str, known: Iterable[str]) -> str:
    """Known names that resemble one, or the first ones, in words."""
    return " or ".join(similar(name, known, 4))
