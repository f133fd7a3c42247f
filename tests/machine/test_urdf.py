"""Machines from URDF files: poses and torques against Pinocchio, which reads the same files, and bad files."""

from __future__ import annotations

import math
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from fixtures.tiers import tiered
from hydroopt.errors import MachineError
from hydroopt.machine.geometry import Geometry
from hydroopt.machine.machine import BASE, Machine
from hydroopt.machine.machine_file import dump_machine, load_machine, read_machine
from hydroopt.machine.robot_formats.reading import read_robot
from hydroopt.model.model import Model
from oracles.pinocchio_urdf import PinocchioUrdf

DATA = Path(__file__).parents[3] / "shared" / "data"
PANDA = DATA / "mukca_panda_2/panda.urdf"
TALOS = DATA / "talos_left_arm/urdf/talos_full_v2.urdf"
TRAILBLAZER = DATA / "hilti_flat/trailblazer.urdf"
LIMIT = '<limit lower="-2" upper="1.5" velocity="0.7" effort="9"/>'


def link(name, inertial=""):
    return f'<link name="{name}">{inertial}</link>'


def inertial(m=3.0, xyz="0.1 -0.2 0.3", rpy="0 0 0", six=(0.5, 0.02, -0.03, 0.6, 0.04, 0.7)):
    values = " ".join(f'{key}="{value}"' for key, value in zip(
        ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), six, strict=True))
    return f'<inertial><origin xyz="{xyz}" rpy="{rpy}"/><mass value="{m}"/><inertia {values}/></inertial>'


def joint(name, parent, child, xyz="0 0 0", rpy="0 0 0", axis="0 0 1", kind="revolute", more=LIMIT):
    return (f'<joint name="{name}" type="{kind}"><origin xyz="{xyz}" rpy="{rpy}"/><parent link="{parent}"/>'
            f'<child link="{child}"/><axis xyz="{axis}"/>{more}</joint>')


def chain(*joints, body=""):
    """Text of a URDF: links l0, l1, …, and between them joints j1, j2, … with these settings."""
    names = [link(f"l{k}", body if k else "") for k in range(len(joints) + 1)]
    return "".join(['<robot name="arm">', *names, *(
        joint(f"j{k}", f"l{k - 1}", f"l{k}", **each) for k, each in enumerate(joints, start=1)), "</robot>"])


@pytest.fixture
def write(tmp_path):
    def written(text, name="arm.urdf"):
        path = tmp_path / name
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path
    return written


def matrix(pose):
    return np.block([[np.array(ca.DM(pose.rotation)), np.array(ca.DM(pose.origin)).reshape(3, 1)],
                     [np.zeros((1, 3)), np.ones((1, 1))]])


def positions(machine, rng):
    ranges = [machine.link(name).joint.range for name in machine.joints]
    return dict(zip(machine.joints, (rng.uniform(*limits) for limits in ranges), strict=True))


def moves_alike(machine: Machine, path, tip, held=None, states=4):
    """Every axis, every body and the tip are where Pinocchio has them."""
    oracle, rng = PinocchioUrdf(path, held), np.random.default_rng(5)
    fixed_to = {}
    for k in range(states):
        q = dict.fromkeys(machine.joints, 0.0) if k == 0 else positions(machine, rng)
        q = {name: oracle.position(machine, oracle.named[name], q) for name in machine.tree_joints}
        oracle.move(q)
        for name in machine.tree_joints:
            pose, child = matrix(Geometry(machine).relative_pose(BASE, name, q)), oracle.pose(oracle.children[name])
            axis = child[:3, :3] @ oracle.axes[name] / np.linalg.norm(oracle.axes[name])
            np.testing.assert_allclose(pose[:3, 2], axis, atol=1e-12)
            np.testing.assert_allclose(np.cross(pose[:3, 3] - child[:3, 3], axis), 0, atol=1e-12)
            body = np.linalg.inv(child) @ pose
            np.testing.assert_allclose(body, fixed_to.setdefault(name, body), atol=1e-12)
        last = machine.links[-1]
        end = matrix(Geometry(machine).relative_pose(BASE, last.name, q) @ Geometry(machine).far_end(last.name))
        np.testing.assert_allclose(end[:3, 3], oracle.pose(tip)[:3, 3], rtol=0, atol=1e-12)


def needs_same_torques(machine, path, held=None, states=5):
    model, oracle, rng = Model(machine), PinocchioUrdf(path, held), np.random.default_rng(8)
    for _ in range(states):
        q = list(positions(machine, rng).values())
        qd, qdd = rng.uniform(-2, 2, (2, len(q)))
        expected = oracle.torques(machine, q, qd, qdd)
        found = np.array(model.inverse_dynamics(q, qd, qdd, model.parameters.nominal)).ravel()
        np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-10 * np.abs(expected).max())
        still = [np.zeros(len(q))] * 2
        np.testing.assert_allclose(
            np.array(model.inverse_dynamics(q, *still, model.parameters.nominal)).ravel(),
            oracle.torques(machine, q, *still), rtol=1e-10, atol=1e-10 * np.abs(expected).max())


def present(path):
    if not path.exists():
        pytest.skip(f"measured data absent: {path}")
    return path


# --- robots of published data sets


def test_panda():
    machine = load_machine(present(PANDA), tip="ball_link")
    assert machine.joints == tuple(f"panda_joint{k}" for k in range(1, 8))
    assert all(each.body is None for each in machine.links)
    assert machine.link("panda_joint4").joint.range == (-3.0718, -0.0698)
    moves_alike(machine, PANDA, "ball_link")
    # as the maker has it
    published = [(0.333, 0, -90), (0, 0, 90), (0.316, 0.0825, 90), (0, -0.0825, -90), (0.384, 0, 90), (0, 0.088, 90)]
    found = [(each.joint.d, each.joint.a, math.degrees(each.joint.alpha)) for each in machine.links[:6]]
    np.testing.assert_allclose(found, published, atol=1e-12)
    assert not any(each.joint.theta for each in machine.links[:6])


def test_panda_with_its_gripper():
    machine = load_machine(present(PANDA))
    assert machine.joints[-1] == "panda_finger_joint1"
    assert machine.link("panda_finger_joint1").joint.type == "prismatic"
    assert machine.dependent_joints == ("panda_finger_joint2",)
    assert machine.couplings[0].ratios == {"panda_finger_joint1": 1.0}
    moves_alike(machine, PANDA, "panda_rightfinger")


@pytest.mark.parametrize(("tip", "joints"), [("arm_left_7_link", 9), ("wrist_left_ft_tool_link", 9),
                                             ("arm_left_4_link", 6), ("left_sole_link", 6), ("rgbd_link", 4)])
def test_talos(tip, joints):
    machine = load_machine(present(TALOS), tip=tip)
    assert len(machine.joints) == joints
    moves_alike(machine, TALOS, tip)


def test_bodies_of_talos():
    machine = load_machine(present(TALOS), tip="arm_left_7_link")
    needs_same_torques(machine, TALOS)


@pytest.mark.slow
def test_trailblazer():
    machine = load_machine(present(TRAILBLAZER), tip="drill_tip")
    assert machine.joints == tuple(f"dsr_joint{k}" for k in range(1, 7))
    assert machine.links[0].joint.type == "locked"
    assert "column_middle_joint" in machine.description
    held = {"column_middle_joint": -0.706, "column_top_joint": -0.736}
    moves_alike(machine, TRAILBLAZER, "drill_tip", held)
    needs_same_torques(machine, TRAILBLAZER, held)
    moves_alike(load_machine(TRAILBLAZER, tip="column_pseudo_tip"), TRAILBLAZER, "column_pseudo_tip")
    whole = load_machine(TRAILBLAZER)
    assert "column_middle_joint" in whole.dependent_joints
    moves_alike(whole, TRAILBLAZER, "prism")
    needs_same_torques(whole, TRAILBLAZER)


# --- made-up ones

SHIFTED = {"xyz": "0.3 -0.2 0.5"}
CHAINS = {
    "one joint": [{}],
    "axes of all directions": [{"axis": axis} | SHIFTED for axis in
                               ("1 0 0", "0 1 0", "0 0 -1", "0 -1 0", "-1 0 0", "0 0 1", "0.3 -2 0.7")],
    "parallel": [SHIFTED, SHIFTED, {"xyz": "0 0 0.4"}, {"xyz": "0.4 0 0", "rpy": "0 0 1.1"}, SHIFTED],
    "turned over": [SHIFTED, {"axis": "0 0 -1"} | SHIFTED, {"rpy": "3.141592653589793 0 0"} | SHIFTED, SHIFTED],
    "intersecting": [{"axis": "0 1 0", "xyz": "0 0 0.4"}, {"axis": "1 0 0"}, {"axis": "0 0.6 0.8"}, {"xyz": "0 0 1"}],
    "skew": [SHIFTED, {"rpy": "0.4 -0.7 1.2"} | SHIFTED, {"rpy": "-1 2 3", "axis": "1 1 -1"} | SHIFTED, SHIFTED],
    "nearly parallel": [{"rpy": "0.01 -0.02 0.3"} | SHIFTED, {"rpy": "1e-7 0 0"} | SHIFTED, {"rpy": "0 3e-13 0"},
                        {"rpy": "0.0348 0 0"} | SHIFTED, {"rpy": "0.035 0 0"} | SHIFTED, SHIFTED],
    "sliding": [{"kind": "prismatic", "axis": "1 0 0"} | SHIFTED, {"axis": "0 1 0"} | SHIFTED,
                {"kind": "prismatic", "axis": "0 1 0"} | SHIFTED, {"kind": "prismatic", "axis": "1 2 0"} | SHIFTED],
    "continuous": [{"kind": "continuous", "more": "", "axis": "0 2 0"} | SHIFTED, {"rpy": "0.4 -0.7 1.2"} | SHIFTED],
    "fixed between": [{"kind": "fixed", "axis": "0 0 0"} | SHIFTED, {"axis": "0 1 0", "rpy": "0.1 0.2 0.3"} | SHIFTED,
                      {"kind": "fixed", "rpy": "-1 2 3"} | SHIFTED, {"kind": "fixed", "rpy": "1 -0.5 0"} | SHIFTED,
                      SHIFTED, {"kind": "fixed", "rpy": "1 -0.5 0"} | SHIFTED, {"kind": "fixed"} | SHIFTED],
}


@pytest.mark.parametrize("name", tiered(CHAINS, lambda name: name in ("skew", "sliding", "turned over")))
def test_chains(write, name):
    path, tip = write(chain(*CHAINS[name], body=inertial(rpy="0.3 -1 2"))), f"l{len(CHAINS[name])}"
    machine = load_machine(path)
    moves_alike(machine, path, tip)
    assert machine.links == load_machine(path, tip=tip).links
    needs_same_torques(machine, path, states=2)
    assert read_machine(dump_machine(machine)) == machine


@pytest.mark.parametrize("seed", tiered(range(60), lambda seed: seed < 12))
def test_random_chains(write, seed):
    rng = np.random.default_rng(seed)

    def some():
        return rng.choice([0, math.pi / 2, -math.pi / 2, math.pi, 1e-9, -1e-5, 0.03, rng.normal()], 3)

    def axis():
        return np.eye(3)[rng.integers(3)] * rng.choice([-1, 1]) if rng.random() < 0.7 else rng.normal(size=3)

    def text(values):
        return " ".join(map(repr, np.asarray(values, dtype=float).tolist()))

    joints = [{"xyz": text(some()), "rpy": text(some()), "axis": text(axis()),
               "kind": str(rng.choice(["revolute", "prismatic", "fixed"], p=[0.6, 0.2, 0.2]))} for _ in range(7)]
    path = write(chain(*joints, {}))
    moves_alike(load_machine(path), path, "l8", states=3)


def test_a_leading_locked_link_only_where_it_is_needed(write):
    assert [each.name for each in load_machine(write(chain({"xyz": "0 0 2", "rpy": "0 0 1"}))).links] == ["j1"]
    for elsewhere in ({"xyz": "0.1 0 0"}, {"axis": "0 0 -1"}, {"rpy": "0.1 0 0"}):
        links = load_machine(write(chain(elsewhere))).links
        assert [(each.name, each.joint.type) for each in links] == [("j1_mount", "locked"), ("j1", "revolute")]


def test_numbers_change_little_with_the_direction_of_a_parallel_axis(write):
    def numbers(tilt):
        second = load_machine(write(chain(SHIFTED, {"xyz": "0.8 0.1 0.2", "rpy": f"{tilt} {-tilt} 0"}, SHIFTED))).links
        return np.array([[j.d, j.theta, j.a, j.alpha, j.beta] for j in (each.joint for each in second)])

    flat = numbers(0)
    np.testing.assert_allclose(flat[1], [0.2, flat[1, 1], math.hypot(0.8, 0.1), 0, 0], atol=1e-15)
    for tilt in (1e-14, 1e-9, 1e-6, 1e-4, 0.02):
        assert np.max(np.abs(numbers(tilt) - flat)) <= 2 * tilt + 1e-15


def test_names_limits_and_drives(write):
    text = chain({}, {"kind": "continuous", "more": ""} | SHIFTED).replace('"j1"', '"1st joint-a"').replace(
        '"j2"', '"base"').replace("arm", "3 arms")
    machine = load_machine(write(text))
    assert machine.name == "machine_3_arms"
    assert machine.joints == ("joint_1st_joint_a", "base_2")
    assert [(drive.name, drive.joint) for drive in machine.drives] == [
        (f"{name}_drive", name) for name in machine.joints]
    first, second = (machine.link(name).joint for name in machine.joints)
    assert (first.range, first.max_speed) == ((-2, 1.5), 0.7)
    assert (second.range, second.max_speed) == ((-math.pi, math.pi), None)
    path = write(chain(SHIFTED, SHIFTED, body=inertial()).replace('"j1"', '"base"'))
    assert load_machine(path).joints == ("base_2", "j2")
    assert load_machine(path).link("j2").parent == "base_2"
    same = chain({}, {} | SHIFTED).replace('"j1"', '"a b"').replace('"j2"', '"a-b"')
    assert load_machine(write(same)).joints == ("a_b", "a_b_2")
    assert load_machine(write(chain({"more": LIMIT.replace("0.7", "0")}))).links[0].joint.max_speed is None


def test_bodies_behind_fixed_and_left_out_joints_are_lumped(write):
    parts = [link("l0", inertial()), link("l1", inertial()), link("l2", inertial(m=0, six=[0] * 6)),
             *(link(f"x{k}", inertial(m=k + 1, xyz=f"{k} 0.3 -{k}", rpy="1 2 3")) for k in range(4)),
             joint("j1", "l0", "l1", axis="0 1 0"), joint("j2", "l1", "l2", **SHIFTED),
             joint("f", "l1", "x0", "0.5 0 1", "0.3 0.2 -1", kind="fixed"), joint("off", "x0", "x1", "1 1 1", "1 0 2"),
             joint("follower", "l1", "x2", "0.2 0 0", "0 1 0", more=LIMIT + '<mimic joint="j1" offset="0.4"/>'),
             joint("slider", "x2", "x3", "0.2 0 0", kind="prismatic", more=LIMIT + '<mimic joint="off" offset="0.4"/>')]
    path = write("<robot name='arm'>" + "".join(parts) + "</robot>")
    machine = load_machine(path, tip="l2")
    assert machine.joints == ("j1", "j2")
    assert machine.link("j1").body.m == pytest.approx(3 + 1 + 2 + 3 + 4)
    assert machine.link("j2").body is None
    needs_same_torques(machine, path, {"follower": 0.4, "slider": 0.4})


def test_only_links_that_state_a_body_have_one(write):
    text = chain({}, SHIFTED, SHIFTED, body=inertial()).replace(link("l2", inertial()), link("l2"))
    machine = load_machine(write(text))
    assert [each.body is not None for each in machine.links] == [True, False, True]


def test_branches_at_the_root(write):
    text = ("<robot name='two'>" + "".join(map(link, ("l0", "a", "b", "c"))) + joint("ja", "l0", "a", **SHIFTED)
            + joint("jb", "l0", "b", axis="0 1 0") + joint("jc", "a", "c", axis="1 0 0", **SHIFTED) + "</robot>")
    path = write(text)
    machine = load_machine(path)
    assert machine.joints == ("ja", "jb", "jc")
    moves_alike(machine, path, "c")
    assert load_machine(path, tip="a").joints == ("ja",)
    assert load_machine(path, tip="b").joints == ("jb",)


@pytest.mark.slow
def test_branches_anywhere(write):
    """Behind a joint that carries several, each further one has a mount of its own, unless it is on the same axis."""
    rng = np.random.default_rng(3)
    parents = [0, 1, 1, 1, 2, 2, 3]
    joints = [joint(f"j{k}", f"l{parent}", f"l{k}", xyz="{} {} {}".format(*rng.normal(size=3)),
                    rpy="{} {} {}".format(*rng.normal(size=3)), axis="{} {} {}".format(*rng.normal(size=3)),
                    kind="prismatic" if k == 4 else "revolute") for k, parent in enumerate(parents, start=1)]
    path = write("<robot name='tree'>" + link("l0") + "".join(link(f"l{k}", inertial()) for k in range(1, 8))
                 + "".join(joints) + "</robot>")
    machine = load_machine(path)
    assert machine.joints == ("j1", "j2", "j3", "j4", "j5", "j6", "j7")
    assert {each.name for each in machine.links} - {*machine.joints} == {"j1_mount", "j3_mount", "j4_mount", "j6_mount"}
    moves_alike(machine, path, "l7")
    needs_same_torques(machine, path)
    assert load_machine(path, tip="l6").joints == ("j1", "j2", "j6")
    assert read_machine(dump_machine(machine)) == machine


def test_friction_efforts_and_gears(write):
    """What a file states beside geometry and bodies: friction, limits of effort, gears of transmissions."""
    text = chain({"more": LIMIT + '<dynamics damping="2.5" friction="7"/>'},
                 {"kind": "prismatic", "more": LIMIT + '<dynamics damping="0" friction="4"/>'} | SHIFTED,
                 {"more": LIMIT + '<mimic joint="j1" multiplier="-2" offset="0.3"/><dynamics damping="0.5"/>'}, {},
                 body=inertial()).replace("</robot>", GEAR + "</robot>")
    path = write(text)
    machine = load_machine(path)
    first, second, last = machine.drives
    assert (first.gear, first.max_torque, first.friction.viscous, first.friction.coulomb) == (30, 9, 2.5, 7)
    assert (second.gear, second.friction.viscous, second.friction.coulomb) == (1, None, 4)
    assert (last.joint, last.friction.coulomb) == ("j4", None)
    assert machine.dependent_joints == ("j3",)
    assert machine.link("j3").joint.friction.viscous == 0.5
    assert (machine.couplings[0].ratios, machine.couplings[0].offset) == ({"j1": -2.0}, 0.3)
    moves_alike(machine, path, "l4")
    needs_same_torques(machine, path)


def test_joints_that_mimic_one_that_mimics(write):
    path = write(chain({}, {"more": LIMIT + '<mimic joint="j3" offset="0.1"/>'} | SHIFTED,
                       {"more": LIMIT + '<mimic joint="j1" multiplier="0.5"/>'} | SHIFTED, {}, body=inertial()))
    machine = load_machine(path)
    assert machine.dependent_joints == ("j2", "j3")
    moves_alike(machine, path, "l4")
    needs_same_torques(machine, path)


def test_a_free_base_stands_still(write):
    """The world or the root of a robot that moves freely: its base is the machine's."""
    path = write(chain({"kind": "floating"}, SHIFTED, SHIFTED, body=inertial()))
    assert load_machine(path).joints == ("j2", "j3")
    assert read_robot(path).lost == ("the free joint 'j1' stands still: the machine's base is 'l1'",
                                     "the mass of l1 is left out: it stands still")


def test_limits_out_of_reach_are_none(write):
    path = write(chain({"more": '<limit lower="-1e16" upper="1e16"/>'}, SHIFTED))
    assert load_machine(path).link("j1").joint.range == (-math.pi, math.pi)
    assert read_robot(path).lost == ("'j1' states limits that are out of reach, and turns without end",)


def test_what_is_left_out_is_listed(write):
    shapes = '<visual><geometry><box size="1 1 1"/></geometry></visual><collision/>'
    path = write(chain({}).replace('<link name="l1">', f'<link name="l1">{shapes}'))
    assert read_robot(path).lost == ("2 visual and collision shapes are left out",)


# --- bad files

GOOD = chain({}, SHIFTED, body=inertial())
GEAR = ('<transmission name="t"><joint name="j1"/><actuator name="m"><mechanicalReduction>30</mechanicalReduction>'
        '</actuator></transmission>')
FIXED = chain({"kind": "fixed"})
FORK = GOOD.replace("</robot>", link("m") + joint("k", "l1", "m") + "</robot>")
BAD = {
    "empty": ("", r"arm\.urdf: is not valid XML .*; correct"),
    "not XML": ("robot: arm", r"arm\.urdf: is not valid XML .*line 1"),
    "cut off": (GOOD[:-20], r"arm\.urdf: is not valid XML"),
    "binary": (b"\xff\xfe\x00\x01" * 30, r"arm\.urdf: .*not text; .*UTF-8"),
    "zeros": (b"\x00" * 30, r"arm\.urdf: "),
    "entities": ('<!DOCTYPE robot [<!ENTITY a "b">]>' + GOOD, r"arm\.urdf: .*document type.*; remove"),
    "no robot": ("<sdf/>", r"arm\.urdf: .*<sdf> instead of <robot>; give"),
    "a template": (GOOD.replace("<robot", '<robot xmlns:xacro="http://x/xacro"').replace(
        "</robot>", "<xacro:arm/></robot>"), r"arm\.urdf: .*xacro template; "),
    "no links": ("<robot/>", r"arm\.urdf: it has no joints; add"),
    "no joints": ("<robot>" + link("a") + "</robot>", r"arm\.urdf: it has no joints; add"),
    "nothing moves": (FIXED, r"arm\.urdf: no joint moves; add"),
    "no name": (GOOD.replace('"j2"', '""'), r"arm\.urdf: a joint has no name; give"),
    "a joint twice": (GOOD.replace('"j2"', '"j1"'), r"arm\.urdf: two joints are called 'j1'; give"),
    "a link twice": (GOOD.replace("</robot>", link("l1") + "</robot>"), r"arm\.urdf: two links are called 'l1'; give"),
    "no such parent": (GOOD.replace('parent link="l1"', 'parent link="ll"'),
                       r"joint 'j2': its parent link 'll'.*; use l0 or l1 or l2, or add"),
    "no child": (GOOD.replace('<child link="l2"/>', ""), r"joint 'j2': its child link ''.*; use l0"),
    "a child twice": (GOOD.replace('child link="l2"', 'child link="l1"'), r"joint 'j2': .*'l1' is attached to 'j1'"),
    "two roots": (GOOD.replace("</robot>", link("x") + "</robot>"), r"arm\.urdf: the links l0, x .*; connect"),
    "a circle": (GOOD.replace("</robot>", joint("j0", "l2", "l0") + "</robot>"), r"arm\.urdf: .*circle; remove"),
    "a circle aside": (GOOD.replace("</robot>", link("x") + link("y") + joint("jx", "x", "y") + joint("jy", "y", "x")
                                    + "</robot>"), r"arm\.urdf: the links x, y .*circle; remove"),
    "hangs on itself": (GOOD.replace("</robot>", link("x") + joint("jx", "x", "x") + "</robot>"), r"links x .*circle"),
    "no axis": (chain({"axis": "0 0 0"}), r"joint 'j1': its axis is zero; give"),
    "tiny axis": (chain({"axis": "0 1e-300 0"}), r"joint 'j1': its axis is zero; give"),
    "no limits": (chain({"more": ""}), r"joint 'j1': its limits are missing; add <limit"),
    "one limit": (chain({"kind": "prismatic", "more": '<limit lower="0"/>'}), r"joint 'j1': its limits are missing"),
    "limits exchanged": (chain({"more": '<limit lower="1" upper="-1"/>'}), r"joint 'j1': the lower limit, 1, .*-1; "),
    "not a number": (chain({"xyz": "0 zero 0"}), r"joint 'j1': <origin>: 'xyz' cannot be '0 zero 0'; state 3"),
    "two numbers": (chain({"rpy": "0 0"}), r"joint 'j1': <origin>: 'rpy' .*; state 3"),
    "not finite": (chain({"xyz": "0 nan 0"}), r"joint 'j1': <origin>: 'xyz' .*; state 3 finite"),
    "infinite": (chain({"axis": "0 1e999 0"}), r"joint 'j1': <axis>: 'xyz' "),
    "absurd": (chain({"xyz": "1e200 0 0"}), r"joint 'j1': <origin>: 'xyz' "),
    "an endless limit": (chain({"more": '<limit lower="0" upper="inf"/>'}), r"joint 'j1': <limit>: 'upper' "),
    "floating": (chain({"kind": "floating"}), r"joint 'j1': .*'floating'.*; make it revolute, "),
    "planar": (chain({"kind": "planar"}), r"joint 'j1': .*'planar'"),
    "no type": (GOOD.replace('type="revolute"', "", 1), r"joint 'j1': .*type ''"),
    "no mass": (GOOD.replace('<mass value="3.0"/>', "", 1), r"link 'l1': <inertial>: <mass>: 'value' is missing"),
    "negative mass": (GOOD.replace('value="3.0"', 'value="-3"', 1), r"link 'l1': <inertial>: .*negative, -3 kg; "),
    "no inertia": (GOOD.replace('ixy="0.02"', "", 1), r"link 'l1': <inertial>: <inertia>: 'ixy' is missing; state"),
    "mimics nothing": (chain({"more": LIMIT + '<mimic joint="jj"/>'}, {}), r"joint 'j1': it mimics 'jj', .*; use j1"),
    "mimics itself": (chain({"more": LIMIT + '<mimic joint="j1"/>'}, {}), r"joint 'j1': it mimics 'j1'"),
    "mimic each other": (chain({"more": LIMIT + '<mimic joint="j2"/>'}, {"more": LIMIT + '<mimic joint="j1"/>'}, {}),
                         r"joint 'j1': it mimics 'j2', and at last itself; let one"),
    "a gear of nothing": (GOOD.replace("</robot>", GEAR.replace("30", "x") + "</robot>"),
                          r"transmission 't': <mechanicalReduction>: 'value' cannot be 'x'"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_files_are_refused_in_one_sentence(write, name):
    text, words = BAD[name]
    assert text != GOOD
    with pytest.raises(MachineError, match=words) as refusal:
        load_machine(write(text))
    assert "\n" not in str(refusal.value)
    assert refusal.value.where.split(": ")[0].endswith("arm.urdf")


def test_bad_tips(write):
    path = write(FORK)
    with pytest.raises(MachineError, match=r"arm\.urdf: there is no link 'l3'; use l[012]"):
        load_machine(path, tip="l3")
    with pytest.raises(MachineError, match=r"no joint moves between 'l0' and 'l0'; name a tip"):
        load_machine(path, tip="l0")
    assert load_machine(path, tip="m").joints == ("j1", "k")


def test_absent_files_and_parameter_sets(write, tmp_path):
    with pytest.raises(MachineError, match=r"no\.urdf: there is no such file; check the path"):
        load_machine(tmp_path / "no.urdf")
    with pytest.raises(MachineError, match=r"arm\.urdf: there is no parameter set 'guess'; leave it out"):
        load_machine(write(GOOD), parameter_set="guess")
    with pytest.raises(MachineError, match=r"neither a bundled machine nor a \.toml or \.urdf"):
        load_machine("arm.yaml")


def test_declared_encodings_and_byte_order_marks_are_read(write):
    for text in ("\ufeff" + GOOD, '<?xml version="1.0" encoding="ISO-8859-1"?>' + GOOD):
        assert load_machine(write(text)).joints == ("j1", "j2")
