"""Units in headers of many loggers: what is one, what has several meanings, and what only looks like one."""

from __future__ import annotations

import tomllib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hydroopt.errors import LogError
from hydroopt.logs.column_words import ChannelNames
from hydroopt.logs.log import Log
from hydroopt.logs.log_files import read_log
from hydroopt.logs.map_proposal import propose_map
from hydroopt.logs.unit_words import header_of, spellings, units_of
from hydroopt.machine.machine_file import load_machine
from hydroopt.machine.quantity import CHANNEL_UNITS
from hydroopt.model.model import Model
from hydroopt.simulation.simulate import random_trajectory, simulate
from hydroopt.units import UnitError, factor, same_kind

# as found in public code and manuals of loggers, and as engineers write them
REAL = {
    "Zeit [ms]": "ms", "Zeit ms": "ms", "Time (msec)": "ms", "Listen Time (mSec)": "ms", "Tiempo (ms)": "ms",
    "temps (s)": "s", "pc_time_s": "s", "arduino_ms": "ms", "host_rx_time_us": "us", "t / s": "s", "Zeit,ms": "ms",
    "timeMs": "ms", "Zeitstempel Sek.": "s", "Aika sekuntia": "s", "jikan miribyo": "ms", "Elapsed Time in µs": "us",
    "Winkel [Grad]": "deg", "Saling-Winkel [Grad]": "deg", "Einfallswinkel [Grad]": "deg", "winkel_grad": "deg",
    "Winkel in Grad": "deg", "Winkel Grad": "deg", "angle_deg": "deg", "BoomAngleDeg": "deg", "Kulma astetta": "deg",
    "Vinkel grader": "deg", "Ángulo pluma grados": "deg", "Angle flèche (degrés)": "deg", "Pitch (Degrees)": "deg",
    "Roll°": "deg", "Stick º": "deg", "Boom {deg}": "deg", "theta1[rad]": "rad",
    "Druck [bar]": "bar", "Betriebsdruck [bar]": "bar", "Druck Boom bar": "bar", "pressure_bar": "bar",
    "p / bar": "bar", "p/bar": "bar", "p in bar": "bar", "Paine baaria": "bar", "Presión (bar)": "bar",
    "Head pressure bar(g)": "bar", "Tubing_Head_Pressure_PSI": "psi", "chamberPressurePsi": "psi",
    "Supply pressure, psig": "psi", "Pressure(kPa)": "kPa", "P1_KPA": "kPa", "Barometric Pressure (Kilopascal)": "kPa",
    "Pression Atmosphérique (hectopascal)": "hPa", "p in kg/cm²": "kgf/cm^2", "boom_p_mpa": "MPa", "p [mPa]": "mPa",
    "Zustellung Mast-Controller [mm]": "mm", "Weg Zylinder Millimeter": "mm", "Stroke (in)": "in", "Stick Mm": "mm",
    "vibration_mm_s": "mm/s", "v_mean_m_per_s": "m/s", "chamber_velocity_mps": "m/s", "Geschwindigkeit [m/s]": "m/s",
    "Drehrate [Grad/s]": "deg/s", "Boom rate °/s": "deg/s", "Rotation rate degrees per second": "deg/s",
    "Gyro X (dps)": "deg/s", "v / (mm/s)": "mm/s", "a [m/s²]": "m/s^2", "Engine Speed (RPM)": "rpm",
    "Drehzahl U/min": "rpm", "Kraft [kN]": "kN", "Moment Nm": "N*m", "Throttle Position (Percent)": "%",
    "Gyro X (mdps)": "mdeg/s", "acc_x (mg)": "mg_0", "p_kbar": "kbar", "a [m/s**2]": "m/s^2", "v_radpersec": "rad/s",
    "boomVelDegS": "deg/s", "M [N.m]": "N.m", "n [1/min]": "rpm", "p [bar(a)]": "bar",
    "p_psia": "psi", "Q [l/min]": "l/min",
    "Kraft [kn]": "kN", "position[boom] [rad or m]": "rad",
    "Kanal A [V]": "V", "Joystick mV": "mV", "Valve current (mA)": "mA",
}
NONE = ("boom_max", "boom_min", "swing_a", "swing A", "swing_motor.p_a", "boom_u", "oil in", "boom_cap", "Head/Rod",
        "A/B", "Boom/Stick", "Boom P", "boom_head", "stick_rod", "P45", "timeStamp", "IAS", "Oil temp", "boom.q",
        "pos_d", "joint_t", "handlebar", "Rod end", "axis_h", "pressure [raw]", "Boom (left)", "s", "bar_count")


@pytest.mark.parametrize(("header", "unit"), REAL.items())
def test_units_of_real_headers_are_read(header: str, unit: str) -> None:
    found = header_of(header)
    assert found.units[:1] == (unit,)
    assert found.name
    assert found.name in header


@pytest.mark.parametrize("header", NONE)
def test_names_that_look_like_units_stay_names(header: str) -> None:
    assert header_of(header) == (header, "", ())


def test_words_of_parts_are_no_units_but_in_brackets() -> None:
    assert header_of("tow_bar", {"tow", "bar"}).units == ()
    assert header_of("tow_bar [bar]", {"tow", "bar"}).units == ("bar",)
    assert header_of("boom_bar", {"tow", "boom"}).units == ("bar",)


def test_several_meanings_stay_several_unless_the_name_tells() -> None:
    assert header_of("boom angle [grad]").units == ("deg", "gon")
    assert header_of("Ausleger Neigung [grad]").units == ("deg",)
    assert header_of("acc_x [g]").units == ("g_0", "g")
    assert header_of("motor_torque_nm").units == ("N*m", "nm")


@pytest.mark.parametrize("unit", [*spellings()["units"], *spellings()["units_as_written"].values()])
def test_every_unit_of_the_table_is_one_and_stands_for_itself(unit: str) -> None:
    assert same_kind(unit, unit)
    assert unit in units_of(unit)


def test_no_word_has_two_units_by_accident() -> None:
    """Those of several differ in kind, or are degrees and gon."""
    words = [word for words in spellings()["units"].values() for word in words.split()]
    several = {word: units_of(word) for word in words if words.count(word) > 1}
    assert several.pop("grad") == ("deg", "gon")
    for units in several.values():
        assert not any(same_kind(one, other) for one in units for other in units if one != other)


@pytest.mark.parametrize("unit", sorted({unit for units in CHANNEL_UNITS.values() for unit in units} - {"1"}))
def test_the_projects_own_units_stand_for_themselves(unit: str) -> None:
    assert units_of(unit) == (unit,)


@given(st.text(max_size=25))
def test_any_header_has_parts(header: str) -> None:
    found = header_of(header)
    assert all(same_kind(unit, unit) for unit in found.units)
    assert bool(found.units) == bool(found.text)


GERMAN = {"t": ("Zeit ms", 1e3), "boom.q": ("Ausleger Winkel Grad", 180 / np.pi),
          "stick.q": ("Stiel (Grad)", 180 / np.pi), "swing.q": ("Drehwerk Winkel [Grad]", 180 / np.pi),
          "boom_cylinder.p_head": ("Druck Ausleger Kolbenseite bar", 1e-5),
          "boom_cylinder.p_rod": ("Druck Ausleger Stangenseite / bar", 1e-5),
          "stick_cylinder.p_head": ("StielKolbenseitePsi", 1 / 6894.757293168361),
          "stick_cylinder.p_rod": ("stiel_stangenseite_kpa", 1e-3),
          "boom_cylinder.length": ("Ausleger Zylinder Weg in mm", 1e3)}


@pytest.fixture(scope="module")
def log() -> Log:
    model = Model(load_machine("cat215b"))
    return simulate(model, random_trajectory(model, duration=8, rate=50, seed=3), seed=3)


def written(log: Log, path, names):
    columns = {header: scale * (log.t if channel == "t" else log.channels[channel])
               for channel, (header, scale) in names.items()}
    rows = [";".join(f"{x!r}" for x in map(float, row)) for row in zip(*columns.values(), strict=True)]
    path.write_text("\n".join([";".join(columns), *rows]))
    return path


def test_a_german_log_is_read_as_proposed(log, tmp_path):
    path = written(log, tmp_path / "run.csv", GERMAN)
    found = propose_map(path, load_machine("cat215b"))
    sureness = {each.channel: each.sureness for each in found.proposals}
    assert sureness == dict.fromkeys(GERMAN, "sure") | {"stick.q": "likely"}  # whose name states no quantity
    assert "in deg ('Grad')" in next(each.reason for each in found.proposals if each.channel == "stick.q")
    (tmp_path / "map.toml").write_text(found.toml())
    read = read_log(path, mapping=tmp_path / "map.toml")
    np.testing.assert_allclose(read.t, log.t, rtol=1e-12, atol=1e-12)
    for channel in set(GERMAN) - {"t"}:
        np.testing.assert_allclose(read.channels[channel], log.channels[channel], rtol=1e-11, atol=1e-11)


def test_an_ambiguous_word_is_a_question_unless_one_meaning_alone_is_possible(log, tmp_path):
    machine = load_machine("cat215b")
    lower, upper = machine.link("boom").joint.range
    inner = Log("small", log.t, {"boom.q": np.linspace(0.5 * lower, 0.5 * upper, len(log.t))})
    path = written(inner, tmp_path / "small.csv", {"t": ("t_ms", 1e3), "boom.q": ("boom angle grad", 180 / np.pi)})
    found = propose_map(path, machine)
    boom = next(each for each in found.proposals if each.channel == "boom.q")
    assert (boom.sureness, boom.unit) == ("guess", "deg")
    assert boom.reason.endswith("'grad' may be deg or gon: write the right unit")
    assert "boom.q" not in tomllib.loads(found.toml())["columns"]
    whole = Log("whole", log.t, {"boom.q": np.linspace(lower, upper, len(log.t))})
    path = written(whole, tmp_path / "whole.csv", {"t": ("t_ms", 1e3), "boom.q": ("boom angle grad", 200 / np.pi)})
    boom = next(each for each in propose_map(path, machine).proposals if each.channel == "boom.q")
    assert (boom.sureness, boom.unit) == ("likely", "gon")
    assert boom.reason.endswith("of these its values allow gon alone")


def test_a_pressure_of_a_part_without_its_chamber_is_a_question(log, tmp_path):
    path = written(log, tmp_path / "run.csv", {"t": ("Zeit ms", 1e3), "boom_cylinder.p_head": ("Druck Boom bar", 1e-5),
                                               "stick_cylinder.p_head": ("stick_max_bar", 1e-5)})
    found = propose_map(path, load_machine("cat215b"))
    assert [each.channel for each in found.proposals] == ["t"]
    assert dict(found.possible) == {"Druck Boom bar": ("boom_cylinder.p_head", "boom_cylinder.p_rod")}
    assert '# "Druck Boom bar"  # boom_cylinder.p_head or boom_cylinder.p_rod? Its name does not say' in found.toml()
    assert set(tomllib.loads(found.toml())["columns"]) == {"t"}


def test_headers_that_leave_part_or_chamber_open_are_questions(log, tmp_path):
    """By quantity alone, by ports A and B, by part alone without a unit; each line to fill in is then a map's."""
    chambers = ("boom_cylinder.p_head", "boom_cylinder.p_rod", "stick_cylinder.p_head", "stick_cylinder.p_rod",
                "swing_motor.p_a", "swing_motor.p_b")
    path = written(log, tmp_path / "run.csv", {
        "t": ("t [ms]", 1e3), "boom.q": ("Angle (Grad)", 180 / np.pi), "stick.q": ("Stick", 180 / np.pi),
        "boom_cylinder.p_head": ("Druck_A (bar)", 1e-5), "boom_cylinder.p_rod": ("Ausleger Druck_B (bar)", 1e-5),
        "boom_cylinder.length": ("Kolbenweg [mm]", 1e3), "stick_cylinder.p_head": ("P3", 1e-5),
        "swing_motor.p_a": ("swing_left_bar", 1e-5)})
    found = propose_map(path, load_machine("cat215b"))
    assert dict(found.possible) == {
        "Angle (Grad)": ("swing.q", "boom.q", "stick.q"), "Stick": ("stick.q", *chambers[2:4]),
        "Druck_A (bar)": chambers, "Ausleger Druck_B (bar)": chambers[:2], "P3": chambers,
        "swing_left_bar": chambers[4:],
        "Kolbenweg [mm]": ("boom_cylinder.length", "stick_cylinder.length")}
    text = found.toml()
    for channel, column, unit in (("boom.q", "Angle (Grad)", "deg"), ("boom_cylinder.p_head", "Druck_A (bar)", "bar")):
        (line,) = (line for line in text.splitlines() if line.startswith(f'# "{channel}" ='))
        filled = line[2:].replace('"?"', f'"{column}"')
        text = text.replace(line, filled[:filled.index("unit")] + f'unit = "{unit}" }}')
    (tmp_path / "map.toml").write_text(text)
    read = read_log(path, mapping=tmp_path / "map.toml")
    np.testing.assert_allclose(read.channels["boom.q"], log.channels["boom.q"], atol=1e-12)
    np.testing.assert_allclose(read.channels["boom_cylinder.p_head"], log.channels["boom_cylinder.p_head"], rtol=1e-12)


def test_a_clock_without_a_name_is_the_only_one_in_a_unit_of_time(log, tmp_path):
    path = written(log, tmp_path / "run.csv", {"t": ("arduino_ms", 1e3), "boom.q": ("boom angle deg", 180 / np.pi)})
    time = propose_map(path, load_machine("cat215b")).proposals[0]
    assert (time.channel, time.unit, time.sureness) == ("t", "ms", "likely")
    assert time.reason == "the only column in a unit of time, ms, that increases"


def test_a_row_of_units_may_have_such_words(log, tmp_path):
    path = tmp_path / "run.csv"
    written(log, path, {"t": ("Zeit", 1e3), "boom.q": ("Ausleger Winkel", 180 / np.pi)})
    head, *rows = path.read_text().splitlines()
    path.write_text("\n".join([head, "Millisekunden;Grad", *rows]))
    found = {each.channel: (each.unit, each.sureness) for each in propose_map(path, load_machine("cat215b")).proposals}
    assert found == {"t": ("ms", "sure"), "boom.q": ("deg", "sure")}


def test_headers_with_channels_own_names_take_such_words_or_ask(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("t [Sek.],boom.q [Grad]\n0,10\n0.1,20\n0.2,30\n")
    np.testing.assert_allclose(read_log(path).channels["boom.q"], np.radians([10, 20, 30]), rtol=1e-12)
    path.write_text("t [s],boom.q [grad]\n0,10\n0.1,20\n0.2,30\n")
    with pytest.raises(LogError, match="'grad' may be deg or gon") as refused:
        read_log(path)
    assert "boom.q [deg]" in refused.value.remedy


def test_a_gigaradian_is_refused():
    with pytest.raises(UnitError, match="gigaradian") as refused:
        factor("Grad/s", "rad/s")
    assert "deg/s" in refused.value.remedy


def test_the_time_alone_may_be_a_unit():
    for header, unit in (("ms", "ms"), ("Sekunden", "s")):
        named = ChannelNames({}).naming(header)
        assert (named.is_time, named.units) == (True, (unit,))
