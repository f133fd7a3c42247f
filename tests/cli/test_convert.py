"""`hydroopt convert`: machines to robot files and back, and what is said of it."""

from __future__ import annotations

import pytest
from typer.testing import CliRunner

from hydroopt.cli import app
from hydroopt.errors import MachineError
from hydroopt.machine.machine_file import load_machine


def convert(*arguments):
    return CliRunner().invoke(app, ["convert", *map(str, arguments)], catch_exceptions=False)


def test_there_and_back(tmp_path):
    file, back = tmp_path / "cat.urdf", tmp_path / "cat.toml"
    said = convert("cat215b", file).output
    assert f"{file}, {tmp_path / 'cat.sidecar.toml'}" in said
    assert "not in cat.urdf: the rod of 'boom_cylinder' hangs on no pin" in said
    assert convert(file, back, "--quiet").output == ""
    assert load_machine(back).cylinders[0].model_dump(exclude={"barrel", "rod"}) == load_machine(
        "cat215b").cylinders[0].model_dump(exclude={"barrel", "rod"})


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
