"""Forces of a machine along a motion: MuJoCo's inverse dynamics of links, barrels and rods, and virtual work.

Nothing of hydroopt is used here. The tree that MuJoCo sees is cut at the rods' pins: barrels turn on their pins, rods
slide in them. Where barrels and rods are follows from each triangle; the work that a motion of the joints alone does in
all coordinates of the tree is that of the forces in joints and along rods.
"""

from __future__ import annotations

from functools import lru_cache

import mujoco
import numpy as np

from studies.verdicts.machines import Array, Body, Cylinder, Truth

NOTHING = 1e-9
"""Mass [kg] of what has none; MuJoCo moves nothing without mass."""


class Plant:
    """A machine in MuJoCo. The base turns by a hinge of its own, which stands still unless it is soft."""

    def __init__(self, truth: Truth, tilt: float = 0.0) -> None:
        self.truth = truth
        spec = mujoco.MjSpec()
        spec.compiler.degree = False
        spec.compiler.balanceinertia = False
        spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
        base = np.array([np.cos(np.pi / 4), np.sin(np.pi / 4), 0, 0]) if truth.upright else np.array([1.0, 0, 0, 0])
        axis = np.array(truth.soft_axis)
        down = np.array([0, -9.81, 0]) if truth.upright else np.array([0, 0, -9.81])
        turned = down * np.cos(tilt) + np.cross(axis, down) * np.sin(tilt) + axis * (axis @ down) * (1 - np.cos(tilt))
        y, z = turned[1], turned[2]
        spec.option.gravity = [turned[0], -z, y] if truth.upright else turned.tolist()  # in the world
        foot = spec.worldbody.add_body(name="base", quat=base)
        foot.add_joint(name="base", type=mujoco.mjtJoint.mjJNT_HINGE, axis=axis)
        foot.mass, foot.inertia, foot.explicitinertial = NOTHING, [NOTHING] * 3, True
        carriers = [foot]
        for k, joint in enumerate(truth.joints):
            a, alpha = truth.seat(k)
            link = carriers[-1].add_body(name=joint.name, pos=[a, 0, 0],
                                         quat=[np.cos(alpha / 2), np.sin(alpha / 2), 0, 0])
            link.add_joint(name=joint.name, type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 0, 1])
            _give(link, joint.body)
            carriers.append(link)
        for cylinder in truth.cylinders:
            a, alpha = truth.seat(cylinder.joint)
            x, y = cylinder.barrel_pin
            barrel = carriers[cylinder.joint].add_body(
                name=f"{cylinder.name}.barrel", pos=[a + x, y * np.cos(alpha), y * np.sin(alpha)],
                quat=[np.cos(alpha / 2), np.sin(alpha / 2), 0, 0])
            barrel.add_joint(name=f"{cylinder.name}.barrel", type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 0, 1])
            _give(barrel, cylinder.barrel_body)
            rod = barrel.add_body(name=f"{cylinder.name}.rod")
            rod.add_joint(name=f"{cylinder.name}.rod", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[1, 0, 0])
            _give(rod, cylinder.rod_body)
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)

    def _place(self, name: str) -> int:
        return int(self.model.jnt_dofadr[mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_JOINT, name)])

    def efforts(self, q: Array, qd: Array, qdd: Array, base: Array | None = None) -> tuple[Array, Array, Array]:
        """Efforts without friction (N, n) of drives and cylinders by joint, levers (N, n) and the base's moment (N,).

        Levers are the cylinders' speeds per joint speed, 1 of drives. `base` (N, 3) is the turn of the base with its
        derivatives.
        """
        count, n = q.shape
        where = [self._place(joint.name) for joint in self.truth.joints]
        states = np.zeros((3, count, self.model.nv))
        for own, values in zip(states, (q, qd, qdd), strict=True):
            own[:, where] = values
        if base is not None:
            states[:, :, self._place("base")] = base.T
        slopes, levers = [], np.ones((count, n))
        for each in self.truth.cylinders:
            length, turn = self.triangle(each, q[:, each.joint])
            at = self._place(f"{each.name}.rod"), self._place(f"{each.name}.barrel")
            for place, (value, first, second) in zip(at, (length, turn), strict=True):
                speed, acceleration = qd[:, each.joint], qdd[:, each.joint]
                states[0, :, place] = value
                states[1, :, place] = first * speed
                states[2, :, place] = second * speed**2 + first * acceleration
                slopes.append((each.joint, place, first))
            levers[:, each.joint] = length[1]
        forces = np.empty((count, self.model.nv))
        for k in range(count):
            self.data.qpos, self.data.qvel, self.data.qacc = states[:, k]
            mujoco.mj_inverse(self.model, self.data)
            forces[k] = self.data.qfrc_inverse
        work = forces[:, where].copy()
        for joint, place, slope in slopes:
            work[:, joint] += slope * forces[:, place]
        return work / levers, levers, forces[:, self._place("base")]

    def triangle(self, cylinder: Cylinder, q: Array) -> tuple[tuple[Array, Array, Array], tuple[Array, Array, Array]]:
        """Length and turn of a cylinder, each with its first two derivatives by the joint's angle."""
        (x, y), barrel = cylinder.rod_pin, np.array(cylinder.barrel_pin)
        cos, sin = np.cos(q), np.sin(q)
        pin = np.stack([x * cos - y * sin, x * sin + y * cos])
        first, reach = np.stack([-pin[1], pin[0]]), pin - barrel[:, None]
        second = -pin
        length = np.hypot(*reach)
        along, across = reach / length, np.stack([-reach[1], reach[0]]) / length
        d_length, d_turn = np.sum(along * first, axis=0), np.sum(across * first, axis=0) / length
        dd_length = np.sum(along * second, axis=0) + length * d_turn**2
        dd_turn = (np.sum(across * second, axis=0) - 2 * d_length * d_turn) / length
        return (length, d_length, dd_length), (np.arctan2(reach[1], reach[0]), d_turn, dd_turn)


def _give(body: mujoco.MjsBody, own: Body) -> None:
    body.mass, body.ipos, body.inertia, body.explicitinertial = own.m, own.com, own.inertia, True


@lru_cache(maxsize=64)
def plant(truth: Truth, tilt: float = 0.0) -> Plant:
    """The same, once for a machine."""
    return Plant(truth, tilt)
