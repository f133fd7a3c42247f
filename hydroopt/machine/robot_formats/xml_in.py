"""URDF and SDF files to the trees of their links and joints.

What URDF states in attributes SDF states in elements of its own; both have the same names.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np

from hydroopt.errors import MachineError
from hydroopt.machine.robot_formats.frames import ORIGIN, CentralInertia, from_roll_pitch_yaw, inverse, pose
from hydroopt.machine.robot_formats.tree import Kind, Mimic, RobotTree, Spring, TreeJoint, like, one_tree
from hydroopt.machine.robot_formats.xml_out import MOMENTS
from hydroopt.spatial.inertia import Array
from hydroopt.support.input_file import JSON_LIMIT, read_text

LARGEST = 1e9
"""What numbers are below; limits from here on are none."""
KINDS: dict[str, Kind] = {"revolute": "revolute", "continuous": "revolute", "prismatic": "prismatic", "fixed": "fixed"}
_LOOSE = ("floating", "planar")
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
    robot = Node(robot_element(file, "robot", "URDF"), file)
    if any("xacro" in element.tag for element in robot.elements):
        raise MachineError("this is a xacro template", where=file, remedy="give what the command xacro makes of it")
    links, stated = robot.named("link"), robot.named("joint")
    masses = {name: _mass(link.at("inertial"), link.at("inertial").at("mass"), "value", link.at("inertial").origin())
              for name, link in links.items()}
    gears, joints = _gears(robot), dict[str, TreeJoint]()
    for name, node in stated.items():
        kind, ends = _kind_and_ends(node, masses, (*KINDS, *_LOOSE))
        moves = {} if KINDS.get(kind, "fixed") == "fixed" else _moving(
            node, node, node.at("axis").numbers("xyz", (1.0, 0.0, 0.0)), kind, math.nan)
        joints[name] = TreeJoint(name, KINDS.get(kind, "fixed"), ends["parent"], ends["child"], node.origin(),
                                 gear=gears.get(name, 1.0), **moves)
    children = {joint.child for joint in joints.values()}
    loose = [name for name, node in stated.items() if node.stated["type"] in _LOOSE]
    for name in loose:
        if joints[name].parent in children or len(joints) == 1:
            raise _unsupported(stated[name])
    shapes = sum(element.tag in ("visual", "collision") for link in links.values() for element in link.children)
    lost = _homeless_inertials(robot)
    lost += [f"the free joint '{name}' stands still: the machine's base is '{joints[name].child}'" for name in loose]
    lost += [f"{shapes} visual and collision shapes are left out"] if shapes else []
    lost += [f"'{joint.name}' states limits that are out of reach, and turns without end"
             for joint in joints.values() if joint.endless and stated[joint.name].stated["type"] == "revolute"]
    return one_tree(file, robot.stated.get("name") or Path(path).stem, masses, joints.values(), tuple(lost))


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
    """An XML element, or its absence, with its place in the file; `stated` are its attributes and its children's texts.
    """

    def __init__(self, element: ElementTree.Element | None, where: str) -> None:
        self.children = [] if element is None else list(element)
        self.stated = {each.tag: each.text.strip() for each in self.children if each.text}
        self.stated |= {} if element is None else element.attrib
        self.element, self.where = element, where

    @property
    def elements(self) -> Iterable[ElementTree.Element]:
        """All elements within it, itself included."""
        return () if self.element is None else self.element.iter()

    def at(self, tag: str) -> Node:
        """Its first child of a tag."""
        return Node(next((each for each in self.children if each.tag == tag), None), f"{self.where}: <{tag}>")

    def all(self, tag: str) -> list[Node]:
        """All children of a tag, which have names."""
        return [Node(each, f"{self.where}: {tag} '{each.get('name', '')}'")
                for each in self.children if each.tag == tag]

    def named(self, tag: str) -> dict[str, Node]:
        """All children of a tag by their names.

        Raises:
            MachineError: one has no name, or that of another one.
        """
        found: dict[str, Node] = {}
        for each in self.all(tag):
            name = each.stated.get("name", "")
            if not name or name in found:
                raise MachineError(f"two {tag}s are called '{name}'" if name else f"a {tag} has no name",
                                   where=self.where, remedy="give each one a name of its own")
            found[name] = each
        return found

    def number(self, key: str, default: float | None = None, *, largest: float = LARGEST) -> float:
        """A stated number; it must be stated where there is no default."""
        return float(self.numbers(key, None if default is None else (default,), largest=largest)[0])

    def numbers(self, key: str, default: Sequence[float] | None = None, *, largest: float = LARGEST) -> Array:
        """Stated numbers, as many as `default` has; if there is none, one, and it must be stated."""
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

    def origin(self) -> Array:
        """Pose that an element's <origin> states."""
        angles = self.at("origin").numbers("rpy", ORIGIN)
        return pose(from_roll_pitch_yaw(angles), self.at("origin").numbers("xyz", ORIGIN))


def _unsupported(joint: Node) -> MachineError:
    return MachineError(f"joints of type '{joint.stated.get('type', '')}' are not supported", where=joint.where,
                        remedy=f"make it {', '.join(KINDS)}")


def _kind_and_ends(joint: Node, links: Collection[str], kinds: Collection[str]) -> tuple[str, dict[str, str]]:
    """Type of a joint, and its parent and child.

    Raises:
        MachineError: this type is not read, or an end is no link.
    """
    kind = joint.stated.get("type", "")
    ends = {end: joint.at(end).stated.get("link", joint.stated.get(end, "")) for end in ("parent", "child")}
    if kind not in kinds:
        raise _unsupported(joint)
    for end, link in ends.items():
        if link not in links:
            raise MachineError(f"its {end} link '{link}' does not exist", where=joint.where,
                               remedy=f"use {like(link, links)}, or add that link")
    return kind, ends


def _moving(joint: Node, axis: Node, direction: Array, kind: str, usual: float) -> dict[str, Any]:
    """Axis, limits, friction, spring and master of a moving joint.

    Args:
        joint: its element.
        axis: the element that states all this: in URDF the joint's own, in SDF its axis.
        direction: of the axis (3,).
        kind: as the file has it.
        usual: limit on both sides where none is stated.
    """
    limit, dynamics, mimic = (axis.at(tag) for tag in ("limit", "dynamics", "mimic"))
    if (length := float(np.linalg.norm(direction))) < 1e-9:
        raise MachineError("its axis is zero", where=joint.where, remedy="give it a direction")
    ends = [limit.number(key, end, largest=math.inf) for key, end in (("lower", -usual), ("upper", usual))]
    endless = kind == "continuous" or (kind == "revolute" and min(-ends[0], ends[1]) >= LARGEST)
    lower, upper = (value if abs(value) < LARGEST and not endless else None for value in ends)
    effort, speed = (value if 0 < (value := limit.number(key, 0.0, largest=math.inf)) < LARGEST else None
                     for key in ("effort", "velocity"))
    stiffness, ratio = dynamics.positive("spring_stiffness"), mimic.number("multiplier", 1.0)
    return {"axis": direction / length, "lower": lower, "upper": upper, "endless": endless, "max_effort": effort,
            "max_speed": speed, "viscous": dynamics.positive("damping"), "coulomb": dynamics.positive("friction"),
            "spring": Spring(stiffness, dynamics.number("spring_reference", 0.0)) if stiffness else None,
            "mimic": None if mimic.element is None else Mimic(
                mimic.stated.get("joint", ""), ratio,
                mimic.number("offset", 0.0) - ratio * mimic.number("reference", 0.0))}


def _gears(robot: Node) -> dict[str, float]:
    """Gear ratios of transmissions of one joint, by joint."""
    found = {}
    for part in robot.all("transmission"):
        reductions = [each.text for each in part.elements if each.tag == "mechanicalReduction" and (
            each.text or "").strip()]
        if len(joints := part.all("joint")) == 1 and reductions:
            stated = Node(ElementTree.Element("value", value=reductions[0] or ""),
                          f"{part.where}: <mechanicalReduction>")
            found[joints[0].stated.get("name", "")] = abs(stated.number("value")) or 1.0
    return found


def _mass(inertial: Node, mass: Node, key: str, at: Array) -> Array | None:
    """Pseudo-inertia (4, 4) in the link's frame that an <inertial> states; None where there is none, or all is zero.

    Args:
        inertial: the element.
        mass: what states the mass under a `key`.
        key: see `mass`.
        at: the pose of the frame in which moments of inertia are stated.
    """
    if inertial.element is None:
        return None
    m = mass.number(key)
    if m < 0:
        raise MachineError(f"its mass is negative, {m:g} kg", where=inertial.where, remedy="correct it")
    moments = np.array([inertial.at("inertia").number(each) for each in MOMENTS])
    return at @ CentralInertia(m, np.zeros(3), moments).pseudo() @ at.T if m or moments.any() else None


def _homeless_inertials(robot: Node) -> list[str]:
    """The <inertial> elements that are no link's first one, in sentences."""
    links = [link.element for link in robot.all("link")]
    counted, found = {id(link.at("inertial").element) for link in robot.all("link")}, []
    for parent in robot.elements:
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
    model = Node(models[0], file)
    frames = _Frames(file, {tag: model.named(tag) for tag in ("link", "joint", "frame")})
    masses: dict[str, Array | None] = {}
    for name, link in frames.parts["link"].items():
        inertial = link.at("inertial")
        masses[name] = _mass(inertial, inertial, "mass", _pose(inertial))
    joints: list[TreeJoint] = []
    for name, joint in frames.parts["joint"].items():
        if joint.stated.get("parent") == WORLD:
            masses.setdefault(WORLD, None)
        kind, ends = _kind_and_ends(joint, masses, KINDS)
        at = frames.place(name, (("link", name),))
        moves = {} if kind == "fixed" else _moving(joint, joint.at("axis"), frames.axis(joint, at), kind, math.inf)
        offset = inverse(at) @ frames.place(ends["child"])
        beside = not np.allclose(offset, np.eye(4), rtol=0, atol=1e-12)  # the link's frame is not the joint's
        moved = f"{name}.moved" if beside else ends["child"]
        joints.append(TreeJoint(name, KINDS[kind], ends["parent"], moved,
                                inverse(frames.place(ends["parent"])) @ at, **moves))
        if beside:
            masses[moved] = None
            joints.append(TreeJoint(f"{name}.offset", "fixed", moved, ends["child"], offset))
    lost = _homeless_inertials(model)
    lost += [f"{count} further <{tag}> are left out" for tag in ("include", "model") if (count := len(model.all(tag)))]
    return one_tree(file, model.stated.get("name") or Path(file).stem, masses, joints, tuple(lost))


class _Frames(NamedTuple):
    """Links, joints and frames of an SDF model, each by its name."""

    file: str
    parts: dict[str, dict[str, Node]]

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
        beside = {"joint": part.stated.get("child", ""), "frame": part.stated.get("attached_to", "")}
        stated = part.at("pose").stated
        return self.place(stated.get("relative_to") or stated.get("frame") or beside.get(found, ""),
                          (*behind, (found, name))) @ _pose(part)

    def axis(self, joint: Node, at: Array) -> Array:
        """Direction (3,) of the axis of a joint, which has a pose in the model's frame."""
        axis = joint.at("axis")
        direction = axis.numbers("xyz", (0.0, 0.0, 1.0))
        older = "__model__" if axis.stated.get("use_parent_model_frame") in ("1", "true") else ""
        if frame := axis.at("xyz").stated.get("expressed_in", older):
            return np.asarray(at[:3, :3].T @ self.place(frame)[:3, :3] @ direction)
        return direction


def _pose(part: Node) -> Array:
    """What an element's <pose> states."""
    at = part.at("pose")
    if at.stated.get("rotation_format", "euler_rpy") != "euler_rpy":
        raise MachineError("its rotation is a quaternion", where=at.where, remedy="state roll, pitch and yaw")
    six = part.numbers("pose", (*ORIGIN, *ORIGIN))
    angles = np.radians(six[3:]) if at.stated.get("degrees") in ("true", "1") else six[3:]
    return pose(from_roll_pitch_yaw(angles), six[:3])
