"""Pinocchio's model of a URDF file, with what it leaves out of torques: friction, and joints that mimic others."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from hydroopt.machine.machine import Machine


class PinocchioUrdf:
    """The model of a file; joints that are not given stand at `held`, or at zero."""

    def __init__(self, path: Path, held: dict[str, float] | None = None) -> None:
        self.model = pin.buildModelFromUrdf(str(path))
        self.data = self.model.createData()
        self.held = held or {}
        joints = {joint.get("name", ""): joint for joint in ElementTree.parse(path).getroot().findall("joint")}
        self.axes = {name: np.array((axis.get("xyz") if (axis := joint.find("axis")) is not None
                                     else "1 0 0").split(), dtype=float) for name, joint in joints.items()}
        self.children = {name: joint.find("child").get("link") for name, joint in joints.items()}
        self.mimics = {name: (mimic.get("joint"), float(mimic.get("multiplier", 1)), float(mimic.get("offset", 0)))
                       for name, joint in joints.items() if (mimic := joint.find("mimic")) is not None}
        stated = {name: joint.find("dynamics") for name, joint in joints.items()}
        self.friction = {name: tuple(float(dynamics.get(key, 0)) for key in ("damping", "friction"))
                         for name, dynamics in stated.items() if dynamics is not None}
        self.named = {re.sub(r"\W", "_", name): name for name in joints}
        self.named |= {name if name[0].isalpha() else f"joint_{name}": own for name, own in self.named.items()}

    def vector(self, values: dict[str, float]) -> np.ndarray:
        """Positions or rates (nv,) by joint."""
        found = np.zeros(self.model.nv)
        for name, value in values.items():
            found[self.model.idx_vs[self.model.getJointId(name)]] = value
        return found

    def state(self, values: dict[str, float]) -> np.ndarray:
        """Pinocchio's configuration at positions by joint."""
        return pin.integrate(self.model, pin.neutral(self.model), self.vector(self.held | values))

    def move(self, values: dict[str, float]) -> None:
        """Put all frames where positions by joint have them."""
        pin.framesForwardKinematics(self.model, self.data, self.state(values))

    def pose(self, link: str) -> np.ndarray:
        """Pose (4, 4) of a link in the world."""
        return self.data.oMf[self.model.getFrameId(link, pin.FrameType.BODY)].homogeneous

    def mass(self) -> float:
        """Mass of all bodies that a joint moves."""
        return float(sum(body.mass for body in list(self.model.inertias)[1:]))

    def position(self, machine: Machine, joint: str, given: dict[str, float], offset: float = 1.0) -> float:
        """Position of a joint of the machine, by its own name in the file; its rate with `offset` zero."""
        if joint in given:
            return given[joint]
        master, ratio, shift = self.mimics[joint]
        return ratio * self.position(machine, master, given, offset) + offset * shift

    def torques(self, machine: Machine, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
        """Torques (n,) of the machine's independent joints: those of the tree at what follows them, and friction."""
        self.model.gravity.linear = np.array([0, 0, -machine.gravity])
        own = [self.named[name] for name in machine.joints]
        tree = [self.named[name] for name in machine.tree_joints]
        given = [dict(zip(own, values, strict=True)) for values in (q, qd, qdd)]
        at, rate, change = ({name: self.position(machine, name, values, offset) for name in tree}
                            for values, offset in zip(given, (1.0, 0.0, 0.0), strict=True))
        found = pin.rnea(self.model, self.data, self.state(at), self.vector(rate), self.vector(change))
        whole = {name: found[self.model.idx_vs[self.model.getJointId(name)]] for name in tree}
        for name in tree:
            viscous, coulomb = self.friction.get(name, (0.0, 0.0))
            whole[name] += viscous * rate[name] + coulomb * np.sign(rate[name])
        ways = [{name: self.position(machine, name, dict.fromkeys(own, 0.0) | {one: 1.0}, 0.0) for name in tree}
                for one in own]
        return np.array([sum(way[name] * whole[name] for name in tree) for way in ways])
