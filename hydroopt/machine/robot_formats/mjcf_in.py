"""MJCF files, as MuJoCo compiles them, to the tree of their bodies and joints."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hydroopt.errors import MachineError
from hydroopt.machine.robot_formats.frames import CentralInertia, from_quaternion, pose, shift, turn_about
from hydroopt.machine.robot_formats.tree import Mimic, RobotTree, Spring, TreeJoint, TreePin, one_tree
from hydroopt.machine.robot_formats.xml_in import robot_element
from hydroopt.spatial.inertia import Array
from hydroopt.support.packages import needed

if TYPE_CHECKING:
    import mujoco

NEGLIGIBLE = 1e-9
"""Mass [kg] of a body that stands for none: MuJoCo moves nothing without mass."""


def read_mjcf(path: str | Path) -> RobotTree:
    """Bodies, joints and equality constraints of an MJCF file, with all defaults and included files as MuJoCo has them.

    A connection closes a loop, and an equation between two joints lets one mimic the other. A joint that no actuator
    drives is passive. A free joint stands still: the machine's base is the world.

    Raises:
        MachineError: MuJoCo is not installed, cannot compile the file, or the robot has ball joints.
    """
    file = str(path)
    robot_element(file, "mujoco", "MJCF")
    mujoco = needed("mujoco", "MJCF files are read with MuJoCo", where=file, error=MachineError)
    try:
        spec = mujoco.MjSpec.from_file(file)
        spec.compiler.boundmass = max(spec.compiler.boundmass, NEGLIGIBLE)  # what states no body is none, not an error
        spec.compiler.boundinertia = max(spec.compiler.boundinertia, 10 * mujoco.mjMINVAL)
        model = spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        raise MachineError(f"MuJoCo cannot compile it ({str(error).splitlines()[0]:.200})", where=file,
                           remedy="correct that, or give the meshes that it names") from None
    return _Reader(mujoco, model, file).tree()


class _Reader:
    def __init__(self, library: Any, model: mujoco.MjModel, file: str) -> None:
        self.mujoco, self.model, self.file = library, model, file
        self.bodies = [model.body(k).name or f"body{k}" for k in range(model.nbody)]
        self.names = [model.joint(k).name or f"{self.bodies[model.jnt_bodyid[k]]}_joint{k}" for k in range(model.njnt)]
        self.lost: list[str] = []
        self.masses: dict[str, Array | None] = {}
        self.joints: dict[str, TreeJoint] = {}

    def tree(self) -> RobotTree:
        gravity = np.array(self.model.opt.gravity)
        if max(abs(gravity[0]), abs(gravity[1]), gravity[2]) > 1e-9:
            raise MachineError(f"gravity is {gravity}, but a machine's world has its z upwards", where=self.file,
                               remedy="let gravity point along -z, and turn the model instead")
        for body in range(self.model.nbody):
            self._body(body)
        self._driven()
        pins = self._equalities()
        self._left_out()
        found = one_tree(self.file, re.sub(r"^MuJoCo Model$", Path(self.file).stem, self._model_name()), self.masses,
                         self.joints.values(), tuple(self.lost))
        return found._replace(pins=tuple(pins), posture=self._posture(), gravity=float(-gravity[2]))

    def _model_name(self) -> str:
        return self.model.names[:self.model.names.index(b"\0")].decode() or Path(self.file).stem

    def _body(self, body: int) -> None:
        model, name = self.model, self.bodies[body]
        m = float(model.body_mass[body])
        principal = np.diag(model.body_inertia[body])
        turned = from_quaternion(model.body_iquat[body])
        tensor = turned @ principal @ turned.T
        self.masses[name] = None if m <= NEGLIGIBLE else CentralInertia(
            m, np.array(model.body_ipos[body]), tensor[np.triu_indices(3)]).pseudo()
        if body == 0:
            return
        parent = self.bodies[model.body_parentid[body]]
        at = pose(from_quaternion(model.body_quat[body]), model.body_pos[body])
        of = [int(model.body_jntadr[body]) + k for k in range(model.body_jntnum[body])]
        if any(int(model.jnt_type[k]) == self.mujoco.mjtJoint.mjJNT_FREE for k in of):
            self.lost.append(f"the free joint of '{name}' stands still")
            of = []
        weld = f"{name}.weld" if name in self.names else name
        if not of:
            self.joints[weld] = TreeJoint(name=weld, kind="fixed", parent=parent, child=name, origin=at)
            return
        here = np.zeros(3)
        for count, k in enumerate(of, start=1):
            place = np.array(model.jnt_pos[k])
            last = count == len(of) and not np.any(place)
            child = name if last else f"{self.names[k]}.moved"
            self.masses.setdefault(child, None)
            self.joints[self.names[k]] = self._joint(k, parent, child, at @ shift(place - here))
            parent, at, here = child, np.eye(4), place
        if parent != name:
            self.joints[weld] = TreeJoint(name=weld, kind="fixed", parent=parent, child=name, origin=shift(-here))

    def _joint(self, k: int, parent: str, child: str, at: Array) -> TreeJoint:
        model, name = self.model, self.names[k]
        slides = int(model.jnt_type[k]) == self.mujoco.mjtJoint.mjJNT_SLIDE
        if int(model.jnt_type[k]) == self.mujoco.mjtJoint.mjJNT_BALL:
            raise MachineError("ball joints are not supported", where=f"{self.file}: joint '{name}'",
                               remedy="state three hinges")
        axis, dof, adr = np.array(model.jnt_axis[k]), model.jnt_dofadr[k], model.jnt_qposadr[k]
        rest = -float(model.qpos0[adr])  # the file describes the body where the joint is at its reference
        back = shift(rest * axis) if slides else pose(turn_about(axis, rest))
        limited = bool(model.jnt_limited[k])
        stiffness = float(np.ravel(model.jnt_stiffness[k])[0])
        return TreeJoint(
            name=name, kind="prismatic" if slides else "revolute", parent=parent, child=child, origin=at @ back,
            axis=axis, lower=float(model.jnt_range[k, 0]) if limited else None,
            upper=float(model.jnt_range[k, 1]) if limited else None, endless=not limited and not slides,
            max_effort=float(model.jnt_actfrcrange[k, 1]) if model.jnt_actfrclimited[k] else None,
            viscous=float(np.ravel(model.dof_damping[dof])[0]), coulomb=float(model.dof_frictionloss[dof]),
            rotor_inertia=float(model.dof_armature[dof]),
            spring=Spring(stiffness, float(model.qpos_spring[adr])) if stiffness else None)

    def _change(self, name: str, **values: Any) -> None:
        self.joints[name] = replace(self.joints[name], **values)

    def _driven(self) -> None:
        """Which joints actuators drive: all where there are none."""
        model, kinds = self.model, self.mujoco.mjtTrn
        driven: dict[str, float | None] = {}
        for k in range(model.nu):
            kind, target = int(model.actuator_trntype[k]), int(model.actuator_trnid[k, 0])
            gear = abs(float(model.actuator_gear[k, 0]))
            most = gear * float(model.actuator_forcerange[k, 1]) if model.actuator_forcelimited[k] else None
            if kind in (kinds.mjTRN_JOINT, kinds.mjTRN_JOINTINPARENT):
                driven[self.names[target]] = most
            elif kind == kinds.mjTRN_TENDON:
                first, count = model.tendon_adr[target], model.tendon_num[target]
                wraps = [w for w in range(first, first + count)
                         if int(model.wrap_type[w]) == self.mujoco.mjtWrap.mjWRAP_JOINT]
                driven |= {self.names[model.wrap_objid[w]]: None for w in wraps}
        for name, joint in self.joints.items():
            if model.nu and joint.kind != "fixed":
                self._change(name, driven=name in driven)
            if driven.get(name) and joint.max_effort is None:
                self._change(name, max_effort=driven[name])
        if any(int(model.actuator_biastype[k]) != self.mujoco.mjtBias.mjBIAS_NONE for k in range(model.nu)):
            self.lost.append("the control laws of actuators are left out: their forces drive")

    def _equalities(self) -> list[TreePin]:
        model, kinds = self.model, self.mujoco.mjtEq
        pins = []
        for k in range(model.neq):
            if not model.eq_active0[k]:
                continue
            name = model.equality(k).name or f"equality{k}"
            kind, one, other = int(model.eq_type[k]), int(model.eq_obj1id[k]), int(model.eq_obj2id[k])
            if kind == kinds.mjEQ_CONNECT:
                pins.append(self._pin(k, name, one, other))
            elif kind == kinds.mjEQ_JOINT and other >= 0 and not np.any(model.eq_data[k, 2:5]):
                self._mimic(k, self.names[one], self.names[other])
            else:
                self.lost.append(f"the constraint '{name}' does not hold")
        return pins

    def _pin(self, k: int, name: str, one: int, other: int) -> TreePin:
        model = self.model
        if int(model.eq_objtype[k]) == self.mujoco.mjtObj.mjOBJ_SITE:
            bodies = [int(model.site_bodyid[each]) for each in (one, other)]
            points = [np.array(model.site_pos[each]) for each in (one, other)]
        else:
            bodies, points = [one, other], [np.array(model.eq_data[k, :3]), np.array(model.eq_data[k, 3:6])]
        return TreePin(name, (self.bodies[bodies[0]], self.bodies[bodies[1]]), (points[0], points[1]))

    def _mimic(self, k: int, one: str, other: str) -> None:
        """Let one of two joints mimic the other: the one that is not driven."""
        model, first, second = self.model, self.names.index(one), self.names.index(other)
        offset, ratio = float(model.eq_data[k, 0]), float(model.eq_data[k, 1])
        offset += float(model.qpos0[model.jnt_qposadr[first]]) - ratio * float(model.qpos0[model.jnt_qposadr[second]])
        if self.joints[one].driven and not self.joints[other].driven and ratio:
            one, other, offset, ratio = other, one, -offset / ratio, 1 / ratio
        if self.joints[one].mimic is not None:
            self.lost.append(f"'{one}' mimics '{self.joints[one].mimic.master}' alone")  # type: ignore[union-attr]
            return
        self._change(one, mimic=Mimic(other, ratio, offset), driven=False)

    def _left_out(self) -> None:
        model = self.model
        if float(np.max(np.abs(model.body_gravcomp), initial=0.0)):
            self.lost.append("the compensation of gravity is left out")
        if model.opt.density or model.opt.viscosity:
            self.lost.append("the fluid around the robot is left out")
        if model.ngeom:
            self.lost.append(f"{model.ngeom} shapes and their contacts are left out")
        pulled = [k for k in range(model.ntendon) if np.any(model.tendon_stiffness[k])]
        if pulled:
            self.lost.append(f"{len(pulled)} elastic tendons are left out")

    def _posture(self) -> dict[str, float]:
        """Positions of the first key frame, or those in which the file describes the robot."""
        at = self.model.key_qpos[0] if self.model.nkey else self.model.qpos0
        return {name: float(at[self.model.jnt_qposadr[k]]) for k, name in enumerate(self.names)}
