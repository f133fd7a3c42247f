"""Nominal bodies that no body can be, and gravity without effect, are said wherever a machine file is used."""

import pytest
from typer.testing import CliRunner

import hydroopt as ho
from hydroopt.cli import app
from hydroopt.machine.machine_file import bundled, dump_machine
from hydroopt.results.machine_diagnostics import machine_diagnostics
from hydroopt.results.wording import Kind


@pytest.mark.parametrize("name", bundled())
def test_bundled_machines_have_possible_bodies(name: str) -> None:
    assert machine_diagnostics(ho.Model(ho.load_machine(name))) == ()


@pytest.mark.parametrize(("address", "value"), [
    ("boom.I_zz", 0.0), ("boom.I_xx", 1e6), ("stick_cylinder.rod.I_xx", -9.0)])
def test_an_impossible_body_is_named(address: str, value: float) -> None:
    found, = machine_diagnostics(ho.Model(ho.load_machine("cat215b").with_values({address: value})))
    assert found.kind is Kind.IMPOSSIBLE_NOMINAL_BODIES
    assert found.subject == (address.rpartition(".")[0],)


@pytest.mark.parametrize("command", [["show", "{}"], ["codegen", "{}", "-o", "c", "--functions", "inverse_dynamics"]])
def test_commands_say_it(command: list[str], tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bad.toml").write_text(dump_machine(ho.load_machine("cat215b").with_values({"boom.I_zz": 0.0})))
    result = CliRunner().invoke(app, [part.format("bad.toml") for part in command])
    assert "No body can have" in result.output
    assert "of boom:" in result.output


CRANE = """
name = "crane"
orientation = ["90 deg", "0 deg", "0 deg"]
[[links]]
name = "slew"
joint = { type = "revolute", a = "1 m", lower = "0 deg", upper = "60 deg" }
[links.body]
m = "125 kg"
mc = ["140 kg*m", "0 kg*m", "0 kg*m"]
inertia = ["9 kg*m^2", "0 kg*m^2", "0 kg*m^2", "200 kg*m^2", "0 kg*m^2", "200 kg*m^2"]
[[drives]]
name = "slew_drive"
joint = "slew"
"""


@pytest.mark.parametrize(("change", "idle"), [
    (("", ""), False),
    (('"90 deg", "0 deg", "0 deg"', '"0 deg", "0 deg", "30 deg"'), True),
    (('"90 deg", "0 deg", "0 deg"', '"1 deg", "0 deg", "0 deg"'), False),
    (('orientation = ["90 deg", "0 deg", "0 deg"]', 'gravity = "0 m/s^2"'), False)])
def test_gravity_that_does_no_work_is_named(change: tuple[str, str], idle: bool) -> None:
    found = machine_diagnostics(ho.Model(ho.read_machine(CRANE.replace(*change))))
    assert [each.kind for each in found] == [Kind.GRAVITY_IDLE] * idle


def test_show_warns_of_gravity_that_does_no_work(tmp_path) -> None:
    (tmp_path / "crane.toml").write_text(CRANE.replace("90 deg", "0 deg", 1))
    output = " ".join(CliRunner().invoke(app, ["show", str(tmp_path / "crane.toml")]).output.split())
    assert "! Gravity does no work on any joint (slew)" in output
    assert 'orientation = ["90 deg", "0 deg", "0 deg"]' in output
