"""A machine with loops as MuJoCo sees it: a cut tree of hinges and slides, and pins that hold its cut ends together.

Each cylinder is a barrel on a hinge and a rod that slides in it; its rod's pin closes one more loop. Where the tree
stands, moves and accelerates follows from these pins alone, by Newton's method on MuJoCo's own positions and
Jacobians, along a way from the stated posture. Actuator and pin forces then are the solution of one linear system.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product
from typing import NamedTuple

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from hydroopt.machine.actuators import Cylinder
from hydroopt.machine.links import Link
from hydroopt.machine.machine import BASE, Machine
from oracles.mujoco_tree import _give_mass

STEPS = 12
NEGLIGIBLE = 1e-9 * np.array([1.0, 0, 0, 0, 1, 0, 0, 1, 0, 1])
"""φ of what has no body: MuJoCo moves nothing without mass."""


FLOATING = ("barrel_x", "barrel_y", "barrel_z", "barrel_turn", "barrel")
"""Joints of a barrel that only pins hold."""


def in_space(machine: Machine, cylinder: Cylinder) -> bool:
    """Whether a cylinder moves in no plane, as those of a platform."""
    return any(machine.main_joint(cylinder) in group for group in machine.entangled)


class Pin(NamedTuple):
    """Two points, each fixed to a body, that are one, or that a rod of a length keeps apart."""

    bodies: tuple[str, str]
    points: tuple[np.ndarray, np.ndarray]
    length: float | None = None


class MujocoLoops:
    """Links, barrels and rods with the bodies `clouds` (owner → φ), and springs (stiffness and preload by owner)."""

    def __init__(self, machine: Machine, clouds: dict[str, np.ndarray],
                 springs: Mapping[str, tuple[float, float]] | None = None) -> None:
        self.machine = machine
        spec = mujoco.MjSpec()
        spec.compiler.degree = False
        spec.option.gravity = [0, 0, -machine.gravity]
        spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
        tilt = Rotation.from_euler("xyz", machine.orientation)
        self.bodies = {BASE: spec.worldbody.add_body(name=BASE, quat=tilt.as_quat(scalar_first=True))}
        self.pins: list[Pin] = []
        for link in machine.links:
            start, turn = self._seat(link)
            body = self.bodies[link.parent].add_body(
                name=link.name, pos=start + turn.apply([0, 0, link.joint.d]),
                quat=(turn * Rotation.from_euler("z", link.joint.theta)).as_quat(scalar_first=True))
            self.bodies[link.name] = body
            if link.joint.moving:
                slides = link.joint.type == "prismatic"
                body.add_joint(name=link.name, axis=[0, 0, 1],
                               type=mujoco.mjtJoint.mjJNT_SLIDE if slides else mujoco.mjtJoint.mjJNT_HINGE)
            _give_mass(body, clouds.get(link.name, NEGLIGIBLE))
        for loop in machine.loops:
            far = (machine.link(loop.link).joint.a, 0, 0) if loop.pin is None else loop.pin
            self.pins.append(Pin((loop.link, loop.to.link), (np.array(far), np.array(loop.to.pin)), loop.length))
        for cylinder in machine.cylinders:
            self._cylinder(cylinder, clouds)
        for owner, (stiffness, preload) in (springs or {}).items():
            self._spring(spec, owner, stiffness, preload)
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self.given = [self._dof(joint) for joint in machine.joints]
        self.free = [k for k in range(self.model.nv) if k not in self.given]
        driven = [self._dof(f"{a.name}.rod" if isinstance(a, Cylinder) else a.joint) for a in machine.actuators]
        self.actuated = np.eye(self.model.nv)[:, driven]

    def _seat(self, link: Link) -> tuple[np.ndarray, Rotation]:
        """Where a link's joint sits in its parent's frame."""
        if link.pin is not None:
            return np.array(link.pin), Rotation.identity()
        if link.parent == BASE:
            return np.zeros(3), Rotation.identity()
        before = self.machine.link(link.parent).joint
        return np.array([before.a, 0, 0]), Rotation.from_euler("XY", [before.alpha, before.beta])

    def _cylinder(self, cylinder: Cylinder, clouds: dict[str, np.ndarray]) -> None:
        barrel = self._floating(cylinder) if in_space(self.machine, cylinder) else self._turning(cylinder)
        rod = barrel.add_body(name=f"{cylinder.name}.rod")
        rod.add_joint(name=f"{cylinder.name}.rod", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[1, 0, 0])
        for end, body in (("barrel", barrel), ("rod", rod)):
            _give_mass(body, clouds.get(f"{cylinder.name}.{end}", NEGLIGIBLE))
        self.pins.append(Pin((f"{cylinder.name}.rod", cylinder.rod.link), (np.zeros(3), np.array(cylinder.rod.pin))))

    def _floating(self, cylinder: Cylinder) -> mujoco.MjsBody:
        """A barrel that moves freely in the seat of the joint that orients it, but turns about this joint's axis and an
        axis across only; its pin holds it."""
        axis = self.machine.link(self.machine.axis_of(cylinder))
        start, turn = self._seat(axis)
        barrel = self.bodies[axis.parent].add_body(name=f"{cylinder.name}.barrel", pos=start,
                                                   quat=turn.as_quat(scalar_first=True))
        for name, kind, way in zip(FLOATING, (mujoco.mjtJoint.mjJNT_SLIDE,) * 3 + (mujoco.mjtJoint.mjJNT_HINGE,) * 2,
                                   ([1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, 1], [0, 1, 0]), strict=True):
            barrel.add_joint(name=f"{cylinder.name}.{name}", type=kind, axis=way)
        self.pins.append(Pin((f"{cylinder.name}.barrel", cylinder.barrel.link),
                             (np.zeros(3), np.array(cylinder.barrel.pin))))
        return barrel

    def _turning(self, cylinder: Cylinder) -> mujoco.MjsBody:
        # the barrel turns about an axis parallel to that of the next joint towards the rod
        after = next((name for name in self.machine.ancestry(cylinder.rod.link)
                      if self.machine.link(name).parent == cylinder.barrel.link), None)
        turn = self._seat(self.machine.link(after))[1] if after else Rotation.identity()  # between branches: of a plane
        if after and self.machine.link(after).joint.type == "prismatic":  # then about the x axis of the joint's frame
            turn *= (Rotation.from_euler("z", self.machine.link(after).joint.theta)
                     * Rotation.from_matrix([[0, 0, 1], [0, -1, 0], [1, 0, 0]]))
        barrel = self.bodies[cylinder.barrel.link].add_body(name=f"{cylinder.name}.barrel", pos=cylinder.barrel.pin,
                                                            quat=turn.as_quat(scalar_first=True))
        barrel.add_joint(name=f"{cylinder.name}.barrel", type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 0, 1])
        return barrel

    def _spring(self, spec: mujoco.MjSpec, owner: str, stiffness: float, preload: float) -> None:
        between = next((each for each in self.machine.springs if each.name == owner), None)
        if between is None:
            stated, joint = self.machine.link(owner).joint.spring, spec.joint(owner)
            assert stated is not None
            joint.stiffness[0], joint.springref = stiffness, stated.reference - preload / stiffness
            return
        tendon = spec.add_tendon(name=owner)
        tendon.stiffness[0], tendon.springlength = stiffness, [between.reference_length - preload / stiffness] * 2
        for end in (between.barrel, between.rod):
            name = f"{owner} at {end.link}"
            self.bodies[end.link].add_site(name=name, pos=end.pin)
            tendon.wrap_site(name)

    def _dof(self, joint: str) -> int:
        return int(self.model.joint(joint).dofadr[0])

    def _closure(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Gaps (3k,) of all pins, their Jacobian, and its derivative in time."""
        gaps, rows, rates = [np.zeros(0)], [np.zeros((0, self.model.nv))], [np.zeros((0, self.model.nv))]
        for pin in self.pins:
            places, jacobians, changes = [], [], []
            for name, local in zip(pin.bodies, pin.points, strict=True):
                body = self.model.body(name).id
                place = self.data.xpos[body] + self.data.xmat[body].reshape(3, 3) @ local
                jacobian, change = np.zeros((3, self.model.nv)), np.zeros((3, self.model.nv))
                mujoco.mj_jac(self.model, self.data, jacobian, None, place, body)
                mujoco.mj_jacDot(self.model, self.data, change, None, place, body)
                places.append(place)
                jacobians.append(jacobian)
                changes.append(change)
            gap, row, change = (parts[1] - parts[0] for parts in (places, jacobians, changes))
            if pin.length is not None:
                speed = row @ self.data.qvel
                gap, row, change = (np.atleast_1d((gap @ gap - pin.length**2) / 2), (gap @ row)[None],
                                    (gap @ change + speed @ row)[None])
            for made, part in ((gaps, gap), (rows, row), (rates, change)):
                made.append(part)
        for coupling in self.machine.couplings:
            row = np.zeros((1, self.model.nv))
            row[0, self._dof(coupling.joint)] = 1
            for joint, ratio in coupling.ratios.items():
                row[0, self._dof(joint)] -= ratio
            gaps.append(row @ self.data.qpos - coupling.offset)
            rows.append(row)
            rates.append(0 * row)
        return np.concatenate(gaps), np.vstack(rows), np.vstack(rates)

    def _forward(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        mujoco.mj_fwdPosition(self.model, self.data)
        mujoco.mj_fwdVelocity(self.model, self.data)
        return self._closure()

    def _close(self) -> bool:
        """Newton's method on the pins' gaps, to rounding."""
        if not self.pins and not self.machine.couplings:
            return True
        for _ in range(30):
            gap, rows, _ = self._forward()
            step = np.linalg.lstsq(rows[:, self.free], -gap, rcond=1e-9)[0]
            self.data.qpos[self.free] += step
            if np.max(np.abs(step)) < 1e-14:
                break
        return bool(np.max(np.abs(self._forward()[0])) < 1e-12)

    def posture(self) -> np.ndarray:
        """Independent joints (n,) in the middle of their ranges, or in the postures of loops, with all pins closed."""
        q = {name: sum(self.machine.link(name).joint.range) / 2 for name in self.machine.joints}
        known: dict[str, float] = {}
        for loop in self.machine.loops:
            known |= loop.posture
        q |= {joint: value for joint, value in known.items() if joint in q}
        self.data.qpos[:] = 0
        self.data.qvel[:] = 0
        for joint, value in (q | known).items():
            self.data.qpos[self._dof(joint)] = value
        tree = [self._dof(joint) for joint in self.machine.tree_joints]
        every, self.pins = self.pins, self.pins[:len(self.machine.loops)]
        free, self.free = self.free, [k for k in self.free if k in tree]
        coupled = {coupling.joint for coupling in self.machine.couplings}
        unstated = [self._dof(joint) for joint in self.machine.tree_joints if joint not in q | known
                    and joint not in coupled]
        begin = self.data.qpos.copy()
        found: list[tuple[float, np.ndarray]] = []
        for guess in product(np.linspace(-3, 3, 7), repeat=len(unstated)):
            self.data.qpos[:] = begin
            self.data.qpos[unstated] = guess
            if self._close():
                moved = (self.data.qpos - begin)[[self._dof(joint) for joint in known]]
                away = float(np.max(np.abs(np.angle(np.exp(1j * moved))), initial=0.0))
                found.append((away, self.data.qpos.copy()))
        away, nearest = min(found, key=lambda each: each[0], default=(np.inf, begin))
        assert away < 0.4, "no posture closes the loops near the stated one"
        self.data.qpos[:] = nearest
        self.pins, self.free = every, free
        for cylinder in self.machine.cylinders:
            self._aim(cylinder)
        assert self._close()
        return np.array(list(q.values()))

    def _aim(self, cylinder: Cylinder) -> None:
        """Turn a barrel towards the pin of its rod, and pull the rod there."""
        mujoco.mj_kinematics(self.model, self.data)
        target = self._place(cylinder.rod.link, cylinder.rod.pin)
        if in_space(self.machine, cylinder):
            barrel = self.model.body(f"{cylinder.name}.barrel").id
            turn, away = self.data.xmat[barrel].reshape(3, 3).T, self._place(cylinder.barrel.link, cylinder.barrel.pin)
            x, y, z = turn @ (target - away)
            values = (*(turn @ (away - self.data.xpos[barrel])), np.arctan2(y, x), -np.arctan2(z, np.hypot(x, y)))
            for name, value in zip(FLOATING, values, strict=True):
                self.data.qpos[self._dof(f"{cylinder.name}.{name}")] = value
            self.data.qpos[self._dof(f"{cylinder.name}.rod")] = np.linalg.norm(target - away)
            return
        barrel = self.model.body(f"{cylinder.name}.barrel").id
        seen = self.data.xmat[barrel].reshape(3, 3).T @ (target - self.data.xpos[barrel])
        self.data.qpos[self._dof(f"{cylinder.name}.barrel")] += np.arctan2(seen[1], seen[0])
        self.data.qpos[self._dof(f"{cylinder.name}.rod")] = np.hypot(seen[0], seen[1])

    def _place(self, link: str, point: tuple[float, ...]) -> np.ndarray:
        body = self.model.body(link).id
        return self.data.xpos[body] + self.data.xmat[body].reshape(3, 3) @ np.array(point)

    def actuator_forces(self, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
        """Forces (n,) that move all bodies."""
        rows = self._inverse(q, qd, qdd)
        both = np.hstack([self.actuated, rows.T])
        found, *_ = np.linalg.lstsq(both, self.data.qfrc_inverse, rcond=1e-11)
        assert np.allclose(both @ found, self.data.qfrc_inverse, rtol=1e-9, atol=1e-6)
        return found[:len(self.machine.actuators)]

    def virtual_work(self, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Generalised forces (n,) that move all bodies, and the actuators' lever arms (a, n): no force of theirs is
        solved for, so that there may be more or fewer of them than joints."""
        rows = self._inverse(q, qd, qdd)
        way = np.zeros((self.model.nv, len(self.given)))
        way[self.given] = np.eye(len(self.given))
        way[self.free] = -np.linalg.lstsq(rows[:, self.free], rows[:, self.given], rcond=1e-9)[0]
        return way.T @ self.data.qfrc_inverse, self.actuated.T @ way

    def _inverse(self, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
        """MuJoCo's inverse dynamics of the cut tree in a state; the Jacobian of the pins there."""
        start = self.posture()
        for left in np.linspace(1, 0, STEPS + 1)[1:]:
            _, rows, _ = self._forward()
            share = 1 - left**2  # bars turn with the root of the distance from a toggle
            change = start + share * (q - start) - self.data.qpos[self.given]
            self.data.qpos[self.given] += change
            # near a toggle the other branch is close: the motion itself is the guess
            follow = np.linalg.lstsq(rows[:, self.free], rows[:, self.given] @ change, rcond=1e-9)[0]
            self.data.qpos[self.free] -= follow
            for cylinder in self.machine.cylinders:
                self._aim(cylinder)
            assert self._close()
        _, rows, _ = self._forward()

        def rest(given: np.ndarray, bias: np.ndarray) -> np.ndarray:
            whole = np.zeros(self.model.nv)
            whole[self.given] = given
            whole[self.free] = np.linalg.lstsq(rows[:, self.free], -bias - rows[:, self.given] @ given, rcond=1e-9)[0]
            return whole

        self.data.qvel[:] = rest(qd, np.zeros(len(rows)))
        _, rows, rates = self._forward()
        self.data.qacc[:] = rest(qdd, rates @ self.data.qvel)
        mujoco.mj_inverse(self.model, self.data)
        return rows

    def tree(self) -> dict[str, float]:
        """Positions of all moving joints."""
        return {joint: float(self.data.qpos[self._dof(joint)]) for joint in self.machine.tree_joints}
