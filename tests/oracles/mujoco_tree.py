"""A machine as MuJoCo sees it: links as a tree, barrels and rods as branches on hinges at their pins.

Only for planar triangles whose barrel hangs on the link before the driven joint, as on an excavator; there
the angle of the centre line is the argument of a complex number and its rates come by hand.
"""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from hydroopt.machine.actuators import Cylinder
from hydroopt.machine.links import Link
from hydroopt.machine.machine import BASE, Machine


class Loop(NamedTuple):
    """Centre line of a cylinder in the plane of its joint, seen from the link before the joint.

    `direction` is its angle with rate and acceleration; per unit of q̇ the length changes by `lever_arm` and
    the angle by `turn`.
    """

    lever_arm: float
    turn: float
    direction: tuple[float, float, float]


class MujocoTree:
    """Links, and barrels and rods as far as `clouds` (owner → φ) names them."""

    def __init__(self, machine: Machine, clouds: dict[str, np.ndarray]) -> None:
        self.machine = machine
        spec = mujoco.MjSpec()
        spec.option.gravity = [0, 0, -machine.gravity]
        spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
        tilt = Rotation.from_euler("xyz", machine.orientation)
        self.bodies = {BASE: spec.worldbody.add_body(name=BASE, quat=tilt.as_quat(scalar_first=True))}
        for link in machine.links:
            self._link(link, clouds)
        self.branched = [c for c in machine.cylinders if f"{c.name}.barrel" in clouds]
        for cylinder in self.branched:
            self._branches(cylinder, clouds)
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)

    def _link(self, link: Link, clouds: dict[str, np.ndarray]) -> None:
        j, parent = link.joint, link.parent
        before = None if parent == BASE else self.machine.link(parent).joint
        turn = Rotation.from_euler("z", j.theta)
        start = np.array([0, 0, j.d])
        if before is not None:
            end = Rotation.from_euler("XY", [before.alpha, before.beta])
            turn, start = end * turn, end.apply(start) + np.array([before.a, 0, 0])
        body = self.bodies[parent].add_body(name=link.name, pos=start, quat=turn.as_quat(scalar_first=True))
        self.bodies[link.name] = body
        if j.type != "locked":
            kind = mujoco.mjtJoint.mjJNT_SLIDE if j.type == "prismatic" else mujoco.mjtJoint.mjJNT_HINGE
            body.add_joint(name=link.name, type=kind, axis=[0, 0, 1])
        _give_mass(body, clouds[link.name])

    def _branches(self, cylinder: Cylinder, clouds: dict[str, np.ndarray]) -> None:
        driven = self._driven(cylinder)
        assert (cylinder.barrel.link, cylinder.rod.link) == (driven.parent, driven.name)
        # both hinges start out parallel to the axes of the link before the joint and of the link after it
        before = self.machine.link(driven.parent).joint
        turns = {"barrel": Rotation.from_euler("XY", [before.alpha, before.beta]), "rod": Rotation.identity()}
        for end, turn in turns.items():
            name, attachment = f"{cylinder.name}.{end}", getattr(cylinder, end)
            body = self.bodies[attachment.link].add_body(name=name, pos=attachment.pin,
                                                         quat=turn.as_quat(scalar_first=True))
            body.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 0, 1])
            _give_mass(body, clouds[name])

    def _driven(self, cylinder: Cylinder) -> Link:
        (joint,) = self.machine.joints_between(cylinder.barrel.link, cylinder.rod.link)
        return self.machine.link(joint)

    def loop(self, cylinder: Cylinder, q: float, qd: float, qdd: float) -> Loop:
        driven = self._driven(cylinder)
        before, theta = self.machine.link(driven.parent).joint, driven.joint.theta + q
        end = Rotation.from_euler("XY", [before.alpha, before.beta])
        barrel = end.inv().apply(np.array(cylinder.barrel.pin) - [before.a, 0, 0])
        rod = np.array(cylinder.rod.pin) + np.array([0, 0, driven.joint.d])
        assert abs(barrel[2] - rod[2]) < 1e-12  # planar
        arm = complex(rod[0], rod[1]) * np.exp(1j * theta)
        line = arm - complex(barrel[0], barrel[1])
        # with line = s·exp(iφ), the logarithm's derivative is ṡ/s + iφ̇
        unit = 1j * arm / line
        rate, acceleration = unit * qd, (1j * qdd - qd**2) * arm / line
        return Loop(abs(line) * unit.real, unit.imag,
                    (np.angle(line), rate.imag, (acceleration - rate**2).imag))

    def actuator_forces(self, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray,
                        pin_friction: dict[str, float] | None = None) -> np.ndarray:
        """Forces (n,): MuJoCo's torques through the loops, and friction of pins, by ``<cylinder>.<end>``."""
        joints = self.machine.joints
        for index, joint in enumerate(joints):
            self._set(joint, q[index], qd[index], qdd[index])
        loops = {}
        for cylinder in self.machine.cylinders:
            driven = self._driven(cylinder)
            state = [x[joints.index(driven.name)] for x in (q, qd, qdd)]
            loop = loops[driven.name] = self.loop(cylinder, *state)
            if cylinder in self.branched:
                self._set(f"{cylinder.name}.barrel", *loop.direction)
                own = [state[0] + driven.joint.theta, *state[1:]]
                self._set(f"{cylinder.name}.rod", *np.subtract(loop.direction, own))
        mujoco.mj_inverse(self.model, self.data)
        forces = np.array([self._force(joint) for joint in joints])
        for cylinder in self.machine.cylinders:
            index = joints.index(self._driven(cylinder).name)
            loop = loops[joints[index]]
            turns = {"barrel": loop.turn, "rod": loop.turn - 1} if cylinder in self.branched else {}
            for end, turn in turns.items():
                friction = (pin_friction or {}).get(f"{cylinder.name}.{end}", 0.0) * np.sign(turn * qd[index])
                forces[index] += turn * (self._force(f"{cylinder.name}.{end}") + friction)
            forces[index] /= loop.lever_arm
        return forces

    def _set(self, joint: str, q: float, qd: float, qdd: float) -> None:
        found = self.model.joint(joint)
        self.data.qpos[found.qposadr], self.data.qvel[found.dofadr], self.data.qacc[found.dofadr] = q, qd, qdd

    def _force(self, joint: str) -> float:
        return float(self.data.qfrc_inverse[self.model.joint(joint).dofadr[0]])


def _give_mass(body: mujoco.MjsBody, phi: np.ndarray) -> None:
    m, com = phi[0], phi[1:4] / phi[0]
    xx, xy, xz, yy, yz, zz = phi[4:]
    about_origin = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    about_com = about_origin - m * (com @ com * np.eye(3) - np.outer(com, com))
    # principal axes from here: MuJoCo's own are good to about ten digits only
    moments, axes = np.linalg.eigh(about_com)
    axes[:, 0] *= np.linalg.det(axes)
    body.explicitinertial = True
    body.mass, body.ipos, body.inertia = m, com, moments
    body.iquat = Rotation.from_matrix(axes).as_quat(scalar_first=True)
