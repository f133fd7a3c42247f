"""SDF files to the tree of their links and joints."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from hydroopt.errors import MachineError
from hydroopt.machine.robot_formats.frames import ORIGIN, from_roll_pitch_yaw, inverse, pose
from hydroopt.machine.robot_formats.tree import Mimic, RobotTree, Spring, TreeJoint, like, one_tree
from hydroopt.machine.robot_formats.urdf_in import (
    KINDS,
    LARGEST,
    Node,
    homeless_inertials,
    inertial_mass,
    robot_element,
)
from hydroopt.spatial.inertia import Array

WORLD = "world"
"""What a joint may name as its parent, beside links."""


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
        if kind not in KINDS:
            raise MachineError(f"joints of type '{kind}' are not supported", where=joint.where,
                               remedy=f"make it {', '.join(KINDS)}")
        parent, child = ends.get("parent", ""), ends.get("child", "")
        for end, link in (("parent", parent), ("child", child)):
            if link not in self.masses and (end, link) != ("parent", WORLD):
                raise MachineError(f"its {end} link '{link}' does not exist", where=joint.where,
                                   remedy=f"use {like(link, self.masses)}, or add that link")
        if parent == WORLD:
            self.masses.setdefault(WORLD, None)
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
        if (length := float(np.linalg.norm(direction))) < 1e-9:
            raise MachineError("its axis is zero", where=joint.where, remedy="give it a direction")
        limit, dynamics, mimic = (axis.at(tag) for tag in ("limit", "dynamics", "mimic"))
        bounds = [limit.texts().number(key, end, largest=math.inf) for key, end in (("lower", -math.inf),
                                                                                   ("upper", math.inf))]
        endless = kind == "continuous" or (kind == "revolute" and min(-bounds[0], bounds[1]) >= LARGEST)
        lower, upper = (None if endless or abs(value) >= LARGEST else value for value in bounds)
        spring = dynamics.texts().positive("spring_stiffness")
        most = {key: value if 0 < (value := limit.texts().number(key, -1.0, largest=math.inf)) < LARGEST else None
                for key in ("effort", "velocity")}
        return {"axis": direction / length, "lower": lower, "upper": upper, "endless": endless,
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
