"""Machines as robot files and back: the same bodies, numbers and forces, and what a file cannot say beside it."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from fixtures.closures import crank, scissor, spherical, steering, telescope
from fixtures.loops import z_bar
from fixtures.tiers import ONE_OF_A_KIND, machines, tiered
from hydroopt.errors import MachineError
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import bundled, load_machine
from hydroopt.machine.robot_formats.writing import robot_files
from hydroopt.model.model import Model
from oracles.pinocchio_urdf import PinocchioUrdf
from oracles.subjects import forces, relative_error, states

FORMATS = (".urdf", ".xml")


def written(machine: Machine, folder: Path, suffix: str) -> Path:
    for name, text in robot_files(machine, folder / f"{machine.name}{suffix}").files.items():
        (folder / name).write_text(text)
    return folder / f"{machine.name}{suffix}"


@pytest.mark.parametrize("suffix", FORMATS)
@pytest.mark.parametrize("name", machines())
def test_numbers_come_back(name: str, suffix: str, tmp_path: Path) -> None:
    machine = load_machine(name)
    assert load_machine(written(machine, tmp_path, suffix)) == machine


@pytest.mark.parametrize("suffix", FORMATS)
@pytest.mark.parametrize("make", tiered([z_bar, telescope, steering, spherical, crank, scissor],
                                        lambda make: make in (z_bar, spherical)), ids=lambda make: make.__name__)
def test_numbers_of_odd_machines_come_back(make, suffix: str, tmp_path: Path) -> None:
    machine = make()
    assert load_machine(written(machine, tmp_path, suffix)) == machine


@pytest.mark.parametrize(("name", "suffix"), tiered(
    product(bundled(), FORMATS), lambda *case: case in (("cat215b", ".urdf"), ("wheel_loader", ".xml"))))
def test_forces_come_back(name: str, suffix: str, tmp_path: Path) -> None:
    machine = load_machine(name)
    if not any(link.body for link in machine.links):
        pytest.skip("it states geometry only")
    one, other = Model(machine), Model(load_machine(written(machine, tmp_path, suffix)))
    assert one.parameters.names == other.parameters.names
    state = states(machine, np.random.default_rng(4), 20)
    found = [forces(each, state, each.parameters.nominal) for each in (one, other)]
    assert relative_error(found[1], found[0]) < 1e-12


@pytest.mark.parametrize("name", tiered(("kr300", "ur10", "ur10e", "panda"), lambda name: name in ONE_OF_A_KIND))
def test_urdf_of_arms_is_pinocchios(name: str, tmp_path: Path) -> None:
    """Without a sidecar and without hydroopt: the forces of the exported file, gas and offsets left out."""
    machine = load_machine(name)
    model, oracle = Model(machine), PinocchioUrdf(written(machine, tmp_path, ".urdf"))
    state = states(machine, np.random.default_rng(5), 5)
    expected = np.array([oracle.torques(machine, *row) for row in zip(*state, strict=True)])
    psi = model.parameters.nominal.copy()
    said = (*(f"{link.name}." for link in machine.links),
            *(f"{drive.name}.tau_{term}" for drive in machine.drives for term in ("coulomb", "viscous")))
    for k, parameter in enumerate(model.parameters.names):
        psi[k] *= parameter.startswith(said)
    assert relative_error(forces(model, state, psi), expected) < 1e-9


@pytest.mark.parametrize("name", tiered(bundled(), lambda name: name in ("cat215b", "wheel_loader")))
def test_masses_of_the_urdf_are_those_of_the_machine(name: str, tmp_path: Path) -> None:
    machine = load_machine(name)
    bodies = [link.body for link in machine.links] + [end.body for each in machine.cylinders
                                                      for end in (each.barrel, each.rod)]
    model = pin.buildModelFromUrdf(str(written(machine, tmp_path, ".urdf")))
    whole = sum(body.mass for body in list(model.inertias))
    assert whole == pytest.approx(sum(body.m for body in bodies if body), rel=1e-12)


def test_what_a_urdf_cannot_say_is_listed() -> None:
    lost = robot_files(load_machine("excavator_bucket"), "x.urdf").lost
    assert "the loop 'bucket_linkage' does not hold" in lost
    assert "the rod of 'boom_cylinder' hangs on no pin" in lost
    assert robot_files(load_machine("panda_mukca").model_copy(update={"notes": {}}), "x.urdf").lost == ()


def test_a_changed_robot_file_changes_the_machine(tmp_path: Path) -> None:
    """Numbers edited in the file come back; what contradicts the sidecar is refused."""
    file = written(load_machine("cat215b"), tmp_path, ".urdf")
    text = file.read_text()
    file.write_text(text.replace('<mass value="1830.0" />', '<mass value="1900.0" />'))
    machine, before = load_machine(file), load_machine("cat215b")
    assert machine.link("boom").body.m == 1900
    assert machine.notes["boom.body.com"] == before.notes["boom.body.com"]
    assert machine.link("stick") == before.link("stick")
    file.write_text(text.replace('xyz="5.18 0.0 0.0" rpy="0.0 0.0 0.0"', 'xyz="5.18 0 0.002" rpy="0 0 -0.001"'))
    stick = load_machine(file).link("stick").joint
    assert (stick.d, stick.theta) == (pytest.approx(0.002), pytest.approx(-0.001))
    file.write_text(text.replace('<origin xyz="0.34 -0.11 0.0"', '<origin xyz="0.35 -0.11 0.0"'))
    with pytest.raises(MachineError, match=r"joint 'boom': its axis is not where the sidecar has .*; undo"):
        load_machine(file)
    first = text.index('<joint name="boom_cylinder.barrel"')
    start = text.index('xyz="', first) + 5
    file.write_text(text[:start] + "9" + text[start:])
    with pytest.raises(MachineError, match=r"joint 'boom_cylinder.barrel': the barrel's pin is not where"):
        load_machine(file)
    file.write_text(text.replace("</robot>", '<link name="hook"><inertial><mass value="9"/><inertia ixx="1" ixy="0" '
                                 'ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link><joint name="hook" type="fixed">'
                                 '<parent link="stick"/><child link="hook"/></joint></robot>'))
    with pytest.raises(MachineError, match=r"'hook' is either not in it or not in its sidecar; state it in both"):
        load_machine(file)
    file.write_text(text)
    with pytest.raises(MachineError, match=r"a tip cannot be named of a robot with a sidecar; leave it out, or move"):
        load_machine(file, tip="boom")


@pytest.mark.parametrize(("name", "stated", "number", "found"), [
    ("panda.urdf", 'effort="', 80.0, lambda machine: machine.drives[0].max_torque),
    ("panda.urdf", 'upper="', 2.5, lambda machine: machine.links[0].joint.upper),
    ("panda.urdf", 'velocity="', 1.5, lambda machine: machine.links[0].joint.max_speed),
    ("panda.xml", 'range="-2.8973 ', 2.5, lambda machine: machine.links[0].joint.upper),
    ("kr300.urdf", "<mechanicalReduction>", 250.0, lambda machine: machine.drives[0].gear),
    ("kr300.xml", 'armature="', 700.0, lambda machine: machine.drives[0].rotor_inertia * machine.drives[0].gear**2),
    ("kr300.xml", 'frictionloss="', 70.0, lambda machine: machine.drives[0].friction.coulomb),
    ("kr300.urdf", 'friction="', 70.0, lambda machine: machine.drives[0].friction.coulomb),
    ("forestry_crane.urdf", 'multiplier="', 0.99, lambda machine: machine.couplings[0].ratios["first"])])
def test_changed_numbers_of_joints_come_back(name: str, stated: str, number: float, found, tmp_path: Path) -> None:
    """The first number behind an attribute: what it states of the machine changes, and nothing else of its sums."""
    machine = load_machine(Path(name).stem)
    rubbing = {address: 50.0 for address in machine.numbers if address.endswith("tau_coulomb")}
    file = written(machine.with_values(rubbing), tmp_path, Path(name).suffix)
    before, behind = file.read_text().split(stated, 1)
    file.write_text(f"{before}{stated}{number}{behind.lstrip('0123456789.e-')}")
    assert found(load_machine(file)) == pytest.approx(number, rel=1e-12)


def test_unknown_formats_are_refused() -> None:
    with pytest.raises(MachineError, match=r"x\.step: no format is written to files that end in '\.step'; use \.toml"):
        robot_files(load_machine("ur10"), "x.step")
