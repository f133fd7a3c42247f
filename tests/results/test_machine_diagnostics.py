"""Nominal bodies that no body can be are said wherever a machine file is used."""

import pytest
from typer.testing import CliRunner

import hydroopt as ho
from hydroopt.cli import app
from hydroopt.machine.machine_file import bundled, dump_machine
from hydroopt.results.machine_diagnostics import machine_diagnostics
from hydroopt.results.wording import Kind


@pytest.mark.parametrize("name", bundled())
def test_bundled_machines_have_possible_bodies(name: str) -> None:
    assert machine_diagnostics(ho.load_machine(name)) == ()


@pytest.mark.parametrize(("address", "value"), [
    ("boom.I_zz", 0.0), ("boom.I_xx", 1e6), ("stick_cylinder.rod.I_xx", -9.0)])
def test_an_impossible_body_is_named(address: str, value: float) -> None:
    found, = machine_diagnostics(ho.load_machine("cat215b").with_values({address: value}))
    assert found.kind is Kind.IMPOSSIBLE_NOMINAL_BODIES
    assert found.subject == (address.rpartition(".")[0],)


@pytest.mark.parametrize("command", [["show", "{}"], ["codegen", "{}", "-o", "c", "--functions", "inverse_dynamics"]])
def test_commands_say_it(command: list[str], tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bad.toml").write_text(dump_machine(ho.load_machine("cat215b").with_values({"boom.I_zz": 0.0})))
    result = CliRunner().invoke(app, [part.format("bad.toml") for part in command])
    assert "No body can have" in result.output
    assert "of boom:" in result.output
