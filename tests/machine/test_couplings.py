"""Couplings in machine files: what they determine, their numbers, and what cannot be."""

import re

import numpy as np
import pytest
from typer.testing import CliRunner

from fixtures.closures import telescope
from hydroopt.cli import app
from hydroopt.errors import MachineError
from hydroopt.machine.geometry import Geometry
from hydroopt.machine.machine_file import dump_machine, read_machine
from hydroopt.machine.mechanism import Mechanism

RACK = """
name = "rack"
[[links]]
name = "pinion"
joint = { type = "revolute", alpha = "90 deg", lower = "-90 deg", upper = "90 deg" }
[[links]]
name = "rack"
joint = { type = "prismatic", dependent = true }
[[links]]
name = "wheel"
joint = { type = "revolute", dependent = true }
[[couplings]]
name = "teeth"
joint = "rack"
ratios = { pinion = { value = "50 mm/rad", sigma = "1 mm/rad", source = "drawing" } }
offset = "0.1 m"
[[couplings]]
name = "belt"
joint = "wheel"
ratios = { pinion = -2, rack = "3 rad/m" }
[[drives]]
name = "drive"
joint = "pinion"
"""


def rack(*changes: tuple[str, str]) -> str:
    text = RACK
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    return text


def test_a_joint_is_the_sum_of_others_by_their_ratios():
    machine = read_machine(RACK)
    assert (machine.joints, machine.tree_joints) == (("pinion",), ("pinion", "rack", "wheel"))
    assert machine.followed == dict.fromkeys(machine.tree_joints, ("pinion",))
    found = Mechanism(machine).positions(Geometry(machine), {"pinion": 0.4})
    found = {joint: float(at) for joint, at in found.items()}
    assert found == {"pinion": 0.4, "rack": pytest.approx(0.12), "wheel": pytest.approx(-0.8 + 0.36)}


def test_a_coupling_determines_whichever_joint_is_dependent():
    machine = telescope()
    found = Mechanism(machine).positions(Geometry(machine), {"boom": 0.7, "first": 0.4})
    assert float(found["second"]) == pytest.approx(0.5)
    assert float(found["third"]) == pytest.approx(0.3 * 0.4 + 0.5 * 0.5)
    assert pytest.approx(-1.25 * float(found["tool"]) + 0.2 * 0.4 + 0.3) == 0.7


def test_ratios_and_offsets_are_numbers_like_others():
    machine = read_machine(RACK)
    number = machine.numbers["teeth.ratio.pinion"]
    assert (number.value, number.unit, machine.notes[number.path].sigma) == (0.05, "m/rad", 0.001)
    assert machine.place(number.path) == "couplings[teeth].ratios.pinion"
    other = machine.with_values({"teeth.ratio.pinion": 0.06, "belt.ratio.pinion": -2.5, "teeth.offset": 0.2})
    assert (other.couplings[0].ratios["pinion"], other.couplings[0].offset) == (0.06, 0.2)
    assert other.couplings[1].ratios == {"pinion": -2.5, "rack": 3.0}
    symbolic = Geometry(machine, {"teeth.ratio.pinion": 0.07})
    assert float(Mechanism(machine).positions(symbolic, {"pinion": 1.0})["rack"]) == pytest.approx(0.17)


@pytest.mark.parametrize("machine", [telescope(), read_machine(RACK)], ids=lambda each: each.name)
def test_dumped_machines_read_the_same(machine):
    assert read_machine(dump_machine(machine)) == machine


@pytest.mark.parametrize(("text", "where", "what"), {
    "circle": (rack(("{ pinion = { value = \"50 mm/rad\", sigma = \"1 mm/rad\", source = \"drawing\" } }",
                     "{ wheel = \"0.1 m/rad\" }")), r"couplings\[teeth\]",
               "the couplings 'teeth' and 'belt' follow each other in a circle"),
    "itself": (rack(("pinion = -2", "pinion = -2, wheel = 1")), r"couplings\[belt\]\.ratios\.wheel",
               "'belt' states 'wheel' by itself"),
    "zero": (rack(("-2", "0")), r"couplings\[belt\]\.ratios\.pinion", "a ratio of zero"),
    "no such joint": (rack(("pinion = -2", "pedal = -2")), r"couplings\[belt\]", "relates 'pedal', which is not"),
    "locked": (rack(('"revolute", dependent = true', '"locked"')), r"couplings\[belt\]", "relates 'wheel', which"),
    "nothing dependent": (rack(('"revolute", dependent = true', '"revolute", lower = "0 deg", upper = "1 deg"'),
                               ("[[drives]]", "[[drives]]\nname = \"other\"\njoint = \"wheel\"\n[[drives]]")),
                          r"couplings\[belt\]", "the coupling 'belt' has no dependent joint to determine"),
    "twice": (rack(("[[drives]]", "[[couplings]]\nname = \"again\"\njoint = \"wheel\"\nratios = { pinion = 3 }\n"
                    "[[drives]]")), r"couplings\[", "has no dependent joint|have 2 equations"),
    "two dependent": (RACK.partition("[[couplings]]")[0] + RACK[RACK.index("[[couplings]]\nname = \"belt\""):],
                      r"couplings\[belt\]", "the coupling 'belt' cannot determine wheel, rack"),
    "nothing determines": (RACK.partition("[[couplings]]\nname = \"belt\"")[0] + RACK[RACK.index("[[drives]]"):],
                           r"links\[wheel\]\.joint\.dependent", "nothing determines the dependent joint 'wheel'"),
    "no unit": (rack(("\"3 rad/m\"", "3")), r"couplings\[belt\]\.ratios\.rack", "3 has no unit"),
    "wrong unit": (rack(("\"3 rad/m\"", "\"3 m/rad\"")), r"couplings\[belt\]\.ratios\.rack",
                   "'m/rad' is not a unit of the kind 'rad/m'"),
    "wrong offset": (rack(("\"0.1 m\"", "\"5 deg\"")), r"couplings\[teeth\]\.offset", "'deg' is not a unit"),
    "no ratios": (rack(("{ pinion = -2, rack = \"3 rad/m\" }", "{}")), r"couplings\[belt\]\.ratios", "empty"),
    "drives a dependent one": (rack(('joint = "pinion"', 'joint = "wheel"')), "rack", "'drive' drives 'wheel'"),
}.values())
def test_what_cannot_be_is_refused_with_its_place(text, where, what):
    with pytest.raises(MachineError) as caught:
        read_machine(text, where="rack")
    assert caught.value.remedy
    assert re.search(where, caught.value.where), caught.value
    assert re.search(what, caught.value.what), caught.value


def test_show_prints_the_relation(tmp_path):
    file = tmp_path / "rack.toml"
    file.write_text(rack(('name = "drive"', 'name = "drive"\nrotor_inertia = "0.1 kg*m^2"')))
    out = CliRunner().invoke(app, ["show", str(file)]).output
    assert "teeth: rack = 0.05 m/rad * pinion + 0.1 m\nbelt: wheel = -2 * pinion + 3 rad/m * rack\n" in out


def test_rates_follow_by_the_same_ratios():
    machine, step = telescope(), 0.01
    mechanism, geometry = Mechanism(machine), Geometry(machine)
    one, other = (mechanism.positions(geometry, {"boom": 0.7 + h, "first": 0.4 - 2 * h}) for h in (0, step))
    assert float(other["tool"] - one["tool"]) / step == pytest.approx((1 + 0.2 * 2) / -1.25)
    assert np.isfinite(list(map(float, other.values()))).all()
