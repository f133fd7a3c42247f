"""Loops in machine files: common linkages by name, the way in which they are assembled, and what cannot be."""

import re

import numpy as np
import pytest
from typer.testing import CliRunner

from fixtures.loops import excavator, measured_at_the_rocker, z_bar
from hydroopt.cli import app
from hydroopt.errors import MachineError
from hydroopt.machine.file_checks import idle_linkages
from hydroopt.machine.geometry import Geometry
from hydroopt.machine.machine_file import dump_machine, read_machine
from hydroopt.machine.mechanism import Mechanism
from hydroopt.machine.range_checks import loop_ranges
from hydroopt.model.model import Model
from hydroopt.results.diagnostic import of_kind
from hydroopt.results.machine_diagnostics import machine_diagnostics

LINKS = """
name = "digger"
[[links]]
name = "stick"
joint = { type = "revolute", a = "3 m", lower = "-90 deg", upper = "-10 deg" }
[[links]]
name = "bucket"
joint = { type = "revolute", a = "1 m", lower = "-120 deg", upper = "0 deg", alpha = "0 deg" }
"""
LINKAGE = """
[[linkages]]
name = "four_bar"
moves = "bucket"
posture = { bucket = "-20 deg", rocker = "80 deg" }
rocker = { pin = ["2.2 m", "0.15 m", "0 m"], length = "0.9 m" }
coupler = { pin = ["-0.15 m", "0.65 m", "0 m"], length = "0.7 m" }
"""
ACTUATORS = """
[[drives]]
name = "stick_drive"
joint = "stick"
[[cylinders]]
name = "bucket_cylinder"
bore = "100 mm"
rod_diameter = "60 mm"
dead_length = "1.9 m"
stroke = "1.3 m"
barrel = { link = "stick", pin = ["0.1 m", "0.8 m", "0 m"] }
rod = { link = "rocker", pin = ["0.9 m", "0 m", "0 m"] }
"""
DRIVES = """
[[drives]]
name = "stick_drive"
joint = "stick"
[[drives]]
name = "bucket_drive"
joint = "bucket"
"""
LOOP = """
[[links]]
name = "rocker"
parent = "stick"
pin = ["2.2 m", "0.15 m", "0 m"]
joint = { type = "revolute", dependent = true, a = "0.9 m" }
[[links]]
name = "coupler"
joint = { type = "revolute", dependent = true, a = "0.7 m" }
[[loops]]
name = "four_bar"
link = "coupler"
to = { link = "bucket", pin = ["-0.15 m", "0.65 m", "0 m"] }
posture = { bucket = "-20 deg", rocker = "80 deg" }
"""
DIGGER = LINKS + LINKAGE + ACTUATORS
# where the bars are almost folded: their ends 0.9 m - 0.7 m apart, by the cosine rule at the joint of the bucket
ARM, PIN = complex(2.2 - 3, 0.15), complex(-0.15, 0.65)
LAST = float(np.degrees(np.angle(ARM / PIN) - np.arccos((abs(ARM)**2 + abs(PIN)**2 - 0.20003**2) / abs(2 * ARM * PIN))))


def digger(old: str = "", new: str = "", text: str = DIGGER) -> str:
    assert old in text
    return text.replace(old, new)


def test_a_linkage_is_the_links_and_the_loop_that_it_stands_for():
    by_name, by_hand = read_machine(DIGGER), read_machine(LINKS + LOOP + ACTUATORS)
    assert by_name.joints == by_hand.joints == ("stick", "bucket")
    assert by_name.tree_joints == ("stick", "rocker", "coupler", "bucket")  # the bucket stays the tip
    assert by_name.loops == by_hand.loops
    assert {link.name: link for link in by_name.links} == {link.name: link for link in by_hand.links}
    assert by_name.main_joint(by_name.cylinders[0]) == "bucket"
    assert by_name.moved_by(by_name.cylinders[0]) == ("bucket",)


@pytest.mark.parametrize("machine", [excavator, measured_at_the_rocker, z_bar])
def test_dumped_machines_read_the_same(machine):
    again = read_machine(dump_machine(machine()))
    assert again == machine()


def test_pins_of_linkages_are_numbers_like_others():
    machine = excavator()
    assert {"rocker.pin.x", "rocker.a", "coupler.a", "bucket_linkage.y"} <= machine.numbers.keys()
    other = machine.with_values({"rocker.a": 0.9, "bucket_linkage.y": 0.66, "rocker.pin.x": 2.2, "rocker.m": 150.0})
    assert (other.link("rocker").joint.a, other.loops[0].to.pin[1], other.link("rocker").pin[0]) == (0.9, 0.66, 2.2)
    assert machine.place("bucket_linkage.to.pin") == "loops[bucket_linkage].to.pin"
    assert machine.notes["rocker.pin"].source == "pin sheet; sigma assumed"


def test_the_published_sheet_closes_in_its_own_posture():
    """Pins of the sheet in its posture: rocker and coupler stand where it draws them."""
    found = Mechanism(excavator()).positions(Geometry(excavator()), {"bucket": np.radians(-17.1002428818)})
    # angles of E1 - C3 against the stick, and of D1 - E1 against E1 - C3, from the sheet's coordinates
    assert np.degrees(float(found["rocker"])) == pytest.approx(80.0234, abs=0.02)
    assert np.degrees(float(found["coupler"])) == pytest.approx(-109.6148, abs=0.02)


def test_a_posture_tells_in_which_way_a_loop_is_assembled():
    up, down = (read_machine(digger("rocker = \"80 deg\"", f"rocker = \"{angle} deg\"").replace(
        "1.9 m", "0.1 m").replace("1.3 m", "9 m").replace("\"-120 deg\"", "\"-30 deg\"")) for angle in (80, -10))
    stands = [np.degrees(float(Mechanism(each).positions(Geometry(each), {"bucket": -0.35})["rocker"]))
              for each in (up, down)]
    assert stands[0] == pytest.approx(72.3, abs=0.1)
    assert stands[1] == pytest.approx(-10, abs=8)


def test_the_margin_to_dead_points_has_its_posture():
    (found,) = loop_ranges(excavator())
    assert found.posture == {"bucket": pytest.approx(np.radians(10))}
    assert np.degrees(found.angle) == pytest.approx(46.87, abs=0.05)
    assert found.at == "bucket = 10.0 deg"


@pytest.mark.parametrize(("text", "where", "what"), {
    "cannot close": (digger('upper = "0 deg"', 'upper = "80 deg"'), r"linkages\[four_bar\]",
                     r"'four_bar' cannot close at bucket = \d+\.\d deg: its bars span 0.200 to 1.600 m"),
    "dead point": (digger('upper = "0 deg"', f'upper = "{LAST} deg"'), r"linkages\[four_bar\]",
                   rf"'four_bar' would have a dead point at bucket = {LAST:.1f} deg, where 'rocker' and"),
    "not near a way": (digger('rocker = "80 deg"', 'rocker = "150 deg"'), "posture", "not near one of the two ways"),
    "closes nowhere": (digger('length = "0.7 m"', 'length = "0.07 m"'), "posture", "cannot close in its own posture"),
    "posture without bucket": (digger('posture = { bucket = "-20 deg", ', "posture = { "), "posture",
                               "does not state bucket"),
    "posture without rocker": (digger(', rocker = "80 deg" }', " }"), "posture", "where rocker or coupler stands"),
    "posture of others": (digger('posture = { ', 'posture = { stick = "0 deg", '), "posture", "names 'stick'"),
    "no such link": (digger('moves = "bucket"', 'moves = "spoon"'), r"linkages\[four_bar\]\.moves",
                     "'spoon', which is not a link"),
    "unknown key": (digger("rocker = { pin", "rocker = { size = 3, pin"), r"linkages\[four_bar\]\.rocker\.size",
                    "unknown"),
    "missing key": (digger(', length = "0.9 m"', ""), r"linkages\[four_bar\]\.rocker\.length", "missing"),
    "no unit": (digger('length = "0.9 m"', "length = 0.9"), r"linkages\[four_bar\]\.rocker\.length", "has no unit"),
    "no table": (digger("rocker = {", "rocker = 3\nrockers = {"), r"linkages\[four_bar\]", "table|unknown"),
    "not a list": (digger("[[linkages]]", "[linkages]"), "linkages", "must be a list of tables"),
    "loops not a list": ("loops = 3\n" + DIGGER, "loops", "must be a list of tables"),
    "wrong unit": (digger('length = "0.9 m"', 'length = "0.9 kg"'), r"linkages\[four_bar\]\.rocker\.length", "kg"),
    "not parallel": (digger('a = "3 m",', 'a = "3 m", alpha = "5 deg",'), r"linkages\[four_bar\]",
                     "axes of 'rocker' and 'bucket' in the loop 'four_bar' do not point the same way"),
    "two of a name": (LINKS + LINKAGE + LINKAGE.replace("four_bar", "second") + ACTUATORS,
                      r"linkages\[second\]\.rocker", "the name 'rocker' is taken"),
    "apart along the axes": (digger('"0.15 m", "0 m"]', '"0.15 m", "0.01 m"]'), r"linkages\[four_bar\]",
                             "10 mm apart along its axes"),
    "limits": (LINKS + digger("dependent = true, a = \"0.9 m\"", "dependent = true, a = \"0.9 m\", lower = \"0 deg\"",
                              LOOP) + ACTUATORS, r"links\[rocker\]\.joint\.lower", "a dependent joint states 'lower'"),
    "sliding": (LINKS + digger('type = "revolute", dependent = true, a = "0.9 m"',
                               'type = "prismatic", dependent = true, a = "0.9 m"', LOOP).replace("80 deg", "0.1 m")
                + ACTUATORS, r"loops\[four_bar\]", "'rocker' in the loop 'four_bar' slides out of the plane"),
    "no loop": (LINKS + LOOP.partition("[[loops]]")[0] + ACTUATORS, r"links\[rocker\]\.joint\.dependent",
                "nothing determines the dependent joint 'rocker'"),
    "one left": (LINKS + digger("dependent = true, a = \"0.7 m\"", "lower = \"0 deg\", upper = \"1 deg\"", LOOP)
                 + ACTUATORS, r"loops\[four_bar\]", "has only 'rocker' to determine, but a pin determines two"),
    "three left": (digger("\"-120 deg\", upper = \"0 deg\", ", "\"-120 deg\", upper = \"0 deg\", dependent = true, ",
                          LINKS).replace('lower = "-120 deg", upper = "0 deg", ', "") + LOOP + ACTUATORS,
                   r"loops\[four_bar\]", "cannot determine 3 dependent joints"),
    "nothing moves": (digger('"revolute", a = "1 m", lower = "-120 deg", upper = "0 deg"', '"locked", a = "1 m"', LINKS)
                      + LOOP + ACTUATORS, r"loops\[four_bar\]", "nothing can move in the loop"),
    "no such end": (LINKS + digger('to = { link = "bucket"', 'to = { link = "spoon"', LOOP) + ACTUATORS,
                    r"loops\[four_bar\]", "'spoon', which does not exist"),
    "undriven": (digger('[[drives]]\nname = "stick_drive"\njoint = "stick"\n', ""), "digger",
                 "nothing drives the joint 'stick'"),
}.values())
def test_what_cannot_be_is_refused_with_its_place(text, where, what):
    with pytest.raises(MachineError) as caught:
        read_machine(text, where="digger")
    assert caught.value.remedy
    assert re.search(where, caught.value.where), caught.value
    assert re.search(what, caught.value.what), caught.value


def test_a_cylinder_pinned_past_its_linkage_is_sent_to_the_rocker():
    past = digger('rod = { link = "rocker", pin = ["0.9 m"', 'rod = { link = "bucket", pin = ["0.3 m"',
                  LINKS + LOOP + ACTUATORS)
    with pytest.raises(MachineError) as caught:
        read_machine(past)
    assert caught.value.remedy.endswith("or pin it to 'rocker' of the linkage 'four_bar'")


def test_a_linkage_that_its_cylinder_passes_by_is_refused_where_the_stroke_suffices():
    """The cylinder on the bucket itself closes and has the stroke; nothing but the idle linkage gives it away."""
    links = digger('lower = "-120 deg"', 'lower = "-70 deg"', LINKS)
    straight = digger('link = "rocker", pin = ["0.9 m", "0 m"', 'link = "bucket", pin = ["-0.3 m", "0.5 m"', ACTUATORS)
    straight = straight.replace('"1.9 m"', '"1.0 m"').replace('"1.3 m"', '"3 m"')
    read_machine(links + straight)
    past = links + LINKAGE + straight
    with pytest.raises(MachineError) as caught:
        read_machine(past)
    assert caught.value.where.endswith("linkages[four_bar]")
    stick, bucket = links.split('[[links]]\nname = "bucket"\n')
    bars, loop = LOOP.split("[[loops]]")
    last = f'[[links]]\nname = "bucket"\nparent = "stick"\n{bucket}[[loops]]{loop}'
    by_hand = read_machine(stick + bars + last + straight)
    warned, = idle_linkages(by_hand)  # by the same rule, but they may follow only
    assert (caught.value.what, caught.value.remedy) == (warned.what, warned.remedy)
    assert warned.what == ("bucket_cylinder is pinned to bucket itself and passes the linkage four_bar by: nothing "
                           "drives rocker and coupler")
    shown, = of_kind(machine_diagnostics(Model(by_hand)), "a cylinder passes a linkage by")
    assert shown.text == warned.what + "."
    carries = past + '[[springs]]\nname = "helper"\nbarrel = { link = "stick", pin = ["0.1 m", "0.8 m", "0 m"] }\n' \
        'rod = { link = "rocker", pin = ["0.9 m", "0 m", "0 m"] }\nstiffness = "1 kN/m"\nreference_length = "0.5 m"\n'
    read_machine(carries)  # a linkage that carries something is none of these


@pytest.mark.slow
def test_show_prints_the_transmission_ratio_and_the_margin():
    shown = " ".join(CliRunner().invoke(app, ["show", "excavator_bucket"]).output.split())
    assert ("bucket_linkage: rocker, coupler follow bucket; speed ratios rocker / bucket from 0.339 to 0.758, coupler "
            "/ bucket from -0.896 to 0.320; least angle to a dead point 46.9 deg, at bucket = 10.0 deg ") in shown


def test_show_says_how_a_loop_is_assembled_and_whether_the_other_way_fits_as_well(tmp_path):
    """Without a cylinder nothing but the posture decides; with one its stroke does, and a refusal names the posture."""
    wrong = digger('rocker = "80 deg"', 'rocker = "-10 deg"')
    (tmp_path / "drive.toml").write_text(LINKS + LINKAGE + DRIVES)
    shown = " ".join(CliRunner().invoke(app, ["show", str(tmp_path / "drive.toml")]).output.split())
    assert re.search(r"assembled with rocker = [\d.]+ deg, .* at bucket = -20.0 deg; the other way, .* fits as well",
                     shown)
    (tmp_path / "digger.toml").write_text(digger())
    shown = " ".join(CliRunner().invoke(app, ["show", str(tmp_path / "digger.toml")]).output.split())
    assert "the other way does not fit" in shown
    with pytest.raises(MachineError, match=r"correct the posture of 'four_bar': the other way .* rocker = [\d.]+ deg "
                                           r"at bucket = -20.0 deg, fits"):
        read_machine(wrong)
