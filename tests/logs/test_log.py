import gzip
import hashlib
import itertools
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy.io import savemat

from hydroopt.errors import HydrooptError, LogError, ProblemError
from hydroopt.logs import quality
from hydroopt.logs.log import Log, LogMap, read_map
from hydroopt.logs.log_files import read_log

ROOT = Path(__file__).parents[2]
DATA = ROOT.parent / "shared" / "data"
HEADER = "t [s],boom.q [deg],boom_cylinder.p_head [bar]"


def text(n=100, header=HEADER, **changes):
    """A clean CSV; `r7="..."` replaces data row 7."""
    rng = np.random.default_rng(0)
    rows = [f"{k * 0.01:.3f},{30 * np.sin(k / 20):.6f},{100 + 20 * np.cos(k / 15) + rng.normal(0, 0.1):.4f}"
            for k in range(n)]
    for key, row in changes.items():
        rows[int(key[1:]) - 1] = row
    return "\n".join([header, *rows]) + "\n"


@pytest.fixture
def csv(tmp_path):
    def write(content, name="log.csv"):
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path
    return write


def kinds(log):
    return [f.kind for f in log.findings]


def test_units_become_si_and_provenance_is_kept(csv):
    path = csv("\ufeff" + text())
    log = read_log(path)
    assert log.t.size == 100
    np.testing.assert_allclose(log.channel("boom.q"), np.deg2rad(30 * np.sin(np.arange(100) / 20)), atol=1e-7)
    assert 7.9e6 < log.channel("boom_cylinder.p_head").min() < 8.2e6
    assert log.units == {"boom.q": "rad", "boom_cylinder.p_head": "Pa"}
    assert log.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    assert log.findings == ()
    assert list(log.sample[:3]) == [1, 2, 3]
    with pytest.raises(ValueError, match="read-only"):
        log.t[0] = 1


def test_a_missing_channel_names_what_is_there(csv):
    with pytest.raises(LogError, match=r"log\.csv: there is no channel 'stick.q' \(present: boom.q, .*deg"):
        read_log(csv(text())).channel("stick.q")


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_written_logs_read_back_exactly(csv, tmp_path, suffix):
    log = read_log(csv(text()))
    log.write(tmp_path / f"copy.{suffix}")
    again = read_log(tmp_path / f"copy.{suffix}")
    for name in log.channels:
        np.testing.assert_array_equal(again.channel(name), log.channel(name))
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(["log.csv", f"copy.{suffix}"])


def test_prismatic_joints_and_commands_keep_their_kind(csv):
    log = read_log(csv("t [s],slide.q [mm],slide.tau [kN],valve.u [V]\n0,1000,2,5\n1,2000,3,6\n"))
    assert dict(log.units) == {"slide.q": "m", "slide.tau": "N", "valve.u": "V"}
    np.testing.assert_allclose(log.channel("slide.tau"), [2000, 3000])


BROKEN = {
    "no unit": (text(header=HEADER.replace("boom.q [deg]", "boom.q")),
                r"column 2 'boom.q'.*no unit.*boom.q \[rad\]"),
    "wrong unit": (text(header=HEADER.replace("[deg]", "[bar]")), "'bar' does not suit"),
    "unknown suffix": (text(header=HEADER.replace("boom.q", "boom.angle")), "'boom.angle' is not a channel"),
    "twice": (text(header="t [s],boom.q [deg],boom.q [rad]"), "twice"),
    "no time": (text(header=HEADER.replace("t [s]", "time")), r"no column 't \[s\]'"),
    "text cell": (text(r12="0.110,abc,100"), r"data row 12, column 2 'boom.q .*': 'abc' is not"),
    "ragged": (text(r12="0.110,1"), "data row 12 is damaged"),
    "cut": (text() + "1.0,2", "data row 101 is damaged"),
    "garbage number": (text(r12="0.110,1e200,100"), "data row 12 is damaged"),
    "repeated": (text(r12="0.100,3,100"), "t: sample 12 .*--treat duplicate=first"),
    "backwards": (text(r12="-3,3,100"), "t: sample 12 .*--treat non-monotonic=drop"),
    "header only": (HEADER + "\n", "no data"),
    "one row": (text(1), "only one data row"),
    "empty": ("", "empty"),
    "blank": (" \n\n", "empty"),
    "binary": (b"\x00\x01\x02\xff" * 100, "binary"),
    "latin garbage": (bytes(range(128, 256)) * 20, "binary"),
    "time only": ("t [s]\n0\n1\n", "no column is a channel"),
}


@pytest.mark.parametrize("case", BROKEN)
def test_damaged_files_are_refused_in_one_sentence(csv, case):
    content, pattern = BROKEN[case]
    with pytest.raises(LogError, match=pattern) as caught:
        read_log(csv(content))
    assert "log.csv" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("name", "pattern"), [
    ("none.csv", "no such file"), (".", "not a file"), ("log.docx", "not a kind"),
    ("log.xlsx", "not a readable spreadsheet"),
    ("log.parquet", "not a readable Parquet"), ("log.mat", "not a readable MATLAB")])
def test_wrong_files(csv, tmp_path, name, pattern):
    if name.startswith("log"):
        csv(text(), name)
    with pytest.raises(LogError, match=pattern):
        read_log(tmp_path / name)


def test_foreign_columns_are_left_out_and_named(csv):
    log = read_log(csv("t [s],boom.q [rad],comment\n0,1,ok\n1,2,fine\n"))
    assert list(log.channels) == ["boom.q"]
    assert "comment" in log.findings[-1].text


@pytest.mark.parametrize("cell", ["", "inf", "nan"])
def test_a_sample_without_angle_is_dropped_one_without_force_serves_others(csv, cell):
    log = read_log(csv(text(r12=f"0.110,{cell},100")))
    assert (log.size, 12 in log.sample) == (99, False)
    assert "sample 12 holds no finite number; dropped" in log.findings[0].text
    log = read_log(csv(text(r12=f"0.110,3,{cell}")))
    assert (log.size, np.flatnonzero(np.isnan(log.channels["boom_cylinder.p_head"])).tolist()) == (100, [11])
    assert "sample 12 holds no finite number; used for other actuators" in log.findings[0].text
    with pytest.raises(LogError, match=r"sample 12 .*--treat nan=use or --treat nan=drop or --treat nan=interpolate"):
        read_log(csv(text(r12=f"0.110,{cell},100")), treatment={"nan": "error"})


@pytest.mark.parametrize(("row", "treatment", "count", "value"), [
    ("0.110,,100", {"nan": "drop"}, 99, None),
    ("0.110,,100", {"nan": "interpolate"}, 100, 30 * np.sin(11 / 20)),
    ("0.100,0,100", {"duplicate": "first"}, 99, None),
    ("-3,0,100", {"non-monotonic": "drop"}, 99, None),
    ("0.110,90,100", {"spike": "drop"}, 99, None),
    ("0.110,90,100", {"spike": "interpolate"}, 100, 30 * np.sin(11 / 20))])
def test_treatments(csv, row, treatment, count, value):
    log = read_log(csv(text(r12=row)), treatment=treatment)
    assert log.t.size == count
    assert (12 in log.sample) == (count == 100)
    found = log.findings[0]
    assert (found.kind, found.first, found.count) == (next(iter(treatment)), 12, 1)
    if value is not None:
        assert log.channel("boom.q")[11] == pytest.approx(np.deg2rad(value), abs=1e-3)


def test_duplicates_are_averaged(csv):
    log = read_log(csv(text(r12="0.100,20,100")), treatment={"duplicate": "mean"})
    assert np.rad2deg(log.channel("boom.q")[10]) == pytest.approx((30 * np.sin(0.5) + 20) / 2)


@pytest.mark.parametrize("treatment", [{"nonsense": "drop"}, {"nan": "keep"}])
def test_unknown_treatments_are_refused(csv, treatment):
    with pytest.raises(ProblemError, match="use one of"):
        read_log(csv(text()), treatment=treatment)


def test_gaps_split_the_log(csv):
    lines = text().splitlines()
    log = read_log(csv("\n".join(lines[:41] + lines[61:])))
    assert kinds(log) == ["gap"]
    assert (log.segment[39], log.segment[40], log.sample[40]) == (0, 1, 41)
    first, second = log.split(0.5)
    assert first.findings == ()
    assert kinds(second) == ["gap"]
    assert first.t.size + second.t.size == log.t.size


def made(n=2000, seed=0):
    t = np.arange(n) / 50
    rng = np.random.default_rng(seed)
    return {"t [s]": t, "a.q [rad]": np.sin(0.9 * t) + rng.uniform(-2e-3, 2e-3, n),
            "b.q [rad]": np.cos(0.5 * t) + rng.uniform(-2e-3, 2e-3, n),
            "c.p_head [Pa]": 1e7 + 1e6 * np.sin(0.7 * t) + rng.normal(0, 1e4, n)}


def stored(columns, tmp_path):
    pq.write_table(pa.table(columns), tmp_path / "made.parquet")
    return tmp_path / "made.parquet"


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("noisy", [True, False])
def test_clean_logs_raise_no_alarm(tmp_path, seed, noisy):
    columns = made(seed=seed)
    if not noisy:
        t = columns["t [s]"]
        s = np.clip((t - 5) / 4, 0, 1)
        columns = {"t [s]": t, "a.q [rad]": 0.8 * (10 * s**3 - 15 * s**4 + 6 * s**5),
                   "b.q [rad]": np.round(np.sin((0.3 + 0.1 * seed) * t) / 4e-4) * 4e-4,
                   "c.tau [N*m]": 100 * np.sign(np.cos(0.5 * t)) + 30 * np.sin(2 * t)}
    assert read_log(stored(columns, tmp_path)).findings == ()


@pytest.mark.parametrize(("shock", "found"), [(4e-7, 0), (5e-6, 1)])
def test_what_no_instrument_resolves_is_no_spike(tmp_path, shock, found):
    """A simulated length without noise, whose oil gives way by micrometres as another cylinder starts and stops."""
    t = np.arange(2000) / 100
    length = 0.8 + 2e-6 * np.sin(0.7 * t) + 1e-9 * np.sin(40 * t)
    length[[700, 1300]] += shock
    other = np.sin(t) + 1e-3 * np.random.default_rng(1).standard_normal(t.size)
    log = read_log(stored({"t [s]": t, "a.length [m]": length, "b.q [rad]": other}, tmp_path))
    assert len(log.findings) == found


def test_stuck_saturated_and_spiky_sensors_are_found(tmp_path):
    columns = made()
    columns["a.q [rad]"][400:500] = columns["a.q [rad]"][400]
    columns["b.q [rad]"][1200:1203] += 0.2
    columns["c.p_head [Pa]"] = np.minimum(columns["c.p_head [Pa]"], 1.08e7)
    columns["d.length [m]"] = np.full(2000, 0.7)
    path = stored(columns, tmp_path)
    found = {(f.kind, f.channel): f for f in read_log(path).findings}
    assert set(found) == {("stuck", "a.q"), ("stuck", "d.length"),
                          ("spike", "b.q"), ("saturated", "c.p_head")}
    assert (found["stuck", "a.q"].first, found["stuck", "a.q"].last) == (401, 500)
    assert found["spike", "b.q"].first == 1201
    assert 1203 <= found["spike", "b.q"].last <= 1206
    assert found["stuck", "d.length"].count == 2000
    assert found["saturated", "c.p_head"].text.endswith(
        "rest at 1.08e+07 Pa, the channel's own extreme, as if the sensor's range ended there")
    with pytest.raises(LogError, match="would be left"):
        read_log(path, treatment={"stuck": "drop"})


def test_limits_of_a_sensor_count_as_saturation(tmp_path):
    path = stored(made(), tmp_path)
    log = read_log(path, limits={"c.p_head": (0, 1.05e7)}, treatment={"saturated": "drop"})
    assert log.channel("c.p_head").max() < 1.05e7
    assert kinds(log)[0] == "saturated"
    assert "lie at or above 1.05e+07 Pa, the most that is stated; dropped" in log.findings[0].text
    assert read_log(path, limits={"d.p_head": (0, 1)}).findings == read_log(path).findings


def test_absurd_sizes_are_refused_before_allocation(tmp_path, monkeypatch):
    path = tmp_path / "made.parquet.gz"
    path.write_bytes(gzip.compress(stored(made(), tmp_path).read_bytes()))
    monkeypatch.setattr("hydroopt.logs.table.EXPANDED_LIMIT", 1000)
    with pytest.raises(LogError, match="GB of data"):
        read_log(path)
    monkeypatch.setattr("hydroopt.logs.formats.files.EXPANDED_LIMIT", 1000)
    with pytest.raises(LogError, match="split it"):
        read_log(path)


def test_a_map_reads_headerless_files(csv, tmp_path):
    (tmp_path / "map.toml").write_text("""header = false
delimiter = ";"
decimal = ","
rows = [2, 4]
[columns]
"t" = {column = 0, unit = "ms"}
"boom.q" = {column = 1, unit = "deg", factor = -1.0, offset = "90 deg"}
"tilt.q" = {column = 2, minus = 1, unit = "deg"}
""")
    path = csv("garbage\n0;10,5;20\n10;20;40\n20;30;60\nmore;garbage;")
    log = read_log(path, mapping=tmp_path / "map.toml")
    np.testing.assert_allclose(log.t, [0, 0.01, 0.02])
    np.testing.assert_allclose(log.channel("boom.q"), np.deg2rad([79.5, 70, 60]))
    np.testing.assert_allclose(log.channel("tilt.q"), np.deg2rad([9.5, 20, 30]))
    assert list(log.sample) == [2, 3, 4]
    assert [(each.kind, each.text) for each in log.findings] == [
        ("rows", "only data rows 2 to 4 were read"),
        ("format", "the file was read with footer = 1")]


T_LINE = '[columns]\n"t" = {column = "t", unit = "s"}\n'
BAD_MAPS = {
    "unknown key": ("separator = ';'\n" + T_LINE, "separator.*use one of"),
    "both": (T_LINE + '"a.q" = {column = "a", variable = "b", unit = "rad"}', "either 'column'"),
    "no unit": (T_LINE + '"a.q" = {column = "a"}', "columns.a.q.unit"),
    "wrong unit": (T_LINE + '"a.q" = {column = "a", unit = "bar"}', "'bar' does not suit"),
    "offset": (T_LINE + '"a.q" = {column = "a", unit = "deg", offset = "3 bar"}', "a.q"),
    "suffix": (T_LINE + '"a.w" = {column = "a", unit = "deg"}', "not a channel"),
    "rows": ("rows = [5, 2]\n" + T_LINE, "rows"),
    "not toml": ("[columns", "not valid TOML"),
}


@pytest.mark.parametrize("case", BAD_MAPS)
def test_bad_maps_are_refused(tmp_path, case):
    content, pattern = BAD_MAPS[case]
    (tmp_path / "map.toml").write_text(content)
    with pytest.raises(LogError, match=pattern) as caught:
        read_map(tmp_path / "map.toml")
    assert "map.toml" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("columns", [{}, {"t": {"column": "t", "unit": "s"}}])
def test_a_map_without_channels_is_named_as_such(csv, columns):
    with pytest.raises(LogError, match=r"its map names no channel; write in it which column is which channel"):
        read_log(csv(text()), mapping=LogMap.model_validate({"columns": columns}))


def test_a_mapped_column_that_is_missing_names_those_present(csv):
    layout = LogMap.model_validate({"columns": {
        "t": {"column": "time", "unit": "s"}, "boom.q": {"column": "boom.q [deg]", "unit": "deg"}}})
    with pytest.raises(LogError, match=r"no column 'time' .*present are .*boom\.q"):
        read_log(csv(text()), mapping=layout)


def test_logs_made_in_memory_are_checked():
    log = Log("made", np.arange(5.0), {"a.q": np.zeros(5)})
    assert list(log.sample) == [1, 2, 3, 4, 5]
    t = np.arange(5.0)
    for times, channels in ((t, {"a.q": np.zeros(4)}), (0 * t, {}), (t, {"a": np.zeros(5)})):
        with pytest.raises(HydrooptError):
            Log("made", times, channels)


@pytest.mark.parametrize(("at", "value", "pattern"), [
    (176, 127, "crashes the reader"),  # the type of the numbers: SciPy's reader ends in SIGSEGV
    (144, 255, "not a readable MATLAB file"),
    (183, 120, "not a readable MATLAB file")])
@pytest.mark.slow
def test_a_byte_of_a_matlab_file_ends_in_a_sentence(tmp_path, at, value, pattern):
    """The reader runs in a process of its own, so that nothing in a file can end this one."""
    savemat(tmp_path / "log.mat", {"t": np.arange(9.0)[:, None], "q": np.zeros((9, 1))})
    layout = LogMap.model_validate({"columns": {"t": {"variable": "t", "unit": "s"},
                                                "a.q": {"variable": "q", "unit": "rad"}}})
    assert read_log(tmp_path / "log.mat", mapping=layout).size == 9
    data = bytearray((tmp_path / "log.mat").read_bytes())
    data[at] = value
    (tmp_path / "log.mat").write_bytes(data)
    with pytest.raises(LogError, match=pattern):
        read_log(tmp_path / "log.mat", mapping=layout)


@pytest.mark.parametrize("value", [1e308, -1e200, 1e31])
@pytest.mark.parametrize("kind", ["csv", "parquet", "mat"])
def test_numbers_beyond_any_machine_are_refused_in_every_format(tmp_path, kind, value):
    q = np.linspace(0, 1, 9)
    q[4] = value
    if kind == "mat":
        savemat(tmp_path / "log.mat", {"t": np.arange(9.0)[:, None], "q": q[:, None]})
        layout = LogMap.model_validate({"columns": {"t": {"variable": "t", "unit": "s"},
                                                    "a.q": {"variable": "q", "unit": "rad"}}})
    else:
        layout = None
        Log("made", np.arange(9.0), {"a.q": q}).write(tmp_path / f"log.{kind}")
    with pytest.raises(LogError, match=r"data row 5 is damaged \(5: a\.q beyond 1e\+06 rad\)"):
        read_log(tmp_path / f"log.{kind}", mapping=layout)


def test_kr300_reads_with_its_map():
    log = read_log(ROOT / "data/kr300/run_A.mat", mapping=ROOT / "data/kr300/map.toml")
    assert log.t.size == 2501
    np.testing.assert_allclose(np.diff(log.t), 0.004, rtol=1e-6)
    assert np.rad2deg(np.ptp(log.channel("axis6.q"))) == pytest.approx(72.68, abs=0.01)
    assert set(kinds(log)) <= {"spike"}
    assert sum(f.count for f in log.findings) < 50


def test_patu_spike_is_found():
    path = DATA / "patu_log_crane/patu_measured_100Hz.csv"
    if not path.exists():
        pytest.skip(f"measured data absent: {path}")
    layout = LogMap.model_validate({"columns": {
        "t": {"column": "t_s", "unit": "s"}, "boom.q": {"column": "z1_deg", "unit": "deg"},
        "tilt.q": {"column": "z2_deg", "minus": "z1_deg", "unit": "deg"},
        "boom_cylinder.length": {"column": "s1_mm", "unit": "mm"},
        "boom_cylinder.p_head": {"column": "p1_Pa", "unit": "Pa"},
        "boom_valve.u": {"column": "U1_V", "unit": "V"}}})
    log = read_log(path, mapping=layout)
    assert [(f.kind, f.channel) for f in log.findings] == [("spike", "tilt.q")]
    assert log.findings[0].first <= 2018
    assert log.findings[0].last >= 2020
    assert log.findings[0].count < 12


def test_damaged_ur10e_log_is_refused_and_its_sound_rows_are_read():
    path = DATA / "ur10e_mamedov/dataset_ur10e/identification_data/ur-20_02_19_15harm50secLoad.csv"
    if not path.exists():
        pytest.skip(f"measured data absent: {path}")
    layout = LogMap.model_validate({"header": False, "columns": {
        "t": {"column": 0, "unit": "s"}, **{f"j{i}.q": {"column": i, "unit": "rad"} for i in range(1, 7)}}})
    with pytest.raises(LogError, match=r"line 2: data rows 2–10, 6107 are damaged .*rows = \[11, 6106\]"):
        read_log(path, mapping=layout)
    log = read_log(path, mapping=layout.model_copy(update={"rows": (11, 6106)}))
    assert log.t.size == 6096
    assert log.sample[0] == 11


def test_level_runs_are_those_of_a_plain_search() -> None:
    rng, found = np.random.default_rng(0), 0
    for _ in range(500):
        x = np.repeat(rng.integers(0, 3, 40), rng.integers(1, 14, 40))[: rng.integers(1, 80)].astype(float)
        x[rng.random(x.size) < 0.02] = np.nan
        shortest = int(rng.integers(2, 14))
        edges = [0, *(np.flatnonzero(x[1:] != x[:-1]) + 1), x.size]
        wanted = [(a, b) for a, b in itertools.pairwise(edges) if b - a >= shortest]
        assert quality._level_runs(x, shortest) == wanted
        found += len(wanted)
    assert found > 500
