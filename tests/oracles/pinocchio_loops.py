"""A machine with loops as Pinocchio sees it: accelerations by its constrained dynamics, at a state from MuJoCo's pins.

The tree is cut where `MujocoLoops` cuts it, and built here from the machine's numbers a second time. Accelerations
follow from actuator forces: the way round that `inverse_dynamics` does not take. It has no rods of a fixed length.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from hydroopt.machine.actuators import Cylinder
from hydroopt.machine.links import Link
from hydroopt.machine.loops import Coupling
from hydroopt.machine.machine import BASE, Machine
from oracles.mujoco_loops import FLOATING, NEGLIGIBLE, MujocoLoops, in_space
from oracles.pinocchio_tree import _inertia, _shift, _turn


class PinocchioLoops:
    """Links, barrels and rods with the bodies `clouds` (owner → φ)."""

    def __init__(self, machine: Machine, clouds: dict[str, np.ndarray]) -> None:
        self.machine, self.clouds = machine, clouds
        self.model = pin.Model()
        self.model.gravity.linear = np.array([0, 0, -machine.gravity])
        tilt = pin.SE3.Identity()
        for axis, angle in enumerate(machine.orientation):
            tilt = _turn(angle, axis) * tilt
        self.places = {BASE: (0, tilt)}
        self.ends = dict(self.places)
        self._carried_by(BASE)
        self.pins = pin.StdVec_RigidConstraintModel()
        for loop in machine.loops:
            far = (machine.link(loop.link).joint.a, 0, 0) if loop.pin is None else loop.pin
            self._close(self._at(loop.link, far), self._at(loop.to.link, loop.to.pin))
        for cylinder in machine.cylinders:
            if in_space(machine, cylinder):
                self._close(self.places[f"{cylinder.name}.barrel"], self._at(cylinder.barrel.link, cylinder.barrel.pin))
            self._close(self.places[f"{cylinder.name}.rod"], self._at(cylinder.rod.link, cylinder.rod.pin))
        self.data = self.model.createData()
        self.pin_data = pin.StdVec_RigidConstraintData()
        self.pin_data.extend(each.createData() for each in self.pins)
        pin.initConstraintDynamics(self.model, self.data, self.pins, self.pin_data)

    def _carried_by(self, link: str) -> None:
        """Add what hangs on a link, branch by branch: Pinocchio wants the joints of each branch in a row."""
        for cylinder in self.machine.cylinders:
            if in_space(self.machine, cylinder):
                if self.machine.link(self.machine.axis_of(cylinder)).parent == link:
                    self._floating(cylinder)
            elif cylinder.barrel.link == link:
                self._cylinder(cylinder)
        for child in self.machine.links:
            if child.parent == link:
                self._link(child)
                self._carried_by(child.name)

    def _link(self, link: Link) -> None:
        j = link.joint
        joint, place = self.ends[link.parent] if link.pin is None else self._at(link.parent, link.pin)
        place = place * _shift((0, 0, j.d)) * _turn(j.theta, 2)
        if j.moving:
            kind = pin.JointModelPZ() if j.type == "prismatic" else pin.JointModelRZ()
            joint, place = self.model.addJoint(joint, kind, place, link.name), pin.SE3.Identity()
        self._place(link.name, joint, place)
        self.ends[link.name] = joint, place * _shift((j.a, 0, 0)) * _turn(j.alpha, 0) * _turn(j.beta, 1)

    def _cylinder(self, cylinder: Cylinder) -> None:
        # the barrel turns about an axis parallel to that of the next joint towards the rod
        after = next((link for link in map(self.machine.link, self.machine.ancestry(cylinder.rod.link))
                      if link.parent == cylinder.barrel.link), None)  # none between branches that move in one plane
        joint, place = self._at(cylinder.barrel.link, cylinder.barrel.pin)
        if after and after.pin is None and after.parent != BASE:
            before = self.machine.link(after.parent).joint
            place = place * _turn(before.alpha, 0) * _turn(before.beta, 1)
        if after and after.joint.type == "prismatic":  # its axis is then the x axis of the joint's frame
            place = place * _turn(after.joint.theta, 2) * _turn(np.pi, 2) * _turn(-np.pi / 2, 1)
        for end, kind in (("barrel", pin.JointModelRZ()), ("rod", pin.JointModelPX())):
            name = f"{cylinder.name}.{end}"
            joint, place = self.model.addJoint(joint, kind, place, name), pin.SE3.Identity()
            self._place(name, joint, place)

    def _floating(self, cylinder: Cylinder) -> None:
        axis = self.machine.link(self.machine.axis_of(cylinder))
        joint, place = self.ends[axis.parent] if axis.pin is None else self._at(axis.parent, axis.pin)
        kinds = (pin.JointModelPX(), pin.JointModelPY(), pin.JointModelPZ(), pin.JointModelRZ(), pin.JointModelRY())
        for name, kind in (*zip(FLOATING, kinds, strict=True), ("rod", pin.JointModelPX())):
            joint, place = self.model.addJoint(joint, kind, place, f"{cylinder.name}.{name}"), pin.SE3.Identity()
            if name in ("barrel", "rod"):
                self._place(f"{cylinder.name}.{name}", joint, place)

    def _place(self, name: str, joint: int, place: pin.SE3) -> None:
        self.places[name] = joint, place
        self.model.appendBodyToJoint(joint, _inertia(self.clouds.get(name, NEGLIGIBLE)), place)

    def _at(self, link: str, point: tuple[float, ...]) -> tuple[int, pin.SE3]:
        joint, place = self.places[link]
        return joint, place * _shift(point)

    def _close(self, one: tuple[int, pin.SE3], other: tuple[int, pin.SE3]) -> None:
        self.pins.append(pin.RigidConstraintModel(pin.ContactType.CONTACT_3D, self.model, *one, *other,
                                                  pin.ReferenceFrame.LOCAL))

    def accelerations(self, at: MujocoLoops, actuator_forces: np.ndarray,
                      joint_forces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Accelerations of all joints that forces of actuators and joints cause, and those that MuJoCo's state has."""
        names = [self.model.names[k] for k in range(1, self.model.njoints)]
        dofs = [at.model.joint(name).dofadr[0] for name in names]
        q, v, expected = (array[dofs].copy() for array in (at.data.qpos, at.data.qvel, at.data.qacc))
        drive = dict.fromkeys(names, 0.0) | dict(zip(self.machine.joints, joint_forces, strict=True))
        for actuator, force in zip(self.machine.actuators, actuator_forces, strict=True):
            drive[f"{actuator.name}.rod" if isinstance(actuator, Cylinder) else actuator.joint] += force
        torques = np.array([drive[name] for name in names])
        found = self._moved(q, v, torques)
        if rows := [self._row(coupling, names) for coupling in self.machine.couplings]:
            # accelerations are linear in the forces of couplings, which leave none along their rows
            held = np.array(rows)
            by_force = np.array([self._moved(q, v, torques + row) - found for row in held]).T
            found = self._moved(q, v, torques - held.T @ np.linalg.solve(held @ by_force, held @ found))
        return found, expected

    def _row(self, coupling: Coupling, names: list[str]) -> np.ndarray:
        """What a coupling keeps at zero of all joints' accelerations."""
        row = np.zeros(len(names))
        row[names.index(coupling.joint)] = 1
        for joint, ratio in coupling.ratios.items():
            row[names.index(joint)] -= ratio
        return row

    def _moved(self, q: np.ndarray, v: np.ndarray, torques: np.ndarray) -> np.ndarray:
        # pins hold twice what is in no plane: the proximal term decides how they share it
        near = pin.ProximalSettings(1e-12, 1e-12, 1e-8, 100)
        return pin.constraintDynamics(self.model, self.data, q, v, torques, self.pins, self.pin_data, near).copy()
