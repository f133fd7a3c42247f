"""Proposed column maps: what is sure, likely and guessed, and that a guess is never in force."""

import json
import tomllib

import numpy as np
import pytest
from scipy.io import savemat

from hydroopt.cli import app
from hydroopt.logs.column_words import ChannelNames
from hydroopt.logs.log import Log
from hydroopt.logs.log_files import read_log
from hydroopt.logs.map_proposal import propose_map
from hydroopt.machine.machine_file import bundled, load_machine
from hydroopt.model.model import Model
from hydroopt.simulation.simulate import random_trajectory, simulate
from studies.first_contact import spellings

FOREIGN = {"boom.q": ("Ausleger Winkel (°)", "deg", 180 / np.pi), "stick.q": ("Stiel_Winkel", "deg", 180 / np.pi),
           "swing.q": ("slew angle [rad]", "rad", 1.0), "boom_cylinder.p_head": ("pBoomHead", "bar", 1e-5),
           "boom_cylinder.p_rod": ("BoomCyl rod pressure [bar]", "bar", 1e-5),
           "stick_cylinder.p_head": ("Druck Stiel Kolbenseite [bar]", "bar", 1e-5),
           "stick_cylinder.p_rod": ("Stiel Stangenseite / bar", "bar", 1e-5),
           "swing_motor.p_a": ("swing A [bar]", "bar", 1e-5), "swing_motor.p_b": ("swing B [bar]", "bar", 1e-5),
           "boom_cylinder.length": ("Boom Zylinder Weg", "mm", 1e3)}


@pytest.fixture(scope="module")
def machine():
    return load_machine("cat215b")


@pytest.fixture(scope="module")
def log(machine):
    model = Model(machine)
    return simulate(model, random_trajectory(model, duration=10, rate=50, seed=1), seed=1)


def foreign(log, path, names=FOREIGN, **changed):
    """The log as a German table of text under foreign names, with a column of no channel."""
    columns = {"Zeit [s]": log.t, **{header: changed.get(channel.replace(".", "_"), log.channels[channel]) * scale
                                     for channel, (header, _, scale) in names.items()}, "Oil temp": 40 + 0 * log.t}
    rows = ["; ".join(f"{float(x)!r}".replace(".", ",") for x in row) for row in zip(*columns.values(), strict=True)]
    path.write_text("\n".join(["Logger 7", ";".join(columns), *rows]), "latin-1")
    return path


def test_foreign_names_are_found_and_the_map_reads_the_log(machine, log, tmp_path):
    path = foreign(log, tmp_path / "run.csv")
    found = propose_map(path, machine)
    sureness = {each.channel: each.sureness for each in found.proposals}
    assert sureness == {"t": "sure"} | dict.fromkeys(FOREIGN, "sure") | {
        "stick.q": "likely", "boom_cylinder.p_head": "likely"}
    assert {each.channel: each.unit for each in found.proposals if each.channel != "t"} == {
        channel: unit for channel, (_, unit, _) in FOREIGN.items()}
    assert (found.missing, found.unused) == ({}, ("Oil temp",))
    assert "agree through the triangle of boom_cylinder" in found.toml()
    (tmp_path / "map.toml").write_text(found.toml())
    again = read_log(path, mapping=tmp_path / "map.toml")
    np.testing.assert_array_equal(again.t, log.t)
    for channel in FOREIGN:
        np.testing.assert_allclose(again.channels[channel], log.channels[channel], rtol=1e-12, atol=1e-12)


def proposal(found, channel):
    return next(each for each in found.proposals if each.channel == channel)


def refused(found, channel, reason):
    each = proposal(found, channel)
    assert each.sureness == "guess"
    assert reason in each.reason
    assert channel not in tomllib.loads(found.toml())["columns"]


def test_what_is_only_guessed_is_a_comment(machine, log, tmp_path):
    small = 0.02 * np.sin(log.t)
    names = FOREIGN | {"swing.q": ("slew angle", "rad", 1.0), "swing_motor.p_a": ("swing A", "Pa", 1e-8)}
    found = propose_map(foreign(log, tmp_path / "a.csv", names, swing_q=small), machine)
    refused(found, "swing.q", "without a unit (rad or deg)")
    refused(found, "swing_motor.p_a", "without a unit")

    found = propose_map(foreign(log, tmp_path / "b.csv", stick_q=log.channels["stick.q"] - 2.0), machine)
    refused(found, "stick.q", "none of the usual ones fits")

    found = propose_map(foreign(log, tmp_path / "c.csv", boom_q=-log.channels["boom.q"][::-1] / 3), machine)
    refused(found, "boom.q", "disagree through the triangle of boom_cylinder")
    refused(found, "boom_cylinder.length", "disagree")

    names = FOREIGN | {"swing_motor.p_b": ("slew pos [deg]", "deg", 1e-7)}
    found = propose_map(foreign(log, tmp_path / "d.csv", names), machine)
    refused(found, "swing.q", "'slew pos [deg]' may be it, too")
    assert "swing_motor.p_b" in found.missing


PARTS = {"q": "rad", "qd": "rad/s", "length": "m", "p_head": "Pa", "p_rod": "Pa", "p_a": "Pa", "p_b": "Pa",
         "gyro_x": "rad/s", "gyro_y": "rad/s", "pitch": "rad"}
ENDS = {"cylinder": ("length", "p_head", "p_rod"), "motor": ("p_a", "p_b"), "imu": ("gyro_x", "gyro_y", "pitch"),
        "": ("q", "qd")}


def names(*parts: str, **kinds: str) -> ChannelNames:
    """The names of channels of parts by their kind, the last word of a part's name."""
    channels = {f"{part}.{end}": PARTS[end] for part in parts
                for end in ENDS.get(part.rpartition("_")[2], ENDS[""])}
    return ChannelNames(channels | kinds)


@pytest.mark.parametrize(("header", "channel", "score"), [
    ("boom.q [deg]", "boom.q", 3), ("BoomAngle_deg", "boom.q", 2), ("boom_q", "boom.q", 3),
    ("boom [deg]", "boom.q", 1), ("boom", "boom.q", 0),
    ("boom rate [deg/s]", "boom.q", 0),
    ("Löffelstiel Zylinder Druck Stangenseite", "stick_cylinder.p_rod", 2), ("stick head", "boom_cylinder.p_head", 0),
    ("boom cyl head p2", "boom_cylinder.p_head", 0), ("axis 1 angle", "axis1.q", 2), ("axis 12 angle", "axis1.q", 0)])
def test_names_are_matched_by_their_words(header, channel, score):
    found = names("boom", "stick", "axis1", "boom_cylinder", "stick_cylinder")
    assert found.fit(channel, found.naming(header)) == score


@pytest.mark.parametrize("name", bundled())
def test_every_channel_is_the_only_one_of_its_own_words(name):
    found = ChannelNames(load_machine(name).channel_units)
    for channel in found.channels:
        named = found.naming(channel.replace(".", "_"))
        scores = {other: found.fit(other, named) for other in found.channels}
        assert [other for other, score in scores.items() if score == max(scores.values())] == [channel]


def test_a_topic_names_the_part_the_chamber_and_the_quantity_that_the_field_leaves_out():
    found = names("boom", "boom_imu", "stick_imu", "boom_cylinder")
    for field, topic, channel in (("angular_velocity.x [rad/s]", "/imu/boom", "boom_imu.gyro_x"),
                                  ("fluid_pressure [Pa]", "/pressure/boom_cylinder/p_head", "boom_cylinder.p_head"),
                                  ("data", "/boom/rod_pressure", "boom_cylinder.p_rod"),
                                  ("boom angle [deg]", "/stick/head_pressure", "boom.q")):
        named = found.naming(field, topic)
        assert {name for name in found.channels if found.fit(name, named) == 2} == {channel}


def test_a_file_with_the_channels_own_names_is_sure(machine, log, tmp_path):
    log.write(tmp_path / "run.parquet")
    found = propose_map(tmp_path / "run.parquet", machine)
    assert {each.sureness for each in found.proposals} == {"sure"}
    assert {each.channel for each in found.proposals} == {"t", *log.channels}


def test_sheets_and_their_clocks_are_stated(machine, log, tmp_path):
    folder = tmp_path / "run"
    folder.mkdir()
    Log("a", log.t, {"boom.q": log.channels["boom.q"]}).write(folder / "joints.csv")
    Log("b", log.t[::5], {"boom_cylinder.p_head": log.channels["boom_cylinder.p_head"][::5]}).write(folder / "can.csv")
    (tmp_path / "map.toml").write_text(propose_map(folder, machine).toml())
    merged = read_log(folder, mapping=tmp_path / "map.toml")
    np.testing.assert_array_equal(merged.channels["boom.q"], log.channels["boom.q"][: merged.size])
    assert merged.size == log.size - (log.size - 1) % 5


def test_the_command_writes_the_map_and_says_what_is_next(log, tmp_path, capsys):
    path, to = foreign(log, tmp_path / "run.csv"), tmp_path / "map.toml"
    app(["map", str(path), "cat215b", "--to", str(to)], standalone_mode=False)
    said = capsys.readouterr().out
    assert said.splitlines()[-1] == f"Next: hydroopt check cat215b {path} --map {to}"
    assert "9 sure, 2 likely, 0 guessed" in said
    assert to.read_text() == propose_map(path, load_machine("cat215b")).toml()
    with pytest.raises(Exception, match="such a file already"):
        app(["map", str(path), "cat215b", "--to", str(to)], standalone_mode=False)
    app(["map", str(path), "cat215b", "--json"], standalone_mode=False)
    assert json.loads(capsys.readouterr().out)["unused"] == ["Oil temp"]


def test_variables_of_a_matlab_file_are_listed_and_its_map_reads_them(machine, log, tmp_path):
    """Vectors, fields of a struct and rows of a matrix."""
    pressures = {channel: x for channel, x in log.channels.items() if ".p_" in channel}
    content = {"t": log.t, "log": {channel.replace(".q", "_angle_deg"): np.degrees(log.channels[channel])[:, None]
                                   for channel in ("swing.q", "boom.q", "stick.q")},
               "boom_cylinder_p_head_bar": 1e-5 * pressures["boom_cylinder.p_head"],
               "p": np.array([*pressures.values()]), "note": "made today", "table": np.zeros((900, 900))}
    savemat(tmp_path / "run.mat", content)
    found = propose_map(tmp_path / "run.mat", machine)
    assert {"swing.q", "boom.q", "stick.q", "boom_cylinder.p_head"} <= {each.channel for each in found.proposals}
    assert {f"p[{row}]" for row in range(len(pressures))} <= set(found.unused)
    lines = found.toml().replace('# t = ', 't = ').replace("[columns]", '[columns]\n"stick_cylinder.p_rod" = '
                                                           '{ column = "p[5]", unit = "Pa" }')
    (tmp_path / "map.toml").write_text("\n".join(line for line in lines.splitlines()
                                                 if '"stick_cylinder.p_rod"' not in line or "p[5]" in line))
    read = read_log(tmp_path / "run.mat", mapping=tmp_path / "map.toml")
    np.testing.assert_allclose(read.channels["boom.q"], log.channels["boom.q"], rtol=1e-14)
    np.testing.assert_array_equal(read.channels["stick_cylinder.p_rod"], [*pressures.values()][5])


def test_pressures_without_a_unit_have_one_in_common(machine, log, tmp_path):
    """A chamber at low pressure would allow MPa, which the other chambers do not."""
    names = {channel: (header.split(" [")[0].split(" /")[0], unit, scale)
             for channel, (header, unit, scale) in FOREIGN.items()}
    low = 2e5 + 0.2 * log.channels["boom_cylinder.p_rod"] / np.max(log.channels["boom_cylinder.p_rod"]) * 1e6
    found = propose_map(foreign(log, tmp_path / "run.csv", names, boom_cylinder_p_rod=low), machine)
    assert {each.channel: (each.unit, each.sureness) for each in found.proposals if ".p_" in each.channel} == {
        channel: ("bar", "likely") for channel in FOREIGN if ".p_" in channel}
    reason = proposal(found, "boom_cylinder.p_rod").reason
    assert "all columns of its kind without a unit together allow bar alone" in reason


def test_pressures_that_contradict_each_other_are_guesses_all(machine, log, tmp_path):
    """In kbar, which is none of the usual units: some chambers alone would allow MPa."""
    names = {channel: (header.split(" [")[0].split(" /")[0], unit, 1e-8 if ".p_" in channel else scale)
             for channel, (header, unit, scale) in FOREIGN.items()}
    low = log.channels["boom_cylinder.p_rod"] / np.max(log.channels["boom_cylinder.p_rod"]) * 1e-2
    found = propose_map(foreign(log, tmp_path / "run.csv", names, boom_cylinder_p_rod=low), machine)
    assert {each.sureness for each in found.proposals if ".p_" in each.channel} <= {"guess"}


def test_pressures_that_no_hydraulic_machine_has_are_guesses(machine, log, tmp_path):
    """Columns in psi whose headers say Pa."""
    names = {channel: (f"{header.split(' [')[0].split(' /')[0]} [Pa]", unit, 1 / 6894.757) if ".p_" in channel else
             (header, unit, scale) for channel, (header, unit, scale) in FOREIGN.items()}
    found = propose_map(foreign(log, tmp_path / "run.csv", names), machine)
    stated = proposal(found, "swing_motor.p_a")
    assert stated.sureness == "guess"
    assert "the highest of all pressures would be" in stated.reason


def test_numbered_joints_and_a_time_by_its_step_are_proposed(machine, log, tmp_path):
    names = FOREIGN | {f"{joint}.q": (f"q{number} (deg)", "deg", 180 / np.pi)
                       for number, joint in enumerate(machine.joints, 1)}
    path = foreign(log, tmp_path / "run.csv", names)
    path.write_text(path.read_text("latin-1").replace("Zeit [s]", "Zeit"), "latin-1")
    found = propose_map(path, machine)
    assert (proposal(found, "t").unit, proposal(found, "t").sureness) == ("s", "likely")
    for joint in machine.joints[:1]:  # without a length that proves it
        refused(found, f"{joint}.q", "number 1 of 3 in the machine file's order")


EXCAVATOR = ("swing", "boom", "stick", "bucket", "swing_motor", "boom_cylinder", "stick_cylinder", "bucket_cylinder")
LOADER = ("lift", "bucket", "z_bar", "lift_cylinder", "tilt_cylinder")
KNUCKLE = ("slew", "main", "knuckle", "telescope", "main_cylinder", "knuckle_cylinder", "telescope_cylinder")
CRANE = ("slew", "main_boom", "outer_boom", "main_cylinder", "outer_cylinder")


@pytest.mark.parametrize(("parts", "header", "channel"), [
    (EXCAVATOR, "Hubzylinder Druck Boden [bar]", "boom_cylinder.p_head"),
    (EXCAVATOR, "Auslegerzylinder Druck stangenseitig (bar)", "boom_cylinder.p_rod"),
    (EXCAVATOR, "Stielzylinder Weg [mm]", "stick_cylinder.length"),
    (EXCAVATOR, "Löffel Neigungswinkel [°]", "bucket.q"), (EXCAVATOR, "Knickarm Winkel (°)", "stick.q"),
    (EXCAVATOR, "Hubarm Drehwinkel [Grad]", "boom.q"), (EXCAVATOR, "Drehwerk p_A [bar]", "swing_motor.p_a"),
    (EXCAVATOR, "Drehmotor p_B [bar]", "swing_motor.p_b"), (EXCAVATOR, "Oberwagen Drehrate [deg/s]", "swing.qd"),
    (EXCAVATOR, "main boom angle [deg]", "boom.q"), (EXCAVATOR, "crowd cylinder cap [bar]", "stick_cylinder.p_head"),
    (LOADER, "Hubzylinder p Kolben [bar]", "lift_cylinder.p_head"), (LOADER, "boom angle [deg]", "lift.q"),
    (LOADER, "Hubgerüst Winkel [°]", "lift.q"), (LOADER, "Schaufelzylinder Druck Ring [bar]", "tilt_cylinder.p_rod"),
    (LOADER, "Schaufel Winkel [°]", "bucket.q"), (KNUCKLE, "Hubzylinder Druck Boden [bar]", "main_cylinder.p_head"),
    (KNUCKLE, "Knickarmwinkel [°]", "knuckle.q"),
    (KNUCKLE, "Knickzylinder Druck Stange [bar]", "knuckle_cylinder.p_rod"),
    (KNUCKLE, "main boom angle [deg]", "main.q"), (KNUCKLE, "Ausschub Weg [mm]", "telescope.q"),
    (KNUCKLE, "Kransäule Winkel [°]", "slew.q"), (CRANE, "Hubzylinder Druck Boden [bar]", "main_cylinder.p_head"),
    (CRANE, "Hauptarm Winkel [°]", "main_boom.q"), (CRANE, "Knickarm Winkel [°]", "outer_boom.q"),
    (CRANE, "Knickzylinder Druck Stange [bar]", "outer_cylinder.p_rod")])
def test_what_people_call_a_part_is_what_the_machine_has(parts: tuple[str, ...], header: str, channel: str) -> None:
    found = names(*parts, **({"telescope.q": "m"} if channel == "telescope.q" else {}))
    scores = {name: found.fit(name, found.naming(header)) for name in found.channels}
    if channel == "telescope.q":
        scores.pop("telescope_cylinder.length")  # which is as far out
    best = max(scores.values())
    assert best > 0
    assert [name for name, score in scores.items() if score == best] == [channel]


@pytest.mark.parametrize(("header", "channel"), [
    ("Auslegerzylinder Druck bodenseitig [bar]", "boom_cylinder.p_head"),
    ("Boom ram annulus [kPa]", "boom_cylinder.p_rod"), ("Boom Cyl. Cap End Pressure (MPa)", "boom_cylinder.p_head"),
    ("Slew motor port A [kPa]", "swing_motor.p_a"), ("Dipper ram piston side psi", "stick_cylinder.p_head"),
    ("Stielzylinder Kolbenstangenseite bar", "stick_cylinder.p_rod")])
def test_words_of_chambers(header, channel):
    found = names("boom_cylinder", "stick_cylinder", "swing_motor")
    assert found.fit(channel, found.naming(header)) == 2


def test_a_name_without_a_part_is_that_of_the_only_channel():
    alone, two = names("lift", "lift_cylinder"), names("lift", "tilt", "lift_cylinder", "lift_motor")
    for header, channel in (("angle [deg]", "lift.q"), ("p_head [bar]", "lift_cylinder.p_head"),
                            ("Druck A [bar]", None), ("Drehzahl [rpm]", None), ("angle 2 [deg]", None),
                            ("pressure [bar]", None)):
        assert alone.fit_alone(alone.naming(header)) == channel
    assert two.fit_alone(two.naming("angle [deg]")) is None


def test_an_inclination_is_never_sure_where_two_channels_may_be_it():
    alone, both = names("boom"), names("boom", "boom_imu")
    for header in ("boom tilt [deg]", "boom_pitch_deg", "Ausleger Neigung (°)"):
        assert alone.fit("boom.q", alone.naming(header)) == 1
        assert {both.fit(channel, both.naming(header)) for channel in ("boom.q", "boom_imu.pitch")} == {1}
        upright = ChannelNames(alone.channels, frozenset({"boom"}))
        assert upright.fit("boom.q", upright.naming(header)) == 0


@pytest.mark.parametrize("quantity", spellings.SUFFIXES)
def test_usual_spellings_are_proposed_and_none_is_wrong(quantity, tmp_path):
    """A slice of the study `first_contact`, seeded."""
    some = [each for each in spellings.spellings() if each.quantity == quantity]
    chosen = some[np.random.default_rng(47).integers(len(some))]
    assert spellings.proposed(chosen, tmp_path) == (True, False), chosen


@pytest.mark.parametrize(("kind", "storage", "topic"), [
    ("pressure", "SQLITE3", "/{p}/{c}_pressure"), ("imu", "MCAP", "/{p}_imu/data"),
    ("joints", "ros1", "/joint_states")])
def test_messages_with_units_by_convention_are_sure(kind, storage, topic, tmp_path):
    """Topics that name part and chamber, also one alone, whose name the map need not state."""
    count, sure, wrong = spellings.sure_signals(tmp_path, kind, storage, topic)
    assert (count, sure, wrong) == ({"pressure": 4, "imu": 24, "joints": 3}[kind], count, 0)


def test_a_topic_alone_names_its_signal(tmp_path):
    assert spellings.sure_signals(tmp_path, "joints", "ros1", "/excavator/joint_states") == (3, 3, 0)
    assert spellings.sure_signals(tmp_path, "pressure", "MCAP", "/boom/head_pressure") == (1, 1, 0)


def test_a_line_to_fill_in_has_the_unit_of_the_file(machine, log, tmp_path):
    names = FOREIGN | {"boom.q": ("Angle (°)", "deg", 180 / np.pi),
                       "boom_cylinder.p_head": ("Druck 1 [bar]", "bar", 1e-5)}
    found = propose_map(foreign(log, tmp_path / "run.csv", names), machine)
    assert found.missing == {"boom.q": "deg", "boom_cylinder.p_head": "bar"}
    assert '# "boom.q" = { column = "?", unit = "deg" }' in found.toml()


def test_a_log_of_an_imu_has_its_units_by_gravity(tmp_path):
    """Which every axis measures, and which the rates turn; also where no header states a unit."""
    for spelling in spellings.spellings():
        if spelling.unit == "none-dps" and not spelling.number:
            assert spellings.proposed(spelling, tmp_path) == (True, False)
