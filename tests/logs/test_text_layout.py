"""Tables of text in every layout: what is decided is shown, and what could be either is refused."""

import gzip
import itertools

import numpy as np
import pytest
from pydantic import ValidationError

from hydroopt.errors import LogError
from hydroopt.logs.column_map import LogMap
from hydroopt.logs.log_files import read_log, read_recording
from hydroopt.logs.map_proposal import propose_map
from hydroopt.machine.machine_file import load_machine
from studies.first_contact.layouts import SPOILT, layouts, read_back, spoilt, spoilt_layouts, written, wrong

N = 60
T = np.arange(N) / 50
Q = 30 * np.sin(T)
P = 100 + 20 * np.cos(T)
NAMES, UNITS = ["t", "boom.q", "boom_cylinder.p_head"], ["s", "deg", "bar"]


def cells(decimal=".", digits=6, thousands=""):
    return [[f"{x:{',' if thousands else ''}.{digits}f}".replace(",", "#").replace(".", decimal).replace("#", thousands)
             for x in row] for row in zip(T, Q, P, strict=True)]


def table(delimiter=",", decimal=".", *, above=(), header=None, below=(), end="\n", **more):
    header = header or [f"{name} [{unit}]" for name, unit in zip(NAMES, UNITS, strict=True)]
    rows = [delimiter.join(row) for row in cells(decimal, **more)]
    return end.join([*above, delimiter.join(header), *below, *rows]) + end


TRIED = list(layouts(3000, seed=5))[90::110]
"""A slice of the layouts of the study `first_contact`, the random ones."""


@pytest.mark.parametrize("layout", TRIED, ids=range(len(TRIED)))
def test_what_map_proposes_is_read_with_that_very_map(tmp_path, layout):
    made = written(layout, rows=40)
    assert wrong(made, read_back(made, tmp_path)) == []


@pytest.mark.parametrize(("layout", "kind"), list(zip(spoilt_layouts(len(SPOILT)), SPOILT, strict=True)),
                         ids=SPOILT)
def test_damage_is_refused_with_the_number_of_its_line(tmp_path, layout, kind):
    made, line = spoilt(written(layout, rows=40), kind)
    with pytest.raises(LogError, match=rf"log\.csv, line {line}[:,]"):
        read_back(made, tmp_path)


def test_what_was_decided_is_said_and_a_map_that_states_it_needs_no_word(tmp_path):
    file, to = tmp_path / "log.csv", tmp_path / "map.toml"
    file.write_bytes(table(";", ",", above=["Messung 3;Größe", "# x"], header=NAMES, below=[";".join(UNITS)],
                           end="\r\n").encode("latin-1") + b"# paused\r\nEnde\r\n")
    usual = tmp_path / "usual.csv"
    usual.write_text(table())
    log = read_log(file)
    assert {name: x.tobytes() for name, x in log.channels.items()} == {
        name: x.tobytes() for name, x in read_log(usual).channels.items()}
    assert [f.text for f in log.findings if f.kind == "format"] == [
        'the file was read with skip = 2, units_row = true, footer = 1, comment = "#", delimiter = ";", decimal = ",", '
        'encoding = "latin-1"']
    to.write_text(propose_map(file, load_machine("cat215b")).toml())
    mapped = read_log(file, mapping=to)
    assert not [f for f in mapped.findings if f.kind == "format"]
    assert mapped.channels["boom_cylinder.p_head"].tobytes() == log.channels["boom_cylinder.p_head"].tobytes()


KEYS = {"skip": (None, 0, 1, 3, 99), "header": (None, True, False), "units_row": (None, True, False),
        "footer": (None, 0, 1)}


@pytest.mark.parametrize("stated", list(itertools.product(*KEYS.values())))
def test_keys_of_the_layout_may_be_stated_in_any_combination(tmp_path, stated):
    """With a title, a header and a row of units one answer is right by name, one by index; all others are refused."""
    keys = {key: value for key, value in zip(KEYS, stated, strict=True) if value is not None}
    (tmp_path / "log.csv").write_text(table(above=["Logger 7, of 2020"], header=NAMES, below=[",".join(UNITS)]))
    by_name = keys.get("header", True)
    columns = {name: {"column": name if by_name else k, "unit": unit} for k, (name, unit) in enumerate(
        zip(NAMES, UNITS, strict=True))}
    right = {"skip": 1 if by_name else 0, "header": by_name, "units_row": by_name, "footer": 0} | keys
    sound = right in ({"skip": 1, "header": True, "units_row": True, "footer": 0},
                      {"skip": 3, "header": False, "units_row": False, "footer": 0})
    def read():
        return read_log(tmp_path / "log.csv", mapping=LogMap.model_validate({**keys, "columns": columns}))

    if sound:
        np.testing.assert_allclose(read().channels["boom.q"], np.deg2rad(Q), atol=1e-7)
    elif keys.get("header") is False and keys.get("units_row"):
        with pytest.raises(ValidationError, match="'units_row' needs a header"):
            read()
    else:
        with pytest.raises(LogError, match=r"log\.csv"):
            read()


def test_a_map_needs_no_layout(tmp_path):
    header = ["Zeit", "Ausleger (Grad)", "Druck Boden"]
    (tmp_path / "log.txt").write_text(table(";", ",", header=header, above=["Bagger 12;;"]), "latin-1")
    layout = LogMap.model_validate({"columns": {
        "t": {"column": "Zeit", "unit": "s"}, "boom.q": {"column": "Ausleger (Grad)", "unit": "deg"},
        "boom_cylinder.p_head": {"column": "Druck Boden", "unit": "bar"}}})
    log = read_log(tmp_path / "log.txt", mapping=layout)
    np.testing.assert_allclose(log.channels["boom.q"], np.deg2rad(Q), atol=1e-7)
    assert 'delimiter = ";"' in log.findings[0].text


@pytest.mark.parametrize(("name", "content"), [
    ("thousand or decimal", "t [s];boom.tau [N*m]\n0;1,234\n1;2,345\n2;3,456\n"),
    ("thousand or decimal point", "t [s];boom.tau [N*m]\n10;1.234\n11;2.345\n"),
    ("both", "t [s]\tboom.tau [N*m]\n0\t1.234,5\n1\t1,234.5\n")])
def test_a_mark_that_may_be_either_is_refused_with_the_line_that_settles_it(tmp_path, name, content):
    (tmp_path / "log.csv").write_text(content)
    with pytest.raises(LogError, match=r"log\.csv: '\d[.,]\d+\S*' may have decimals or thousands.*; state decimal = '"):
        read_log(tmp_path / "log.csv")


@pytest.mark.parametrize(("stated", "value"), [({"decimal": ","}, 1.234), ({"decimal": ".", "thousands": ","}, 1234.0)])
def test_a_map_settles_the_mark(tmp_path, stated, value):
    (tmp_path / "log.csv").write_text("t;tau\n0;1,234\n1;2,345\n2;3,456\n")
    layout = LogMap.model_validate({**stated, "columns": {
        "t": {"column": "t", "unit": "s"}, "boom.tau": {"column": "tau", "unit": "N*m"}}})
    assert read_log(tmp_path / "log.csv", mapping=layout).channels["boom.tau"][0] == value


@pytest.mark.parametrize(("delimiter", "decimal", "thousands"), [(";", ",", "."), ("\t", ".", ",")])
def test_thousands_are_marked(tmp_path, delimiter, decimal, thousands):
    content = [delimiter.join(["t [s]", "boom.tau [N*m]"])]
    content += [f"{k}{delimiter}" + f"{12345.5 * k + 0.25:,.2f}".replace(",", "#").replace(".", decimal).replace(
        "#", thousands) for k in range(5)]
    (tmp_path / "log.csv").write_text("\n".join(content))
    log = read_log(tmp_path / "log.csv")
    np.testing.assert_array_equal(log.channels["boom.tau"], 12345.5 * np.arange(5) + 0.25)
    assert f'thousands = "{thousands}"' in log.findings[0].text


def test_packed_tables_are_read_and_damaged_ones_refused(tmp_path):
    packed = gzip.compress(table().encode())
    (tmp_path / "log.csv.gz").write_bytes(packed)
    log = read_log(tmp_path / "log.csv.gz")
    assert (log.size, log.name) == (N, "log")
    for damaged in (packed[:-9], packed[:40] + b"\xff\xff" + packed[42:], gzip.compress(b"")):
        (tmp_path / "log.csv.gz").write_bytes(damaged)
        with pytest.raises(LogError, match=r"log\.csv\.gz: (this is not a readable gzip file|the file is empty)"):
            read_log(tmp_path / "log.csv.gz")


def stamped(tmp_path, stamps, header="t [s]", mapping=None, **more):
    rows = "\n".join(f"{stamp};{q}" for stamp, q in zip(stamps, range(len(stamps)), strict=True))
    (tmp_path / "log.csv").write_text(f"{header};boom.q [deg]\n{rows}\n")
    return read_recording(tmp_path / "log.csv", mapping=mapping, **more)


@pytest.mark.parametrize(("header", "stamps", "start"), [
    ("t", ["2026-11-23T04:20:00.000000001Z", "2026-11-23T04:20:00.020000004Z"], "2026-11-23T04:20:00.000000001"),
    ("t", ["2026-11-23 05:20:00,000000001+01:00", "2026-11-23 05:20:00,020000004+01:00"],
     "2026-11-23T04:20:00.000000001"),
    ("t", ["23.11.2026 04:20:00,000000001", "23.11.2026 04:20:00,020000004"], "2026-11-23T04:20:00.000000001"),
    ("t", ["11/23/2026 4:20:00.000000001 AM", "11/23/2026 4:20:00.020000004 AM"], "2026-11-23T04:20:00.000000001"),
    ("t [s]", ["1795407600.000000001", "1795407600.020000004"], "2026-11-23T04:20:00.000000001"),
    ("t [ms]", ["1795407600000.000001", "1795407600020.000004"], "2026-11-23T04:20:00.000000001"),
    ("t [us]", ["1795407600000000.001", "1795407600020000.004"], "2026-11-23T04:20:00.000000001"),
    ("t [ns]", ["1795407600000000001", "1795407600020000004"], "2026-11-23T04:20:00.000000001"),
])
def test_stamps_keep_their_resolution(tmp_path, header, stamps, start):
    recording = stamped(tmp_path, stamps, header)
    assert recording.groups[0].t.tolist() == [0.0, 0.020000003]
    assert recording.start == np.datetime64(start)
    assert [f.kind for f in recording.findings if f.kind == "clock"] == ["clock"]


def test_times_of_day_go_on_after_midnight(tmp_path):
    assert stamped(tmp_path, ["23:59:59.9", "00:00:00.1"], "t").groups[0].t.tolist() == [0.0, 0.2]


@pytest.mark.parametrize(("header", "stamps", "pattern"), [
    ("t", ["03/04/2026 04:20:00", "03/04/2026 04:20:01"], r"may state the day first or the month first; state dates ="),
    ("t [s]", ["1795407600000", "1795407600020"], "in s, but its numbers are an epoch in ms; state its unit as ms"),
    ("t", ["0", "1"], "the column has no unit"),
    ("t", ["2026-11-23 04:20:00", "noon", "2026-11-23 04:20:01"], "line 3, data row 2, column 1 't.*'noon' is no date"),
])
def test_stamps_that_may_be_either_are_refused(tmp_path, header, stamps, pattern):
    with pytest.raises(LogError, match=pattern):
        stamped(tmp_path, stamps, header)


def test_an_absurd_stamp_among_epochs_is_dropped_and_named(tmp_path):
    recording = stamped(tmp_path, ["1795407600", "9" * 40, "1795407601", "1795407602"])
    assert recording.groups[0].sample.tolist() == [1, 3, 4]
    assert "t: sample 2 holds no finite number; dropped" in [one.text for one in recording.findings]


def test_a_map_settles_day_and_month(tmp_path):
    layout = LogMap.model_validate({"dates": "day first", "columns": {
        "t": {"column": "t"}, "boom.q": {"column": "boom.q [deg]", "unit": "deg"}}})
    recording = stamped(tmp_path, ["03/04/2026 04:20:00", "03/04/2026 04:20:01"], "t", layout)
    assert recording.start == np.datetime64("2026-04-03T04:20:00")


def test_columns_of_their_own_clocks_are_groups(tmp_path):
    rows = [f"{k / 100},{k},{k / 50 + 0.3 if k < 40 else ''},{k if k < 40 else ''}" for k in range(100)]
    (tmp_path / "log.csv").write_text("t1,angle,t2,pressure\n" + "\n".join(rows))
    layout = LogMap.model_validate({
        "columns": {"t": {"column": "t1", "unit": "s"}, "boom.q": {"column": "angle", "unit": "deg"},
                    "boom_cylinder.p_head": {"column": "pressure", "unit": "bar", "group": "can"}},
        "clocks": {"can": {"t": {"column": "t2", "unit": "s"}, "delay": "300 ms ± 10 ms", "drift": "0 % ± 0.5 %"}}})
    recording = read_recording(tmp_path / "log.csv", mapping=layout)
    assert [(group.name, group.size) for group in recording.groups] == [("", 100), ("can", 40)]
    clock = recording.clocks["can"]
    assert (clock.delay, clock.delay_std, clock.drift_std) == (0.3, 0.01, 0.005)
    log = recording.log()
    np.testing.assert_allclose(log.channels["boom_cylinder.p_head"], 1e5 * 50 * log.t, atol=1e-6)
    assert log.t[-1] == 0.78


def test_columns_with_numbers_in_some_rows_are_groups_and_empty_ones_left_out(tmp_path):
    rows = [f"{k / 100},{k},{k if k % 5 == 0 else ''},," for k in range(101)]
    (tmp_path / "log.csv").write_text("t [s],boom.q [deg],boom_cylinder.p_head [bar],boom_cylinder.p_rod [bar],note\n"
                                      + "\n".join(rows))
    recording = read_recording(tmp_path / "log.csv")
    assert [group.size for group in recording.groups] == [101, 21]
    assert [f.kind for f in recording.findings] == ["ignored", "empty", "sparse"]
    np.testing.assert_allclose(recording.log().channels["boom_cylinder.p_head"], 1e5 * np.arange(101), rtol=1e-12)
    with pytest.raises(LogError, match="would be left"):
        read_recording(tmp_path / "log.csv", treatment={"nan": "drop"}).log()


def test_groups_with_and_without_dates_need_a_start(tmp_path):
    (tmp_path / "a.csv").write_text("t;boom.q [deg]\n2026-11-23T04:20:00;1\n2026-11-23T04:20:01;2\n")
    (tmp_path / "b.csv").write_text("t [s];stick.q [deg]\n0;1\n1;2\n")
    with pytest.raises(LogError, match=r"times of 'b' have no date.*start = .*\[clocks.\"b\"\]"):
        read_recording([tmp_path / "a.csv", tmp_path / "b.csv"])
