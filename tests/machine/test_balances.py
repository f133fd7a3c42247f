"""Which equations of motion are measured, and files that contradict themselves about what drives a joint."""

from typing import Any

import pytest
from pydantic import ValidationError

from fixtures.drives import CRANE, crane, crossing
from hydroopt.machine.machine import Machine
from hydroopt.machine.machine_file import load_machine
from hydroopt.machine.quantity import ImpossibleError
from hydroopt.machine.range_checks import check
from hydroopt.model.model import Model


def test_one_measured_actuator_a_joint_is_its_balance() -> None:
    machine = load_machine("cat215b")
    assert machine.one_each
    assert [(each.name, each.unit) for each in machine.balances] == [
        ("swing_motor", "N*m"), ("boom_cylinder", "N"), ("stick_cylinder", "N")]
    assert machine.measured_actuators == machine.actuators


def test_several_actuators_and_none() -> None:
    machine = crane()
    assert not machine.one_each
    assert [(each.name, each.unit, len(each.actuators)) for each in machine.balances] == [
        ("swing", "N*m", 2), ("boom", "N*m", 2), ("reach", "N", 1), ("grapple", "N*m", 0)]
    assert [each.name for each in machine.drivers["boom"]] == ["boom_left", "boom_right"]


def test_unmeasured_actuators_take_their_joint_s_balance() -> None:
    machine = crane("swing_right", "reach")
    assert [each.name for each in machine.balances] == ["boom", "grapple"]
    assert [each.name for each in machine.measured_actuators] == ["boom_left", "boom_right"]


def test_a_measured_cylinder_across_a_joint_that_is_not_stays_in_use() -> None:
    machine = crossing("reach")
    assert [each.name for each in machine.balances] == ["swing", "boom", "grab"]
    assert "grab" in [each.name for each in machine.measured_actuators]


def _crane(**changes: Any) -> dict[str, Any]:
    data = crane().model_dump()
    for cylinder in data["cylinders"]:
        cylinder.update(changes.get(cylinder["name"], {}))
    data["links"][3]["joint"] |= changes.get("grapple", {})
    return data | {key: value for key, value in changes.items() if key in ("drives", "motors")}


@pytest.mark.parametrize(("data", "words"), [
    (_crane(grapple={"passive": False}), "nothing drives the joint 'grapple'.*measured = false.*passive"),
    (_crane(motors=[{"name": "rotator", "joint": "grapple", "torque_per_pressure": 1e-4}]),
     "'grapple' is passive, but 'rotator' drives it"),
    (_crane(**{name: {"measured": False} for name in ("swing_left", "boom_left", "reach")}),
     "no equation of motion contains a measured force"),
    (_crane(grapple={"type": "locked", "lower": None, "upper": None, "max_speed": None, "max_acceleration": None}),
     "a locked joint cannot be passive"),
])
def test_contradictory_drives(data: dict[str, Any], words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        Machine.model_validate(data)


def test_two_unmeasured_actuators_one_of_them_across_joints() -> None:
    data = crossing("grab").model_dump()
    second = next(each for each in CRANE["cylinders"] if each["name"] == "reach")
    data["cylinders"] = [*data["cylinders"], {**second, "name": "tilt", "measured": False,
                                              "barrel": {"link": "stick", "pin": (0.8, 0.5, 0.0)},
                                              "rod": {"link": "grapple", "pin": (-0.3, 0.4, 0.0)}}]
    with pytest.raises(ValidationError, match="'grab', which moves stick and grapple, and 'tilt' are not measured"):
        Machine.model_validate(data)


def test_of_two_cylinders_each_may_pass_a_dead_point_but_not_both_at_once() -> None:
    machine = crane()
    check(machine)
    assert set(Model(machine).triangles) == {"swing_left", "swing_right", "boom_right", "reach"}
    data = machine.model_dump()
    data["cylinders"] = [each for each in data["cylinders"] if each["name"] != "boom_right"]
    with pytest.raises(ImpossibleError, match="'boom_left' has a dead point at boom = 35"):
        check(Machine.model_validate({**data, "sensors": ()}))
    left, right = (each for each in machine.cylinders if each.name.startswith("boom"))
    twin = right.model_copy(update={"barrel": left.barrel, "rod": left.rod})
    with pytest.raises(ImpossibleError, match="'boom_left' and 'boom_right' all have a dead point near boom = 35"):
        check(machine.model_copy(update={"cylinders": (left, twin)}))
