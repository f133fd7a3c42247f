"""One address for each number of a machine: reading and writing them, with what is noted of them."""

from __future__ import annotations

import numpy as np
import pytest

from fixtures.tiers import machines
from hydroopt.errors import MachineError
from hydroopt.machine.links import Note
from hydroopt.machine.machine_file import dump_machine, load_machine, read_machine
from hydroopt.machine.parameter_kind import ParameterKind
from hydroopt.model.closed_chain import KinematicModel
from hydroopt.model.model import Model
from hydroopt.parameters import hydraulic


@pytest.mark.parametrize("name", machines())
def test_every_parameter_has_an_address_with_its_nominal_value(name: str) -> None:
    machine = load_machine(name)
    numbers = machine.numbers
    for parameters in (Model(machine).parameters, hydraulic.parameter_set(machine), KinematicModel(machine).parameters):
        for one, kind, unit, value in zip(parameters.names, parameters.kinds, parameters.units,
                                          parameters.nominal.tolist(), strict=True):
            assert numbers[one][:4] == (one, kind, unit, value)


@pytest.mark.parametrize("name", machines())
@pytest.mark.slow
def test_writing_one_number_changes_this_one_alone(name: str) -> None:
    machine = load_machine(name)
    before = {one: number.value for one, number in machine.numbers.items()}
    for one in list(before)[::7]:
        wanted = before[one] * 1.001
        changed = machine.with_values({one: wanted})
        after = {other: number.value for other, number in changed.numbers.items()}
        assert after == pytest.approx(before | {one: wanted}, rel=1e-14)
        assert after[one] == wanted


@pytest.mark.parametrize("name", machines())
def test_writing_what_stands_there_changes_nothing(name: str) -> None:
    machine = load_machine(name)
    outside = {one: number.value for one, number in machine.numbers.items() if not number.kind.is_inertial}
    assert machine.with_values(outside) == machine
    assert machine.with_values({}) == machine


def test_numbers_and_notes_survive_the_file() -> None:
    machine = load_machine("cat215b")
    values = {"boom.m": 900.0, "boom_cylinder.rod.mc_x": 12.0, "stick_cylinder.f_coulomb": 2100.0, "stick.a": 2.5,
              "boom_cylinder.barrel.y": -0.31}
    notes = {"boom.m": Note(sigma=30.0, source="weighed"), "stick.a": Note(sigma=1e-3, lower=2.4, upper=2.6),
             "boom_cylinder.barrel.y": Note(sigma=0.01)}
    written = read_machine(dump_machine(machine.with_values(values, notes)))
    assert {name: written.numbers[name].value for name in values} == pytest.approx(values, rel=1e-15)
    for name, note in notes.items():
        assert written.notes[written.numbers[name].path] == note
    assert "boom.body.com" in machine.notes
    assert "boom.body.com" not in written.notes
    parameters = Model(written).parameters
    assert parameters.nominal[parameters.index("boom.m")] == 900.0
    assert parameters.scale[parameters.index("boom.m")] == pytest.approx(30.0)


def test_a_fixture_and_a_valve_have_addresses() -> None:
    crane = load_machine("patu655_lift")
    flow = next(number for number in crane.numbers.values() if number.kind is ParameterKind.RATED_FLOW)
    assert crane.with_values({flow.name: 2 * flow.value}).numbers[flow.name].value == 2 * flow.value
    panda = load_machine("panda_mukca")
    fixture = panda.fixtures[0]
    moved = panda.with_values({f"{fixture.name}.y": fixture.position[1] + 0.1})
    np.testing.assert_allclose(np.subtract(moved.fixtures[0].position, fixture.position), [0, 0.1, 0], atol=1e-15)


@pytest.mark.parametrize(("values", "said"), [
    ({"bom.m": 1.0}, r"no number has the address 'bom\.m'; did you mean .*boom\.m"),
    ({"boom.m": -1.0}, r"machine 'cat215b'.*m: input should be greater than or equal to 0, not -1\.0"),
    ({"boom.a": float("nan")}, "finite number"),
    ({"boom_cylinder.dead_length": 0.0}, "greater than 0")])
def test_impossible_numbers_are_refused_in_a_sentence(values: dict[str, float], said: str) -> None:
    with pytest.raises(MachineError, match=said):
        load_machine("cat215b").with_values(values)


def test_bodies_leave_with_what_is_noted_of_them() -> None:
    machine = load_machine("cat215b")
    owners = [name.removesuffix(".m") for name in machine.numbers if name.endswith((".rod.m", ".barrel.m"))]
    reduced = machine.without_bodies(owners)
    assert owners
    assert set(machine.numbers) - set(reduced.numbers) == {
        name for name in machine.numbers if name.startswith(tuple(f"{owner}." for owner in owners))
        and machine.numbers[name].kind.is_inertial}
    assert not [path for path in reduced.notes if path.startswith(tuple(f"{owner}.body" for owner in owners))]
