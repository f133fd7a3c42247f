"""Sizes that no machine has are named with a remedy, and forces that no log tells."""

import pytest
from typer.testing import CliRunner

import hydroopt as ho
from hydroopt.cli import app
from hydroopt.results.machine_diagnostics import machine_diagnostics

CRANE = """
name = "crane"
orientation = ["90 deg", "0 deg", "0 deg"]
[[sensors]]
channels = ["lift_cylinder.p_head", "lift_cylinder.p_rod"]
accuracy = "0.5 bar"
[[links]]
name = "slew"
joint = { type = "revolute", a = "0.2 m", beta = "0 deg", lower = "-10 deg", upper = "10 deg" }
[links.body]
m = "300 kg"
com = ["0.1 m", "0 m", "0 m"]
inertia_com = ["1 kg*m^2", "0 kg*m^2", "0 kg*m^2", "90 kg*m^2", "0 kg*m^2", "90 kg*m^2"]
[[motors]]
name = "slew_motor"
joint = "slew"
torque_per_pressure = "160 cm^3/rev"
gear = 35
friction = { coulomb = "9 N*m" }
[[links]]
name = "lift"
joint = { type = "revolute", a = "2.9 m", lower = "-20 deg", upper = "60 deg" }
[links.body]
m = "180 kg"
com = ["1.4 m", "0.1 m", "0 m"]
inertia_com = ["1 kg*m^2", "0 kg*m^2", "0 kg*m^2", "90 kg*m^2", "0 kg*m^2", "90 kg*m^2"]
[[cylinders]]
name = "lift_cylinder"
bore = "100 mm"
rod_diameter = "56 mm"
dead_length = "0.77 m"
stroke = "0.63 m"
barrel = { link = "slew", pin = ["0.2 m", "-0.9 m", "0 m"] }
rod = { link = "lift", pin = ["0.55 m", "-0.1 m", "0 m"] }
"""


@pytest.mark.parametrize(("old", "new", "words"), [
    ("", "", ()),
    ('bore = "100 mm"', 'bore = "100 m"', ("lift_cylinder's bore is 100 m", "(100 mm?)")),
    ('dead_length = "0.77 m"\nstroke = "0.63 m"', 'dead_length = "0.65 m"\nstroke = "0.75 m"',
     ("lift_cylinder's stroke is 0.75 m", "dead length of 0.65 m")),
    ('["1.4 m", "0.1 m", "0 m"]', '["1400 m", "100 m", "0 m"]', ("lift's centre of mass is 1404 m", "Correct its unit",
                                                                "lift_cylinder's pressure that holds the machine")),
    ('"180 kg"', '"180 t"', ("lift_cylinder's pressure that holds the machine still is",
                             "the greatest is that of lift, 1.8e+05 kg")),
    ('"160 cm^3/rev"', '"160 L/rev"', ("slew_motor's torque_per_pressure is 1.6e+05 cm³/rev with a gear of 35",)),
    ('lower = "-20 deg", upper = "60 deg"', 'lower = "-0.35 deg", upper = "1.05 deg"',
     ("lift's range is -0.35 to 1.05 deg", '"-0.35 rad" and "1.05 rad"')),
    (CRANE[CRANE.index('[links.body]\nm = "180'):CRANE.index("[[cylinders]]")], "", ("lift without a mass",)),
    ('a = "2.9 m"', 'a = "2900 m"', ("lift's length, or the distance of a pin on it is 2900 m",)),
    ('pin = ["0.55 m", "-0.1 m", "0 m"]', 'pin = ["0.012 m", "-0.01 m", "0 m"]', ("lever arm on lift is only",)),
    ('stroke = "0.63 m"', 'stroke = "0.63 m"\nrelief_pressure = "3 bar"',
     ("relief_pressure is 3.0 bar", "a valve relieves it at 3 bar"))])
def test_sizes_that_no_machine_has_are_named(old: str, new: str, words: tuple[str, ...]) -> None:
    found = machine_diagnostics(ho.Model(ho.read_machine(CRANE.replace(old, new))))
    assert bool(found) == bool(words)
    assert {each.kind for each in found} <= {"implausible size", "bodies not stated"}
    said = " ".join(map(str, found))
    assert all(each in said for each in words)


def test_show_names_a_joint_without_measured_forces(tmp_path) -> None:
    """Of two cylinders at one joint one is not measured: no equation contains the joint's forces."""
    second = CRANE[CRANE.index("[[cylinders]]"):].replace('"lift_cylinder"', '"second"\nmeasured = false')
    (tmp_path / "crane.toml").write_text(CRANE + second)
    output = " ".join(CliRunner().invoke(app, ["show", str(tmp_path / "crane.toml")]).output.split())
    assert "! second is not measured: the forces at lift are in no equation" in output
    assert "if these 2 cylinders share their oil state one in their place with jacks = 2." in output
