"""URDF files to `Machine`: the joint axes of a URDF in modified Denavit-Hartenberg numbers (Eq. 3.8).

A pose is a homogeneous matrix (4, 4). What moves with a joint is described in the *joint's frame*: the URDF joint's
frame, moved along with the joint and turned so that its z is the axis.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Literal, NamedTuple
from xml.etree import ElementTree

import numpy as np

from hydroopt.errors import MachineError
from hydroopt.input_file import JSON_LIMIT, read_text, similar
from hydroopt.machine.actuators import Drive
from hydroopt.machine.links import Body, Joint, Link
from hydroopt.machine.machine import BASE, Machine
from hydroopt.spatial import inertia
from hydroopt.spatial.inertia import Array

_NEARLY_PARALLEL = math.sin(math.radians(2))
_LARGEST = 1e9
_NO = (0.0, 0.0, 0.0)
_NONE = ""  # stands for the joint that carries the root; a URDF joint may well be called "base"
_TYPES: dict[str, Literal["revolute", "prismatic"]] = {
    "revolute": "revolute", "continuous": "revolute", "prismatic": "prismatic"}


class _Joint(NamedTuple):
    """A URDF joint: `origin` in the parent link, unit `axis` (3,), limits and velocity in SI, and what it mimics."""

    name: str
    type: str
    parent: str
    child: str
    origin: Array
    axis: Array
    lower: float | None
    upper: float | None
    velocity: float | None
    master: str | None
    offset: float


class _Tree(NamedTuple):
    """Pseudo-inertias (4, 4) of the links, the joints, parents first, and the joint before each link but the root."""

    file: str
    root: str
    masses: dict[str, Array | None]
    joints: dict[str, _Joint]
    before: dict[str, _Joint]

    def way(self, link: str) -> list[_Joint]:
        """Joints from a link down to the root."""
        found: list[_Joint] = []
        while link != self.root:
            found.append(self.before[link])
            link = found[-1].parent
        return found


class _Numbers(NamedTuple):
    """Eq. 3.8 from a joint's frame at rest onwards."""

    d: float
    theta: float
    a: float = 0.0
    alpha: float = 0.0
    beta: float = 0.0

    def near_end(self) -> Array:
        """The link's frame P, in which its body stands."""
        return _pose(_turn(2, self.theta), (0, 0, self.d))

    def far_end(self) -> Array:
        return self.near_end() @ _pose(_turn(0, self.alpha) @ _turn(1, self.beta), (self.a, 0, 0))


def read_urdf(path: str | Path, *, tip: str | None = None) -> Machine:
    """Machine of a URDF file.

    The base is the URDF's root link, its z points up; a locked link leads to the first axis where that is not the
    base's z. Each moving joint becomes a link of its name (made of letters, digits and _) whose variable is the URDF
    joint's position, with a drive ``<name>_drive``. Its body is all that moves with it, links behind fixed joints
    included; it has none where the file states no <inertial>. Friction, effort and geometry are not read.

    Args:
        path: the file, in UTF-8.
        tip: the link at the end of the chain to read; the last far end lies in its origin. Joints that are not on the
            way from the root to it stand at zero, with what they carry. If None, all joints move, only the root may
            carry several moving ones, and the end is the link that most fixed joints part from the last moving one.
            A joint that mimics another one stands where it does while that is at zero.

    Raises:
        MachineError: the file is missing or no URDF, contradictory or incomplete, branches without a `tip`, or has a
            joint that mimics another one on the way to the same tip.

    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as directory:
    ...     file = Path(directory) / "arm.urdf"
    ...     _ = file.write_text('''<robot name="arm"><link name="ground"/><link name="boom"/>
    ...         <joint name="lift" type="revolute"><parent link="ground"/><child link="boom"/><axis xyz="0 0 1"/>
    ...         <limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>''')
    ...     read_urdf(file)
    Machine('arm': 1 joint, 1 drive)
    """
    file = str(path)
    robot = _xml(file)
    tree = _tree(robot, file)
    if tip is not None and tip not in tree.masses:
        raise MachineError(f"there is no link '{tip}'", where=file, remedy=f"use {_like(tip, tree.masses)}")
    on_way = tree.joints.values() if tip is None else tree.way(tip)
    moving = {joint.name for joint in on_way if joint.type != "fixed" and joint.master is None}
    if not moving:
        raise MachineError("no joint moves" + (f" between '{tree.root}' and '{tip}'" if tip else ""), where=file,
                           remedy="name a tip behind a moving joint" if tip else "add a moving joint")
    held = _held(tree, moving, tip)
    name = _named(robot.get("name") or Path(path).stem, set(), "machine")
    description = (f"from {Path(path).name}, '{tree.root}'" + (f" to '{tip}'" if tip else "")
                   + (f"; held: {', '.join(held)}" if held else ""))
    links = _links(tree, moving, tip)
    taken = {BASE, *(link.name for link in links)}
    return Machine(name=name, description=description, links=tuple(links), drives=tuple(
        Drive(name=_named(f"{link.name}_drive", taken), joint=link.name)
        for link in links if link.joint.moving))


def _held(tree: _Tree, moving: set[str], tip: str | None) -> list[str]:
    """Joints that mimic another one on the way to a moving joint or the tip: they stand still."""
    ends = [tree.joints[name].parent for name in moving] + ([tip] if tip else [])
    passed = {joint.name for end in ends for joint in tree.way(end)}
    held = [joint for joint in tree.joints.values() if joint.name in passed and joint.master is not None]
    for joint in held:
        if joint.master in moving:
            raise MachineError(f"it would have to move with '{joint.master}', which it mimics",
                               where=f"{tree.file}: joint '{joint.name}'",
                               remedy="name a tip on whose way only one of them lies, or make it fixed")
    return [joint.name for joint in held]


def _links(tree: _Tree, moving: set[str], tip: str | None) -> list[Link]:
    """The machine's links, from the base outwards."""
    poses, axes = _placed(tree, moving)
    starts, names, taken = {_NONE: np.eye(4)}, {_NONE: BASE}, {BASE}
    links: list[Link] = []
    for urdf_name, (carrier, axis) in axes.items():
        joint, where = tree.joints[urdf_name], f"{tree.file}: joint '{urdf_name}'"
        name = names[urdf_name] = _named(urdf_name, taken)
        parent, start = names[carrier], starts[carrier]
        if carrier == _NONE and any((lead := _onto(axis))[2:]):
            parent, start = _named(f"{name}_mount", taken), lead.far_end()
            links.append(Link(name=parent, parent=BASE, joint=Joint(type="locked", **lead._asdict())))
        lower, upper = (-math.pi, math.pi) if joint.type == "continuous" else (joint.lower, joint.upper)
        if lower is None or upper is None:
            raise MachineError("its limits are missing", where=where, remedy="add <limit lower=\"...\" upper=\"...\"/>")
        if lower >= upper:
            raise MachineError(f"the lower limit, {lower:g}, is not below the upper one, {upper:g}", where=where,
                               remedy="exchange or correct them, or make the joint fixed")
        children = [child for child, (on, _) in axes.items() if on == urdf_name]
        if len(children) > 1:
            raise MachineError(f"it carries several moving joints: {', '.join(children)}",
                               where=f"{tree.file}: link '{joint.child}'",
                               remedy="name the link at the end of one chain, read_urdf(..., tip=\"...\")")
        moved = {link: pose for link, (on, pose) in poses.items() if on == urdf_name}
        end = _onto(axes[children[0]][1]) if children else _reaching(moved[tip or list(moved)[-1]][:3, 3])
        starts[urdf_name], to_body = end.far_end(), _inverse(end.near_end())
        masses = [to_body @ pose @ mass @ pose.T @ to_body.T for link, pose in moved.items()
                  if (mass := tree.masses[link]) is not None]
        rest = _inverse(start) @ axis  # d and θ lead to the joint's frame first, then on to the end
        links.append(Link(name=name, parent=parent, body=_body(np.sum(masses, axis=0)) if masses else None, joint=Joint(
            type=_TYPES[joint.type], d=_tidy(rest[2, 3] + end.d), a=end.a, alpha=end.alpha, beta=end.beta,
            theta=_tidy(math.remainder(math.atan2(rest[1, 0], rest[0, 0]) + end.theta, math.tau)),
            lower=lower, upper=upper, max_speed=joint.velocity)))
    return links


def _placed(tree: _Tree, moving: set[str]) -> tuple[dict[str, tuple[str, Array]], dict[str, tuple[str, Array]]]:
    """Of each link, and of each moving joint's frame at rest: the moving joint that carries it, and its pose there."""
    poses = {tree.root: (_NONE, np.eye(4))}
    axes: dict[str, tuple[str, Array]] = {}
    for joint in tree.joints.values():
        carrier, pose = poses[joint.parent]
        turned = _frame_about(joint.axis)
        at = pose @ joint.origin @ turned
        if joint.name in moving:
            axes[joint.name] = carrier, at
            poses[joint.child] = joint.name, turned.T
        else:
            slides = joint.type == "prismatic"
            shift = _Numbers(joint.offset if slides else 0.0, 0.0 if slides else joint.offset)
            poses[joint.child] = carrier, at @ shift.near_end() @ turned.T
    return poses, axes


def _onto(frame: Array) -> _Numbers:
    """Numbers whose far end has its z on that of a `frame`, seen from the joint's frame.

    They follow the common normal of the two axes. Where that runs away, for nearly parallel ones, they reach for the
    frame's origin and tilt there by `alpha` and `beta`, so that they change no more than the axes do.
    """
    point, axis = frame[:3, 3], frame[:3, 2]
    across = math.hypot(axis[0], axis[1])
    if across < _NEARLY_PARALLEL:
        reach = _reaching(point)
        x, y, z = _turn(2, -reach.theta) @ axis
        return reach._replace(alpha=_tidy(math.atan2(-y, z)), beta=_tidy(math.atan2(x, math.hypot(y, z))))
    foot = point - axis * (point[:2] @ axis[:2]) / across**2
    normal = np.array([-axis[1], axis[0]]) / across
    if normal[0] < -1e-9 or (normal[0] < 1e-9 and normal[1] < 0):  # of both directions, the one nearer to the own x
        normal = -normal
    theta = _tidy(math.atan2(normal[1], normal[0]))
    return _Numbers(_tidy(foot[2]), theta, _tidy(float(normal @ foot[:2])),
                    math.atan2(-(_turn(2, -theta) @ axis)[1], axis[2]))


def _reaching(point: Array) -> _Numbers:
    """Numbers whose far end lies in a point (3,) of the joint's frame."""
    x, y, z = (_tidy(value) for value in point)
    return _Numbers(z, math.atan2(y, x), math.hypot(x, y))


def _body(pseudo: Array) -> Body:
    """Body of a pseudo-inertia (4, 4)."""
    m = float(pseudo[3, 3])
    com = pseudo[:3, 3] / (m or 1.0)
    back = _pose(np.eye(3), -com)
    about_com = inertia.from_pseudo_inertia(back @ pseudo @ back.T)[4:]
    return Body(m=m, com=tuple(com.tolist()), inertia_com=tuple(about_com.tolist()))


class _Node:
    """An XML element, or its absence, with its place in the file."""

    def __init__(self, element: ElementTree.Element | None, where: str) -> None:
        self.stated = {} if element is None else element.attrib
        self.element, self.where = element, where

    def at(self, tag: str) -> _Node:
        return _Node(None if self.element is None else self.element.find(tag), f"{self.where}: <{tag}>")

    def number(self, key: str, default: float | None = None) -> float:
        return float(self.numbers(key, None if default is None else (default,))[0])

    def numbers(self, key: str, default: Sequence[float] | None = None) -> Array:
        """Numbers of an attribute, as many as `default` has; if there is none, one, and it must be stated."""
        text = self.stated.get(key)
        if text is None and default is not None:
            return np.array(default)
        try:
            values = np.array([float(word) for word in (text or "").split()])
        except ValueError:
            values = np.array([math.nan])
        if len(values) != len(default or (0,)) or not np.all(np.abs(values) < _LARGEST):
            raise MachineError(f"'{key}' is missing" if text is None else f"'{key}' cannot be '{text:.40}'",
                               where=self.where, remedy=f"state {len(default or (0,))} finite number(s)")
        return values

    def pose(self) -> Array:
        """Pose that an element's <origin> states."""
        roll, pitch, yaw = self.at("origin").numbers("rpy", _NO)
        return _pose(_turn(2, yaw) @ _turn(1, pitch) @ _turn(0, roll), self.at("origin").numbers("xyz", _NO))


def _xml(file: str) -> ElementTree.Element:
    """The <robot> of a file."""
    try:
        text = read_text(file, MachineError, noun="URDF file", most=JSON_LIMIT)
        if "<!DOCTYPE" in text or "<!ENTITY" in text:  # a few lines of entities can expand to gigabytes
            raise MachineError("it declares a document type or entities", where=file, remedy="remove <!DOCTYPE ...>")
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise MachineError(f"is not valid XML ({error})", where=file, remedy="correct that line") from None
    if root.tag != "robot":
        raise MachineError(f"it holds <{root.tag:.60}> instead of <robot>", where=file, remedy="give a URDF file")
    if any("xacro" in element.tag for element in root.iter()):
        raise MachineError("this is a xacro template", where=file, remedy="give what the command xacro makes of it")
    return root


def _tree(robot: ElementTree.Element, file: str) -> _Tree:
    """Links and joints of a <robot>, found to be one tree."""
    masses: dict[str, Array | None] = {}
    joints: dict[str, _Joint] = {}
    for part in (*robot.findall("link"), *robot.findall("joint")):
        name, known = part.get("name", ""), masses if part.tag == "link" else joints
        if not name or name in known:
            raise MachineError(f"two {part.tag}s are called '{name}'" if name else f"a {part.tag} has no name",
                               where=file, remedy="give each one a name of its own")
        node = _Node(part, f"{file}: {part.tag} '{name}'")
        if part.tag == "link":
            masses[name] = _mass(node.at("inertial"))
        else:
            joints[name] = _joint(node, name, masses)
    if not joints:
        raise MachineError("it has no joints", where=file, remedy="add a moving joint")
    before: dict[str, _Joint] = {}
    carried: dict[str, list[_Joint]] = {link: [] for link in masses}
    for joint in joints.values():
        where = f"{file}: joint '{joint.name}'"
        if joint.child in before:
            raise MachineError(f"its child link '{joint.child}' is attached to '{before[joint.child].name}' already",
                               where=where, remedy="remove one of the two")
        if joint.master is not None and (joint.master not in joints or joints[joint.master].master is not None):
            raise MachineError(f"it mimics '{joint.master}', which is not a joint or mimics another one itself",
                               where=where, remedy=f"use {_like(joint.master, joints)}")
        before[joint.child] = joint
        carried[joint.parent].append(joint)
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
    return _Tree(file, roots[0], masses, {before[link].name: before[link] for link in reached[1:]}, before)


def _joint(node: _Node, name: str, links: Iterable[str]) -> _Joint:
    kind = node.stated.get("type", "")
    if kind != "fixed" and kind not in _TYPES:
        raise MachineError(f"joints of type '{kind}' are not supported", where=node.where,
                           remedy=f"make it {', '.join(_TYPES)} or fixed")
    parent, child = (node.at(end).stated.get("link", "") for end in ("parent", "child"))
    for end, link in (("parent", parent), ("child", child)):
        if link not in links:
            raise MachineError(f"its {end} link '{link}' does not exist", where=node.where,
                               remedy=f"use {_like(link, links)}, or add that link")
    axis = np.array((0.0, 0.0, 1.0)) if kind == "fixed" else node.at("axis").numbers("xyz", (1.0, 0.0, 0.0))
    if (length := float(np.linalg.norm(axis))) < 1e-9:
        raise MachineError("its axis is zero", where=node.where, remedy="give it a direction")
    limit, mimic = node.at("limit"), node.at("mimic")
    lower, upper = (limit.number(key) if key in limit.stated else None for key in ("lower", "upper"))
    follows = mimic.element is not None and kind != "fixed"
    return _Joint(name, kind, parent, child, node.pose(), axis / length, lower, upper,
                  max(limit.number("velocity", 0.0), 0.0) or None,  # many files state 0 where nothing is known
                  mimic.stated.get("joint", "") if follows else None, mimic.number("offset", 0.0) if follows else 0.0)


def _mass(node: _Node) -> Array | None:
    """Pseudo-inertia (4, 4) in the link's frame that an <inertial> states."""
    if node.element is None:
        return None
    m = node.at("mass").number("value")
    if m < 0:
        raise MachineError(f"its mass is negative, {m:g} kg", where=node.where, remedy="correct it")
    six = [node.at("inertia").number(key) for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")]
    about_com = inertia.pseudo_inertia(inertia.from_centre_of_mass(m, _NO, six))
    return node.pose() @ about_com @ node.pose().T


def _named(name: str, taken: set[str], prefix: str = "joint") -> str:
    """A name that a machine's part may have and none of those `taken` has yet; it is added to them."""
    name = re.sub(r"\W", "_", name, flags=re.ASCII)
    stem = name = name if name[0].isalpha() else f"{prefix}_{name}"
    count = 1
    while name in taken:
        name = f"{stem}_{(count := count + 1)}"
    taken.add(name)
    return name


def _like(name: str, known: Iterable[str]) -> str:
    """Known names that resemble one, or the first ones."""
    return " or ".join(similar(name, known, 4))


def _pose(rotation: Array, origin: Sequence[float] | Array = _NO) -> Array:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, origin
    return pose


def _inverse(pose: Array) -> Array:
    return _pose(pose[:3, :3].T, -pose[:3, :3].T @ pose[:3, 3])


def _turn(about: int, angle: float) -> Array:
    """Rotation matrix (3, 3) about x, y or z by an angle [rad]."""
    c, s = math.cos(angle), math.sin(angle)
    i, j = (about + 1) % 3, (about + 2) % 3
    matrix = np.eye(3)
    matrix[[i, j, i, j], [i, j, j, i]] = c, c, -s, s
    return matrix


def _frame_about(axis: Array) -> Array:
    """Rotation (4, 4) to a frame whose z is a unit vector (3,) and whose x is near one of the old axes."""
    x = np.eye(3)[0 if abs(axis[0]) < 0.9 else 1]
    x = x - (x @ axis) * axis
    x /= np.linalg.norm(x)
    return _pose(np.column_stack([x, np.cross(axis, x), axis]))


def _tidy(value: float) -> float:
    """The number without rounding errors about zero."""
    return 0.0 if abs(value) < 1e-14 else float(value)
