"""`hydroopt convert`: machines to robot files and back, and what is said of it."""

from __future__ import annotations

import numpy as np
import pytest
from typer.testing import CliRunner

from hydroopt.cli import app
from hydroopt.errors import HydrooptError, MachineError
from hydroopt.machine.machine_file import load_machine


def convert(*arguments):
    return CliRunner().invoke(app, ["convert", *map(str, arguments)], catch_exceptions=False)


def test_there_and_back(tmp_path):
    file, back = tmp_path / "cat.urdf", tmp_path / "cat.toml"
    said = convert("cat215b", file).output
    assert f"{file}, {tmp_path / 'cat.sidecar.toml'}" in said
    assert "not in cat.urdf: the rod of 'boom_cylinder' hangs on no pin" in said
    assert convert(file, back, "--quiet").output == ""
    assert load_machine(back) == load_machine("cat215b")


def test_the_chain_to_a_tip(tmp_path):
    file, back = tmp_path / "fork.urdf", tmp_path / "left.toml"
    joint = ('<joint name="{0}" type="revolute"><parent link="{1}"/><child link="{0}"/><limit lower="-1" upper="1"/>'
             '</joint>')
    file.write_text('<robot name="fork"><link name="l"/><link name="a"/><link name="b"/><link name="c"/>'
                    '<joint name="f" type="floating"><parent link="c"/><child link="l"/></joint>'
                    + joint.format("a", "l") + joint.format("b", "l") + "</robot>")
    said = convert(file, back, "--tip", "b").output
    assert "not in fork.urdf's machine: the free joint 'f' stands still: the machine's base is 'l'" in said
    assert load_machine(back).joints == ("b",)
    with pytest.raises(MachineError, match="there is no link 'd'; use"):
        convert(file, tmp_path / "none.toml", "--tip", "d")
    assert not (tmp_path / "none.toml").exists()


def test_refusals(tmp_path):
    with pytest.raises(MachineError, match=r"no format is written to files that end in '\.obj'"):
        convert("ur10", tmp_path / "ur10.obj")
    with pytest.raises(MachineError, match=r"only of a robot file the chain to a tip"):
        convert("ur10", tmp_path / "ur10.urdf", "--tip", "wrist")
    assert not list(tmp_path.iterdir())


# --- cylinders in the place of drives

ARM = ('<robot name="digger"><link name="ground"/><link name="boom"/><link name="stick"/><link name="tip"/>'
       '<joint name="lift" type="revolute"><origin xyz="0.3 0 1" rpy="1.5707963267948966 0 0"/><parent link="ground"/>'
       '<child link="boom"/><axis xyz="0 0 1"/><limit lower="-0.3" upper="0.9"/></joint>'
       '<joint name="dig" type="revolute"><origin xyz="3 0 0"/><parent link="boom"/><child link="stick"/>'
       '<axis xyz="0 0 1"/><limit lower="-2" upper="-0.5"/></joint>'
       '<joint name="end" type="fixed"><origin xyz="2 0 0"/><parent link="stick"/><child link="tip"/></joint></robot>')
CYLINDERS = """
[lift_cylinder]
joint = "lift"
barrel = { link = "ground", pin = ["0.8 m", "0 m", "0.6 m"] }
rod = { link = "boom", pin = ["1.6 m", "0.3 m", "0 m"] }
bore = "110 mm"
rod_diameter = "60 mm"
"""
ANSWERS = "y\nground\n0.8 0 0.6\nboom\n{}\n110 mm\n60 mm\n"


def test_cylinders_of_a_file_replace_drives(tmp_path):
    robot, stated, out = (tmp_path / name for name in ("digger.urdf", "cylinders.toml", "digger.toml"))
    robot.write_text(ARM)
    stated.write_text(CYLINDERS)
    said = convert(robot, out, "--cylinders", stated).output
    assert "lift_cylinder: 1.137 to 1.858 m long, lever arm at least 0.487" in said
    machine = load_machine(out)
    (cylinder,) = machine.cylinders
    assert [drive.joint for drive in machine.drives] == ["dig"]
    assert machine.main_joint(cylinder) == "lift"
    turned = np.exp(-0.3j) * (1.6 + 0.3j)
    length = abs(turned + 0.3 + 1j - (0.8 + 0.6j))
    assert cylinder.dead_length == pytest.approx(length - 0.01 / 1.02 * cylinder.stroke, rel=1e-12)
    # hydraulics of a robot file come back from its sidecar
    convert(out, tmp_path / "again.urdf", "--quiet")
    assert load_machine(tmp_path / "again.urdf").cylinders[0].bore == 0.11


def test_friction_of_a_replaced_drive_becomes_its_joints_and_what_is_lost_is_listed(tmp_path):
    robot, stated, out = (tmp_path / name for name in ("digger.urdf", "cylinders.toml", "digger.toml"))
    robot.write_text(ARM.replace('upper="0.9"/>', 'upper="0.9" effort="700"/><dynamics damping="30" friction="12"/>'))
    stated.write_text(CYLINDERS)
    said = convert(robot, out, "--cylinders", stated).output
    assert "not in digger.urdf's machine: the greatest torque of the drive of 'lift', which a cylinder replaces" in said
    friction = load_machine(out).link("lift").joint.friction
    assert (friction.viscous, friction.coulomb) == (30.0, 12.0)


@pytest.mark.parametrize(("change", "words"), [
    ('joint = "lift"|joint = "lifd"', r"lift_cylinder\.joint: no drive moves 'lifd'; name one of lift"),
    ('link = "boom"|link = "bomm"', r"lift_cylinder\.rod\.link: the robot has no link 'bomm'; use boom"),
    ('"1.6 m", "0.3 m"|"1.6 m"', r"lift_cylinder\.rod\.pin: must be three lengths; state x, y and z"),
    ('"1.6 m"|"1.6"', r"lift_cylinder\.rod\.pin: .*unit"),
    ('["0.8 m", "0 m", "0.6 m"]|["-0.8 m", "0 m", "0.7 m"]', r"lift_cylinder"),
    ('bore = "110 mm"|', r"cylinders\[lift_cylinder\]: piston areas are not stated in one way"),
])
def test_bad_cylinders_are_refused(tmp_path, change, words):
    robot, stated, out = (tmp_path / name for name in ("digger.urdf", "cylinders.toml", "digger.toml"))
    robot.write_text(ARM)
    stated.write_text(CYLINDERS.replace(*change.split("|")))
    assert stated.read_text() != CYLINDERS
    with pytest.raises(HydrooptError, match=words):
        convert(robot, out, "--cylinders", stated)
    assert not out.exists()


def test_cylinders_are_asked_for_until_they_close(tmp_path):
    robot, out = tmp_path / "digger.urdf", tmp_path / "digger.toml"
    robot.write_text(ARM)
    answers = ANSWERS.format("1.6 0.3").removeprefix("y\n")
    done = CliRunner().invoke(app, ["convert", str(robot), str(out), "--ask-cylinders"], catch_exceptions=False,
                              input=f"y\n{answers}{ANSWERS.format('1.6 0.3 0').removeprefix('y' + chr(10))}n\n")
    assert "must be three lengths" in done.output
    assert "m long, lever arm at least" in done.output
    machine = load_machine(out)
    assert [each.name for each in machine.cylinders] == ["lift_cylinder"]
    # the answers are a file that says the same again
    convert(robot, tmp_path / "same.toml", "--cylinders", tmp_path / "digger.cylinders.toml")
    assert load_machine(tmp_path / "same.toml") == machine


def test_cylinders_need_a_robot_file(tmp_path):
    with pytest.raises(HydrooptError, match="cylinders replace drives of a robot file without a sidecar only"):
        convert("ur10", tmp_path / "ur10.toml", "--ask-cylinders")
