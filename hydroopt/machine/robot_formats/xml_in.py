"""URDF and SDF files to the trees of their links and joints."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from hydroopt.errors import MachineError
from hydroopt.machine.robot_formats.frames import ORIGIN, from_roll_pitch_yaw, inverse, pose
from hydroopt.machine.robot_formats.tree import Kind, Mimic, RobotTree, Spring, TreeJoint, like, one_tree
from hydroopt.spatial import inertia
from hydroopt.spatial.inertia import Array
from hydroopt.support.input_file import JSON_LIMIT, read_text

LARGEST = 1e9
"""What numbers are below; limits from here on are none."""
KINDS: dict[str, Kind] = {"revolute": "revolute", "continuous": "revolute", "prismatic": "prismatic", "fixed": "fixed"}
_GEOMETRY = ("visual", "collision")
WORLD = "world"
"""What a joint may name as its parent, beside links."""


def read_urdf(path: str | Path) -> RobotTree:
    """Links and joints of a URDF file, in UTF-8.

    Friction, limits of effort and speed, gears of transmissions and what mimics what are read, geometry is not. A
    floating or planar joint on the root stands still: the machine's base is the robot's.

    Raises:
        MachineError: the file is missing or no URDF, contradictory or incomplete.

    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as directory:
    ...     file = Path(directory) / "arm.urdf"
    ...     _ = file.write_text('''<robot name="arm"><link name="ground"/><link name="boom"/>
    ...         <joint name="lift" type="revolute"><parent link="ground"/><child link="boom"/><axis xyz="0 0 1"/>
    ...         <limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>''')
    ...     read_urdf(file).joints["lift"].upper
    1.0
    """
    file = str(path)
    robot = robot_element(file, "robot", "URDF")
    if any("xacro" in element.tag for element in robot.iter()):
        raise MachineError("this is a xacro template", where=file, remedy="give what the command xacro makes of it")
    masses: dict[str, Array | None] = {}
    joints: dict[str, TreeJoint] = {}
    gears = _gears(robot, file)
    for part in (*robot.findall("link"), *robot.findall("joint")):
        name, known = part.get("name", ""), masses if part.tag == "link" else joints
        if not name or name in known:
            raise MachineError(f"two {part.tag}s are called '{name}'" if name else f"a {part.tag} has no name",
                               where=file, remedy="give each one a name of its own")
        node = Node(part, f"{file}: {part.tag} '{name}'")
        if part.tag == "link":
            inertial = node.at("inertial")
            masses[name] = inertial_mass(inertial, inertial.at("mass"), inertial.at("inertia"), inertial.pose(),
                                         "value")
        else:
            joints[name] = _joint(node, name, masses, gears.get(name, 1.0))
    children = {joint.child for joint in joints.values()}
    loose = [name for name, joint in joints.items() if _kind(robot, name) in ("floating", "planar")]
    for name in loose:
        if joints[name].parent in children or len(joints) == 1:
            raise MachineError(f"joints of type '{_kind(robot, name)}' are not supported",
                               where=f"{file}: joint '{name}'", remedy=f"make it {', '.join(KINDS)}")
    shapes = sum(len(link.findall(tag)) for link in robot.findall("link") for tag in _GEOMETRY)
    lost = homeless_inertials(Node(robot, file))
    lost += [f"the free joint '{name}' stands still: the machine's base is '{joints[name].child}'" for name in loose]
    lost += [f"{shapes} visual and collision shapes are left out"] if shapes else []
    lost += [f"'{joint.name}' states limits that are out of reach, and turns without end"
             for joint in joints.values() if joint.endless and _kind(robot, joint.name) == "revolute"]
    return one_tree(file, robot.get("name") or Path(path).stem, masses, joints.values(), tuple(lost))


def robot_element(file: str, tag: str, noun: str) -> ElementTree.Element:
    """The root element of an XML file, of this tag.

    Raises:
        MachineError: the file is missing, no XML, or holds another element; `noun` is the format's name.
    """
    try:
        text = read_text(file, MachineError, noun=f"{noun} file", most=JSON_LIMIT)
        if "<!DOCTYPE" in text or "<!ENTITY" in text:  # a few lines of entities can expand to gigabytes
            raise MachineError("it declares a document type or entities", where=file, remedy="remove <!DOCTYPE ...>")
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise MachineError(f"is not valid XML ({error})", where=file, remedy="correct that line") from None
    if root.tag != tag:
        raise MachineError(f"it holds <{root.tag:.60}> instead of <{tag}>", where=file, remedy=f"give a {noun} file")
    return root


class Node:
    """An XML element, or its absence, with its place in the file."""

    def __init__(self, element: ElementTree.Element | None, where: str) -> None:
        self.stated = {} if element is None else element.attrib
        self.element, self.where = element, where

    def at(self, tag: str) -> Node:
        """Its first child of a tag."""
        return Node(None if self.element is None else self.element.find(tag), f"{self.where}: <{tag}>")

    def all(self, tag: str) -> list[Node]:
        """All children of a tag, which have names."""
        found = [] if self.element is None else self.element.findall(tag)
        return [Node(each, f"{self.where}: {tag} '{each.get('name', '')}'") for each in found]

    def texts(self) -> Node:
        """What stands in its children, as if they were attributes."""
        texts = {} if self.element is None else {each.tag: each.text.strip() for each in self.element if each.text}
        return Node(ElementTree.Element("texts", texts), self.where)

    def number(self, key: str, default: float | None = None, *, largest: float = LARGEST) -> float:
        """A number of an attribute; it must be stated where there is no default."""
        return float(self.numbers(key, None if default is None else (default,), largest=largest)[0])

    def numbers(self, key: str, default: Sequence[float] | None = None, *, largest: float = LARGEST) -> Array:
        """Numbers of an attribute, as many as `default` has; if there is none, one, and it must be stated."""
        text = self.stated.get(key)
        if text is None and default is not None:
            return np.array(default)
        try:
            values = np.array([float(word) for word in (text or "").split()])
        except ValueError:
            values = np.array([math.nan])
        if len(values) != len(default or (0,)) or not np.all(np.abs(values) < largest):
            raise MachineError(f"'{key}' is missing" if text is None else f"'{key}' cannot be '{text:.40}'",
                               where=self.where, remedy=f"state {len(default or (0,))} finite number(s)")
        return values

    def positive(self, key: str) -> float:
        """A number, zero where it is not stated: many files state 0, or less, where nothing is known."""
        return max(self.number(key, 0.0), 0.0)

    def pose(self) -> Array:
        """Pose that an element's <origin> states."""
        angles = self.at("origin").numbers("rpy", ORIGIN)
        return pose(from_roll_pitch_yaw(angles), self.at("origin").numbers("xyz", ORIGIN))


def _kind(robot: ElementTree.Element, name: str) -> str:
    return next(joint.get("type", "") for joint in robot.findall("joint") if joint.get("name") == name)


def _joint(node: Node, name: str, links: Iterable[str], gear: float) -> TreeJoint:
    kind = node.stated.get("type", "")
    parent, child = (node.at(end).stated.get("link", "") for end in ("parent", "child"))
    _refuse_joint(node, kind, (*KINDS, "floating", "planar"), {"parent": parent, "child": child}, links)
    moves = KINDS.get(kind, "fixed") != "fixed"
    axis = node.at("axis").numbers("xyz", (1.0, 0.0, 0.0)) if moves else np.array((0.0, 0.0, 1.0))
    limit, dynamics = node.at("limit"), node.at("dynamics")
    lower, upper = (limit.number(key, largest=math.inf) if key in limit.stated else None for key in ("lower", "upper"))
    endless = kind == "continuous" or (kind == "revolute" and None not in (lower, upper)
                                       and -(lower or 0.0) >= LARGEST and (upper or 0.0) >= LARGEST)
    if moves and not endless:
        lower, upper = (limit.number(key) if key in limit.stated else None for key in ("lower", "upper"))
    return TreeJoint(
        name=name, kind=KINDS.get(kind, "fixed"), parent=parent, child=child, origin=node.pose(),
        axis=_unit(axis, node),
        lower=lower if moves and not endless else None,
        upper=upper if moves and not endless else None, endless=endless,
        max_speed=limit.positive("velocity") or None, max_effort=limit.positive("effort") or None,
        viscous=dynamics.positive("damping"), coulomb=dynamics.positive("friction"), gear=gear,
        mimic=_mimic(node.at("mimic")) if moves else None)


def _refuse_joint(node: Node, kind: str, kinds: Iterable[str], ends: Mapping[str, str], links: Iterable[str]) -> None:
    """Refuse a joint of a type that is not read, or an end of it that is no link."""
    if kind not in kinds:
        raise MachineError(f"joints of type '{kind}' are not supported", where=node.where,
                           remedy=f"make it {', '.join(KINDS)}")
    for end, link in ends.items():
        if link not in links:
            raise MachineError(f"its {end} link '{link}' does not exist", where=node.where,
                               remedy=f"use {like(link, links)}, or add that link")


def _unit(axis: Array, node: Node) -> Array:
    """Direction (3,) of an axis."""
    if (length := float(np.linalg.norm(axis))) < 1e-9:
        raise MachineError("its axis is zero", where=node.where, remedy="give it a direction")
    return np.asarray(axis / length)


def _mimic(node: Node) -> Mimic | None:
    if node.element is None:
        return None
    ratio = node.number("multiplier", 1.0)
    return Mimic(node.stated.get("joint", ""), ratio, node.number("offset", 0.0))


def _gears(robot: ElementTree.Element, file: str) -> dict[str, float]:
    """Gear ratios of transmissions of one joint, by joint."""
    found = {}
    for part in robot.findall("transmission"):
        node = Node(part, f"{file}: transmission '{part.get('name', '')}'")
        joints = part.findall("joint")
        reductions = [each for each in part.iter("mechanicalReduction") if (each.text or "").strip()]
        if len(joints) == 1 and len(reductions) >= 1:
            stated = Node(ElementTree.Element("value", value=reductions[0].text or ""),
                           f"{node.where}: <mechanicalReduction>")
            found[joints[0].get("name", "")] = abs(stated.number("value")) or 1.0
    return found


def inertial_mass(inertial: Node, mass: Node, six: Node, at: Array, key: str = "mass") -> Array | None:
    """Pseudo-inertia (4, 4) in the link's frame that an <inertial> states; None where there is none, or all is zero.

    Args:
        inertial: the element.
        mass: what states the mass under a `key`.
        six: what states the moments of inertia.
        at: the pose of the frame that they are stated in.
    """
    if inertial.element is None:
        return None
    m = mass.number(key)
    if m < 0:
        raise MachineError(f"its mass is negative, {m:g} kg", where=inertial.where, remedy="correct it")
    moments = [six.number(each) for each in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")]
    return at @ inertia.pseudo_inertia(inertia.from_centre_of_mass(m, ORIGIN, moments)) @ at.T if m or any(
        moments) else None


def homeless_inertials(robot: Node) -> list[str]:
    """The <inertial> elements that are no link's first one, in sentences."""
    assert robot.element is not None
    links = robot.element.findall("link")
    counted, found = {id(link.find("inertial")) for link in links}, []
    for parent in robot.element.iter():
        before = ""
        for child in parent:
            if child.tag == "inertial" and id(child) not in counted:
                name = f"<{parent.tag}> '{parent.get('name', '')}'"
                found.append(f"the <inertial> in {name}{before} is left out: " + (
                    "the link has one already" if parent in links else "it belongs to no link"))
            before = f" behind <{child.tag}> '{child.get('name', '')}'"
    return found


def read_sdf(path: str | Path) -> RobotTree:
    """Links and joints of the one model of an SDF file, in UTF-8.

    Poses relative to any link, joint or frame, limits, friction, springs and what mimics what are read; geometry,
    plugins and included models are not.

    Raises:
        MachineError: the file is missing or no SDF, contradictory or incomplete, or holds no or several models.

    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as directory:
    ...     file = Path(directory) / "arm.sdf"
    ...     _ = file.write_text('''<sdf version="1.9"><model name="arm"><link name="ground"/><link name="boom">
    ...         <pose>0 0 1.5 0 0 0</pose></link><joint name="lift" type="revolute"><parent>ground</parent>
    ...         <child>boom</child><axis><xyz>0 1 0</xyz><limit><lower>-1</lower><upper>1</upper></limit></axis></joint>
    ...         </model></sdf>''')
    ...     read_sdf(file).joints["lift"].origin[:3, 3].tolist()
    [0.0, 0.0, 1.5]
    """
    file = str(path)
    root = robot_element(file, "sdf", "SDF")
    models = root.findall("./model") or root.findall("./world/model")
    if len(models) != 1:
        raise MachineError(f"it holds {len(models)} models", where=file, remedy="give a file of one model")
    return _Model(file, Node(models[0], file)).tree()


class _Model:
    def __init__(self, file: str, model: Node) -> None:
        self.file, self.model = file, model
        self.parts = {tag: {each.stated.get("name", ""): each for each in model.all(tag)}
                      for tag in ("link", "joint", "frame")}
        for tag, parts in self.parts.items():
            if "" in parts or len(parts) < len(model.all(tag)):
                raise MachineError(f"a {tag} has no name, or the name of another one", where=file,
                                   remedy="give each one a name of its own")
        self.masses: dict[str, Array | None] = {name: inertial_mass(link.at("inertial"), link.at("inertial").texts(),
                                                                   link.at("inertial").at("inertia").texts(),
                                                                   _pose(link.at("inertial")))
                                                for name, link in self.parts["link"].items()}
        self.joints: list[TreeJoint] = []

    def tree(self) -> RobotTree:
        for name, joint in self.parts["joint"].items():
            self._joint(name, joint)
        lost = [*homeless_inertials(self.model)]
        for tag in ("include", "model"):
            lost += [f"{count} further <{tag}> are left out"] if (count := len(self.model.all(tag))) else []
        return one_tree(self.file, self.model.stated.get("name") or Path(self.file).stem, self.masses, self.joints,
                        tuple(lost))

    def place(self, name: str, behind: tuple[tuple[str, str], ...] = ()) -> Array:
        """Pose (4, 4) of a link, joint or frame in the model's frame; older files have a link and a joint of one name.
        """
        if name in ("", "__model__", WORLD):
            return np.eye(4)
        found = next((tag for tag, parts in self.parts.items() if name in parts and (tag, name) not in behind), None)
        if found is None:
            raise MachineError(f"a pose is relative to '{name}', which is none of its links, joints and frames, or is "
                               "placed relative to itself", where=self.file, remedy="correct 'relative_to'")
        part = self.parts[found][name]
        beside = {"joint": part.texts().stated.get("child", ""), "frame": part.stated.get("attached_to", "")}
        stated = part.at("pose").stated
        return self.place(stated.get("relative_to") or stated.get("frame") or beside.get(found, ""),
                          (*behind, (found, name))) @ _pose(part)

    def _joint(self, name: str, joint: Node) -> None:
        kind, ends = joint.stated.get("type", ""), joint.texts().stated
        parent, child = ends.get("parent", ""), ends.get("child", "")
        if parent == WORLD:
            self.masses.setdefault(WORLD, None)
        _refuse_joint(joint, kind, KINDS, {"parent": parent, "child": child}, self.masses)
        at = self.place(name, (("link", name),))
        moving = {} if kind == "fixed" else self._axis(joint, at, kind)
        offset = inverse(at) @ self.place(child)
        beside = not np.allclose(offset, np.eye(4), rtol=0, atol=1e-12)  # the link's frame is not the joint's
        moved = f"{name}.moved" if beside else child
        self.joints.append(TreeJoint(name=name, kind=KINDS[kind], parent=parent, child=moved,
                                     origin=inverse(self.place(parent)) @ at, **moving))
        if beside:
            self.masses[moved] = None
            self.joints.append(TreeJoint(name=f"{name}.offset", kind="fixed", parent=moved, child=child, origin=offset))

    def _axis(self, joint: Node, at: Array, kind: str) -> dict[str, Any]:
        """Axis, limits, friction, spring and master of a moving joint at a pose in the model's frame."""
        axis = joint.at("axis")
        direction = axis.texts().numbers("xyz", (0.0, 0.0, 1.0))
        older = "__model__" if axis.texts().stated.get("use_parent_model_frame") in ("1", "true") else ""
        if frame := axis.at("xyz").stated.get("expressed_in", older):
            direction = at[:3, :3].T @ self.place(frame)[:3, :3] @ direction
        limit, dynamics, mimic = (axis.at(tag) for tag in ("limit", "dynamics", "mimic"))
        bounds = [limit.texts().number(key, end, largest=math.inf) for key, end in (("lower", -math.inf),
                                                                                   ("upper", math.inf))]
        endless = kind == "continuous" or (kind == "revolute" and min(-bounds[0], bounds[1]) >= LARGEST)
        lower, upper = (None if endless or abs(value) >= LARGEST else value for value in bounds)
        spring = dynamics.texts().positive("spring_stiffness")
        most = {key: value if 0 < (value := limit.texts().number(key, -1.0, largest=math.inf)) < LARGEST else None
                for key in ("effort", "velocity")}
        return {"axis": _unit(direction, joint), "lower": lower, "upper": upper, "endless": endless,
                "max_effort": most["effort"], "max_speed": most["velocity"],
                "viscous": dynamics.texts().positive("damping"), "coulomb": dynamics.texts().positive("friction"),
                "spring": Spring(spring, dynamics.texts().number("spring_reference", 0.0)) if spring else None,
                "mimic": None if mimic.element is None else Mimic(
                    mimic.stated.get("joint", ""), (ratio := mimic.texts().number("multiplier", 1.0)),
                    mimic.texts().number("offset", 0.0) - ratio * mimic.texts().number("reference", 0.0))}


def _pose(part: Node) -> Array:
    """What an element's <pose> states."""
    at = part.at("pose")
    if at.stated.get("rotation_format", "euler_rpy") != "euler_rpy":
        raise MachineError("its rotation is a quaternion", where=at.where, remedy="state roll, pitch and yaw")
    six = part.texts().numbers("pose", (*ORIGIN, *ORIGIN))
    angles = np.radians(six[3:]) if at.stated.get("degrees") in ("true", "1") else six[3:]
    return pose(from_roll_pitch_yaw(angles), six[:3])
