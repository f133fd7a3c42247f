"""Nominal bodies that no body can be, and gravity without effect, are said wherever a machine file is used."""

import numpy as np
import pytest
from typer.testing import CliRunner

import hydroopt as ho
from fixtures.tiers import machines
from hydroopt.cli import app
from hydroopt.machine.file_checks import idle_linkages
from hydroopt.machine.machine_file import dump_machine
from hydroopt.machine.mechanism import Mechanism
from hydroopt.results.diagnostic import of_kind
from hydroopt.results.machine_diagnostics import machine_diagnostics


@pytest.mark.parametrize("name", machines())
def test_bundled_machines_have_possible_bodies(name: str) -> None:
    """One is there for its geometry and gravity: its inertias are "any", and it has no friction."""
    found = [each.kind for each in machine_diagnostics(ho.Model(ho.load_machine(name)))]
    assert found == ["bodies not stated", "no friction stated"] * (name == "panda_mukca")


@pytest.mark.parametrize(("address", "value"), [
    ("boom.I_zz", 0.0), ("boom.I_xx", 1e6), ("stick_cylinder.rod.I_xx", -9.0)])
def test_an_impossible_body_is_named(address: str, value: float) -> None:
    found, = machine_diagnostics(ho.Model(ho.load_machine("cat215b").with_values({address: value})))
    assert found.kind == "nominal bodies not physically consistent"
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
friction = { coulomb = "9 N*m" }
"""


@pytest.mark.parametrize(("change", "idle"), [
    (("", ""), False),
    (('"90 deg", "0 deg", "0 deg"', '"0 deg", "0 deg", "30 deg"'), True),
    (('"90 deg", "0 deg", "0 deg"', '"1 deg", "0 deg", "0 deg"'), False),
    (('orientation = ["90 deg", "0 deg", "0 deg"]', 'gravity = "0 m/s^2"'), False)])
def test_gravity_that_does_no_work_is_named(change: tuple[str, str], idle: bool) -> None:
    found = machine_diagnostics(ho.Model(ho.read_machine(CRANE.replace(*change))))
    assert [each.kind for each in found] == ["gravity does no work"] * idle


def test_show_warns_of_gravity_that_does_no_work(tmp_path) -> None:
    (tmp_path / "crane.toml").write_text(CRANE.replace("90 deg", "0 deg", 1))
    output = " ".join(CliRunner().invoke(app, ["show", str(tmp_path / "crane.toml")]).output.split())
    assert "! Gravity does no work on any joint (slew)" in output
    assert 'orientation = ["90 deg", "0 deg", "0 deg"]' in output


BUCKET = """
name = "digger"
[[links]]
name = "bucket"
joint = { type = "revolute", a = "1 m", lower = "-65 deg", upper = "LIMIT" }
[[cylinders]]
name = "bucket_cylinder"
bore = "100 mm"
rod_diameter = "60 mm"
dead_length = "0.8 m"
stroke = "1.7 m"
barrel = { link = "base", pin = ["0 m", "-1.5 m", "0 m"] }
rod = { link = "bucket", pin = ["0.8 m", "0 m", "0 m"] }
"""


@pytest.mark.parametrize(("limit", "wide"), [("54 deg", False), ("58 deg", True)])
def test_a_straight_cylinder_that_turns_its_joint_far_is_named(limit: str, wide: bool) -> None:
    found = of_kind(machine_diagnostics(ho.Model(ho.read_machine(BUCKET.replace("LIMIT", limit)))),
                    "a cylinder without a linkage turns a joint far")
    assert len(found) == wide
    assert all("bucket_cylinder is pinned to the link itself and turns it by 123 deg" in each.text for each in found)


@pytest.mark.parametrize(("off", "named"), [(0.0, False), (0.15, False), (0.24, True), (0.3, True)])
def test_a_posture_between_two_ways_of_assembly_is_named_with_its_margin(off: float, named: bool) -> None:
    """The rocker of excavator_bucket stands at 80.0 deg or, the other way, 90.9 deg from there."""
    machine = ho.load_machine("excavator_bucket")
    (branch,) = Mechanism(machine).ways
    taken, other = (np.degrees(each) for each in (branch.near, branch.far))
    stated = 80.0 - off * (other - taken)
    loop = next(each for each in machine.loops if each.name == "bucket_linkage")
    moved = machine.model_copy(update={"loops": tuple(
        each.model_copy(update={"posture": each.posture | {"rocker": np.radians(stated)}}) if each is loop else each
        for each in machine.loops)})
    found = machine_diagnostics(ho.Model(moved))
    assert [each.kind for each in found] == ["a posture lies between two ways to assemble a loop"] * named
    if named:
        assert float(found[0].evidence["near"].split()[0]) == pytest.approx(off * (other - taken), abs=0.2)
        assert found[0].remedy.endswith("rocker = 80.0 deg.")


@pytest.mark.parametrize("name", ["excavator_bucket", "cat215b_bucket"])
def test_a_cylinder_that_passes_a_linkage_by_is_named(name: str) -> None:
    """The bucket's linkage as loops by hand, with the cylinder on the bucket itself instead of the rocker."""
    machine = ho.load_machine(name)
    past = tuple(each.model_copy(update={"rod": each.rod.model_copy(update={"link": "bucket"})})
                 if each.rod.link == "rocker" else each for each in machine.cylinders)
    found, = idle_linkages(machine.model_copy(update={"cylinders": past}))
    assert (found.moves, found.bars) == ("bucket", ("rocker", "coupler"))
    assert found.cylinder == next(each.name for each in past if each.rod.link == "bucket")
