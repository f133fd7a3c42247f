"""Robot files that lack bodies or friction, or have more than a machine takes, and where frames are."""

from __future__ import annotations

import json
import re
from pathlib import Path

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import hydroopt as ho
from hydroopt.errors import MachineError
from hydroopt.machine.machine_file import load_machine
from hydroopt.machine.robot_formats.machine_tree import link_poses
from hydroopt.model.model import Model
from hydroopt.results.machine_diagnostics import machine_diagnostics
from oracles.pinocchio_urdf import PinocchioUrdf
from studies.first_contact.robot_files import WORDS, Case, cases, crane, outcome

CRANE = crane(4)
CASES = [case for suffix in (".urdf", ".xml", ".sdf") for case in cases(CRANE, suffix)]


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_what_a_file_lacks_is_named(case: Case, tmp_path: Path) -> None:
    (tmp_path / case.name).write_text(case.text)
    found = machine_diagnostics(Model(load_machine(tmp_path / case.name)))
    assert {lacks for lacks, words in WORDS.items()
            if any(word in " ".join(map(str, found)) for word in words)} == case.lacks
    assert "bodies" not in case.lacks or set(found[0].subject) == (
        {"reach"} if "one_less" in case.name else {"slew", "lift", "reach"})
    assert "bodies" not in case.lacks or f"<inertial> of {case.name}" in found[0].remedy


STRAY = """<robot name="m"><link name="base">
<inertial><mass value="40"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0"
izz="1"/></inertial></link><inertial><mass value="9"/></inertial><link name="boom"><inertial><origin xyz="1 0 0"/>
<mass value="230"/><inertia ixx="9" ixy="0" ixz="0" iyy="68" iyz="0" izz="70"/></inertial><inertial/></link>
<link name="grab"/><joint name="lift" type="revolute"><parent link="base"/><child link="boom"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1"/><dynamics damping="9"/></joint></robot>""".replace('<link name="grab"/>', "")


def test_what_is_left_out_is_named(tmp_path: Path) -> None:
    """An inertial outside of all links, a link's second one, and the mass of what stands still; a last link without
    length is no mistake."""
    (tmp_path / "m.urdf").write_text(STRAY)
    said = outcome("convert", tmp_path / "m.urdf", tmp_path / "m.toml").said
    assert "the <inertial> in <robot> 'm' behind <link> 'base' is left out: it belongs to no link" in said
    assert "the <inertial> in <link> 'boom' behind <inertial> '' is left out: the link has one already" in said
    assert "the mass of base is left out: it stands still" in said
    assert "!" not in outcome("show", tmp_path / "m.toml").said


def world(rows: list[dict], machine_poses: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Poses (4, 4) of the robot's links by the table of frames and the machine's own frames."""
    found = {}
    for row in rows:
        robots, machines, x, y, z, *angles = row.values()
        frame = np.eye(4)
        frame[:3, :3], frame[:3, 3] = Rotation.from_euler("xyz", angles, degrees=True).as_matrix(), (x, y, z)
        found[robots] = machine_poses[machines] @ np.linalg.inv(frame)
    return found


SLANTED = """<robot name="s"><link name="ground"/><link name="a"/><link name="b"/><link name="c"/><link name="tool"/>
<joint name="one" type="continuous"><parent link="ground"/><child link="a"/>
<origin xyz="0.1 -0.2 0.9" rpy="0.3 0.2 1"/>
<axis xyz="0 0.6 0.8"/></joint>
<joint name="two" type="prismatic"><parent link="a"/><child link="b"/><origin xyz="1 0.3 -0.2" rpy="1.2 -0.4 0.1"/>
<axis xyz="0.6 0 -0.8"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
<joint name="three" type="revolute"><parent link="b"/><child link="c"/><origin xyz="0 0.7 0.1" rpy="-1 0.4 2"/>
<axis xyz="1 0 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
<joint name="flange" type="fixed"><parent link="c"/><child link="tool"/><origin xyz="0.2 0 0.5" rpy="0 1 0"/></joint>
</robot>"""
SLANTED_MJCF = """<mujoco model="s"><compiler angle="radian"/><worldbody>
<body name="a" pos="0.1 -0.2 0.9" euler="0.3 0.2 1">
<joint name="one" type="hinge" axis="0 0.6 0.8" pos="0.1 0 0.2"/><geom size="0.1" contype="0"/>
<body name="b" pos="1 0.3 -0.2" euler="1.2 -0.4 0.1"><joint name="two" type="slide" axis="0.6 0 -0.8" range="-1 1"/>
<geom size="0.1"/><body name="c" pos="0 0.7 0.1" euler="-1 0.4 2"><joint name="three" type="hinge" axis="1 0 0"
range="-1 1"/><geom size="0.1"/></body></body></body></worldbody></mujoco>"""
SLANTED_SDF = """<sdf version="1.9"><model name="s"><frame name="f" attached_to="ground"><pose>0.1 -0.2 0.9 0.3 0.2 1
</pose></frame><link name="ground"/><link name="a"><pose relative_to="f">0.3 0 0.1 0 0.5 0</pose></link>
<link name="b"><pose relative_to="two">0 0 0 0 0 0</pose></link><link name="c"><pose degrees="true">1 2 3 40 50 60
</pose></link><joint name="one" type="revolute"><pose>0.1 0.2 0 0.1 0 0</pose><parent>ground</parent><child>a</child>
<axis><xyz expressed_in="__model__">0 0.6 0.8</xyz></axis></joint><joint name="two" type="prismatic">
<pose relative_to="a">1 0.3 -0.2 1.2 -0.4 0.1</pose><parent>a</parent><child>b</child><axis><xyz>0.6 0 -0.8</xyz><limit>
<lower>-1</lower><upper>1</upper></limit></axis></joint><joint name="three" type="revolute"><parent>b</parent>
<child>c</child><axis><xyz>1 0 0</xyz><limit><lower>-1</lower><upper>1</upper></limit></axis></joint></model></sdf>"""
Q = {"one": 0.7, "two": 0.4, "three": -0.6}


def by_pinocchio(file: Path) -> dict[str, np.ndarray]:
    oracle = PinocchioUrdf(file)
    q = np.array([np.cos(Q["one"]), np.sin(Q["one"]), Q["two"], Q["three"]])  # an endless joint has two numbers
    oracle.state = lambda values: q
    oracle.move(Q)
    return {link: oracle.pose(link) for link in ("a", "b", "c", "tool")}


def by_mujoco(file: Path) -> dict[str, np.ndarray]:
    model = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(model)
    data.qpos[:] = [Q["one"], Q["two"], Q["three"]]
    mujoco.mj_kinematics(model, data)
    found = {}
    for link in "abc":
        found[link] = np.eye(4)
        found[link][:3, :3], found[link][:3, 3] = data.body(link).xmat.reshape(3, 3), data.body(link).xpos
    return found


def by_hand(file: Path) -> dict[str, np.ndarray]:
    """The poses that SLANTED_SDF states, and the joints' motion about and along their axes in the model's frame."""
    def pose(*six: float) -> np.ndarray:
        made = np.eye(4)
        made[:3, :3], made[:3, 3] = Rotation.from_euler("xyz", six[3:]).as_matrix(), six[:3]
        return made

    a = pose(0.1, -0.2, 0.9, 0.3, 0.2, 1) @ pose(0.3, 0, 0.1, 0, 0.5, 0)
    one, b, c = a @ pose(0.1, 0.2, 0, 0.1, 0, 0), a @ pose(1, 0.3, -0.2, 1.2, -0.4, 0.1), pose(
        1, 2, 3, *np.radians([40, 50, 60]))
    turn, slide = np.eye(4), np.eye(4)
    turn[:3, :3] = Rotation.from_rotvec(Q["one"] * np.array([0, 0.6, 0.8])).as_matrix()
    turn[:3, 3] = one[:3, 3] - turn[:3, :3] @ one[:3, 3]
    slide[:3, 3] = Q["two"] * b[:3, :3] @ [0.6, 0, -0.8]
    return {"a": turn @ a, "b": turn @ slide @ b, "c": turn @ slide @ c @ pose(0, 0, 0, Q["three"], 0, 0)}


@pytest.mark.parametrize(("name", "text", "oracle"), [
    ("s.urdf", SLANTED, by_pinocchio), ("s.xml", SLANTED_MJCF, by_mujoco), ("s.sdf", SLANTED_SDF, by_hand),
    ("s.sdf", SLANTED_SDF.replace(' expressed_in="__model__">0 0.6 0.8</xyz>', (  # before 1.7
        ">0 0.6 0.8</xyz><use_parent_model_frame>1</use_parent_model_frame>")), by_hand)])
def test_the_table_of_frames_leads_from_the_machine_to_the_robot(name: str, text: str, oracle, tmp_path: Path) -> None:
    file, machine = tmp_path / name, tmp_path / "s.toml"
    file.write_text(text)
    printed, rows = outcome("convert", file, machine).said.split(), json.loads(
        outcome("show", file, "--frames", "--json").said)
    assert {f"{value:.6g}" for row in rows for value in row.values() if isinstance(value, float)} <= set(printed)
    found = world(rows, link_poses(load_machine(machine), Q))
    for link, expected in oracle(file).items():
        np.testing.assert_allclose(found[link], expected, rtol=0, atol=1e-12)


def test_an_sdf_is_read_as_it_was_written(tmp_path: Path) -> None:
    """The same forces from the SDF and the URDF of a machine, whose reader Pinocchio confirms."""
    for case in (case for case in CASES if "whole" in case.name and not case.name.endswith(".xml")):
        (tmp_path / case.name).write_text(case.text)
    forces = []
    for suffix in ("sdf", "urdf"):
        model = Model(load_machine(tmp_path / f"crane4_whole.{suffix}"))
        forces.append(model.over(model.inverse_dynamics, *np.random.default_rng(1).uniform(-1, 1, (3, 5, 3)),
                                 model.parameters.nominal)[0])
    np.testing.assert_allclose(forces[0], forces[1], rtol=1e-9)


@pytest.mark.parametrize(("old", "new", "words"), [
    ('relative_to="two"', 'relative_to="tow"', "relative to 'tow', which is none of its links"),
    ('type="prismatic"', 'type="screw"', "joints of type 'screw' are not supported"),
    ("<child>b</child>", "<child>d</child>", "its child link 'd' does not exist"),
    ('degrees="true"', 'rotation_format="quat_xyzw"', "its rotation is a quaternion"),
    ("<model name", "<include/><model><link/></model><model name", "2 models")])
def test_what_is_wrong_with_an_sdf_is_named(old: str, new: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "s.sdf").write_text(SLANTED_SDF.replace(old, new))
    with pytest.raises(MachineError, match=words):
        load_machine(tmp_path / "s.sdf")


LINKAGE = """<mujoco><compiler angle="degree"/><worldbody>
<body name="arm" pos="0 0 1"><joint name="arm" axis="0 1 0" range="-60 30"/>
<inertial pos="1 0 0" mass="300" diaginertia="5 90 91"/>
<body name="crank" pos="1 0 0.2"><joint name="crank" axis="0 1 0" range="-30 30"/>
<inertial pos="0 0 0.2" mass="9" diaginertia="1 1.2 0.9"/></body>
<body name="rocker" pos="1.5 0 0.2"><joint name="rocker" axis="0 1 0"/>
<inertial pos="0 0 0.2" mass="9" diaginertia="1 1.2 0.9"/>
<body name="coupler" pos="0 0 0.4"><joint name="coupler" axis="0 1 0"/>
<inertial pos="-0.2 0 0" mass="7" diaginertia="0.5 1 0.9"/></body></body>
<body name="bucket" pos="2.1 0 0.2"><joint name="bucket" axis="0 1 0"/>
<inertial pos="0.2 0 -0.4" mass="150" diaginertia="20 21 22"/>
<body name="side" pos="0 0 0.5"><joint name="side" axis="0 1 0"/>
<inertial pos="-0.3 0 0" mass="8" diaginertia="0.5 1 0.9"/></body></body>
</body></worldbody><equality><connect body1="coupler" body2="crank" anchor="-0.5 0 0.05"/>
<connect body1="side" body2="rocker" anchor="-0.6 0 -0.1"/></equality>
<actuator><motor joint="arm"/><motor joint="crank"/></actuator></mujoco>"""


@pytest.mark.parametrize("swapped", [False, True])
def test_loops_that_share_a_joint_are_stated_as_they_are_read(swapped: bool, tmp_path: Path) -> None:
    """A bucket linkage: the second loop begins at the rocker that the first one determines, in either order."""
    text = re.sub(r"(<connect.*?/>)\s*(<connect.*?/>)", r"\2\1", LINKAGE) if swapped else LINKAGE
    (tmp_path / "linkage.xml").write_text(text)
    machine = load_machine(tmp_path / "linkage.xml")
    assert machine.joints == ("arm", "crank")
    oracle = mujoco.MjModel.from_xml_path(str(tmp_path / "linkage.xml"))
    data, positions = mujoco.MjData(oracle), Model(machine).dependent_positions
    for crank in (-0.3, 0.0, 0.4):
        dependent = np.array(positions([0.1, crank])[0])[:, 0]
        for joint, value in {"arm": 0.1, "crank": crank, **dict(
                zip(machine.dependent_joints, dependent, strict=True))}.items():
            data.joint(joint).qpos[:] = value
        mujoco.mj_forward(oracle, data)
        closed = data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY
        assert np.count_nonzero(closed) == 6
        assert np.max(np.abs(data.efc_pos[closed])) < 1e-9


def test_an_actuator_that_reads_zero_throughout_is_no_error(tmp_path: Path) -> None:
    """A joint that carries no mass needs no torque, and no size of a fault shows there."""
    (tmp_path / "light.urdf").write_text("""<robot name="light"><link name="base"/><link name="b"/>
      <link name="chassis"><inertial><mass value="5"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>
      </inertial></link><joint name="j1" type="revolute"><parent link="base"/><child link="chassis"/><axis xyz="0 0 1"/>
      <limit lower="-1" upper="1" effort="10" velocity="1"/></joint><joint name="j2" type="revolute">
      <parent link="chassis"/><child link="b"/><origin xyz="1 0 0"/><axis xyz="0 1 0"/>
      <limit lower="-1" upper="1" effort="10" velocity="1"/></joint></robot>""")
    machine = load_machine(tmp_path / "light.urdf")
    log = ho.simulate(machine, ho.random_trajectory(machine, duration=10.0, rate=50.0, seed=0), seed=0)
    answer = ho.solve(ho.identification_problem(machine, [log]))
    assert answer.status in ("ok", "suspect")
    assert answer.diagnostics
