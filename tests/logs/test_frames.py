"""Logs and poses from pandas DataFrames: units, times at their true resolution, round trips, refusals."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest

from hydroopt.errors import LogError
from hydroopt.estimation.dynamic.problem import identification_problem
from hydroopt.estimation.hydraulic.problem import hydraulic_problem
from hydroopt.estimation.kinematic.problem import calibration_problem
from hydroopt.logs.log import Log
from hydroopt.logs.log_files import read_log
from hydroopt.logs.poses import Poses, read_poses
from hydroopt.machine.machine_file import load_machine

N = 50
T = 0.02 * np.arange(N)
ANGLE = np.degrees(np.sin(T))


def frame(**more: object) -> pd.DataFrame:
    return pd.DataFrame({"t [s]": T, "boom.q [deg]": ANGLE, "boom_cylinder.p_head [bar]": 100 + T, **more})


def check(log: Log) -> None:
    np.testing.assert_allclose(log.t, T, atol=1e-12)
    np.testing.assert_allclose(log.channels["boom.q"], np.sin(T), rtol=1e-14)
    np.testing.assert_allclose(log.channels["boom_cylinder.p_head"], 1e5 * (100 + T), rtol=1e-14)
    assert dict(log.units) == {"boom.q": "rad", "boom_cylinder.p_head": "Pa"}
    assert np.all(log.segment == log.segment[0])


def test_units_stand_in_headers_or_beside() -> None:
    check(Log.from_frame(frame(), name="run"))
    assert Log.from_frame(frame(), name="run").name == "run"
    bare = frame().set_axis(["t", "boom.q", "boom_cylinder.p_head"], axis=1)
    check(Log.from_frame(bare, units={"t": "s", "boom.q": "deg", "boom_cylinder.p_head": "bar"}))
    mixed = frame().set_axis(["t [s]", "boom.q", "boom_cylinder.p_head [bar]"], axis=1)
    check(Log.from_frame(mixed, units={"boom.q": "deg"}))


@pytest.mark.parametrize("unit", ["s", "ms", "us", "ns"])
@pytest.mark.parametrize("kind", ["datetime", "datetime with zone", "timedelta"])
@pytest.mark.parametrize("place", ["index", "column"])
def test_times_keep_their_resolution(unit: str, kind: str, place: str) -> None:
    step = 1000 if unit == "s" else 20  # whole seconds cannot hold 20 ms
    ticks = np.arange(N, dtype="int64") * step * {"s": 1, "ms": 1, "us": 1000, "ns": 1_000_000}[unit]
    scale = 1000.0 if unit == "s" else 0.02
    if kind == "timedelta":
        moments = pd.TimedeltaIndex(ticks.astype(f"timedelta64[{unit}]"))
    else:
        start = np.datetime64("2026-11-22T05:11:19", unit)
        moments = pd.DatetimeIndex(start + ticks.astype(f"timedelta64[{unit}]"))
        if kind == "datetime with zone":
            moments = moments.tz_localize("UTC").tz_convert("Europe/Helsinki")
    assert moments.dtype.name.split(", ")[0].endswith(f"64[{unit}" + ("" if "zone" in kind else "]"))
    columns = {"boom.q [rad]": np.sin(T)}
    made = (pd.DataFrame(columns, index=moments) if place == "index"
            else pd.DataFrame({"t": moments, **columns}))
    log = Log.from_frame(made)
    np.testing.assert_array_equal(log.t, ticks / {"s": 1, "ms": 1e3, "us": 1e6, "ns": 1e9}[unit])
    np.testing.assert_allclose(log.t, scale * np.arange(N), rtol=1e-15)


def test_nanoseconds_of_a_late_epoch_are_not_rounded() -> None:
    moments = pd.DatetimeIndex(np.datetime64("2200-01-01", "ns") + np.arange(4).astype("timedelta64[ns]"))
    log = Log.from_frame(pd.DataFrame({"boom.q [rad]": np.zeros(4)}, index=moments))
    np.testing.assert_array_equal(log.t, [0.0, 1e-9, 2e-9, 3e-9])


def test_a_log_goes_there_and_back(tmp_path) -> None:
    log = Log.from_frame(frame(), name="run")
    again = Log.from_frame(log.to_frame(), name="run")
    np.testing.assert_array_equal(again.t, log.t)
    for name, values in log.channels.items():
        np.testing.assert_array_equal(again.channels[name], values)
    assert dict(again.units) == dict(log.units)
    log.write(tmp_path / "log.csv")
    log.to_frame().to_csv(tmp_path / "pandas.csv", index=False)
    written, by_pandas = (read_log(tmp_path / name) for name in ("log.csv", "pandas.csv"))
    np.testing.assert_array_equal(written.channels["boom.q"], by_pandas.channels["boom.q"])


def test_poses_go_there_and_back(tmp_path) -> None:
    poses = Poses("run", stage=np.array(["low", "low", "high"]), pose=np.array(["a", "b", "c"]),
                  channels={"boom.q": np.array([0.1, np.nan, 0.3]), "tip.x": np.array([1.0, 2.0, 3.0])})
    again = Poses.from_frame(poses.to_frame(), name="run")
    for key in ("stage", "fixture", "pose"):
        assert getattr(again, key).tolist() == getattr(poses, key).tolist()
    for name, values in poses.channels.items():
        np.testing.assert_array_equal(again.channels[name], values)
    poses.write(tmp_path / "poses.csv")
    assert Poses.from_frame(pd.read_csv(tmp_path / "poses.csv")).stage.tolist() == poses.stage.tolist()
    assert read_poses(tmp_path / "poses.csv").pose.tolist() == ["a", "b", "c"]
    with pytest.raises(LogError, match="neither a channel nor a label"):
        Poses.from_frame(poses.to_frame().assign(note="x"))


def test_poses_have_dates_in_a_column_or_the_index():
    moments = pd.date_range("2026-01-31T12:00", periods=2, freq="30s")
    for made in (pd.DataFrame({"boom.q [rad]": [0.1, 0.2]}, index=moments),
                 pd.DataFrame({"t": moments, "boom.q [rad]": [0.1, 0.2]})):
        assert Poses.from_frame(made).t.tolist() == [1769860800.0, 1769860830.0]


def test_foreign_columns_and_missing_values_are_findings() -> None:
    log = Log.from_frame(frame(operator="me", Remarks=1.0))
    assert [f.kind for f in log.findings] == ["ignored"]
    hole = frame()
    hole.loc[3, "boom.q [deg]"] = np.nan
    with pytest.raises(LogError, match="boom"):
        Log.from_frame(hole, treatment={"nan": "error"})
    assert Log.from_frame(hole).size == Log.from_frame(hole, treatment={"nan": "drop"}).size == N - 1
    nullable = frame().astype({"boom.q [deg]": "Float64"})
    check(Log.from_frame(nullable))


@pytest.mark.parametrize(("made", "units", "said"), [
    (frame().rename(columns={"boom.q [deg]": "boom.q"}), None, r"column 'boom\.q' has no unit; .*units="),
    (frame(), {"boom.q [deg]": "rad"}, "has a unit in its name and 'rad' in units; state it once"),
    (frame(), {"stick.q": "deg"}, "units are stated for 'stick.q', but there is no such column"),
    (frame().rename(columns={"boom.q [deg]": "boom.q [bar]"}), None, "does not suit channel"),
    (frame().drop(columns="t [s]"), None, "there is no column 't"),
    (frame().set_index(pd.to_timedelta(T, unit="s")), None, "the time is stated both in a column and in the index"),
    (frame().assign(**{"boom.q [deg]": "x"}), None, "holds .*, not numbers"),
    (frame().iloc[:0], None, "no rows"),
    (frame()["t [s]"], None, "this is a Series, not a pandas DataFrame"),
    (pd.DataFrame({"t": pd.to_datetime(["2026-01-01", None]), "boom.q [rad]": 0.0}), None, "only 1 of the samples"),
])
def test_frames_that_cannot_be_read_are_refused_in_a_sentence(made, units, said) -> None:
    with pytest.raises(LogError, match=said):
        Log.from_frame(made, units=units)


def test_a_log_takes_si_and_seconds_only() -> None:
    with pytest.raises(LogError, match=r"'boom\.q' is stated in 'deg', but a log holds SI .*from_frame\(frame, units="):
        Log("run", T, {"boom.q": ANGLE}, units={"boom.q": "deg"})
    with pytest.raises(LogError, match="table of poses holds SI"):
        Poses("run", channels={"boom.q": ANGLE}, units={"boom.q": "deg"})
    with pytest.raises(LogError, match="holds bool, not seconds"):
        Log("run", np.ones(N, bool), {"boom.q": ANGLE})
    assert Log("run", T, {"boom.q": T}, units={"boom.q": "m"}).units["boom.q"] == "m"  # where a joint slides


@pytest.mark.parametrize("unit", ["ms", "us", "ns"])
def test_a_log_of_datetimes_counts_from_the_first_at_their_resolution(unit) -> None:
    steps = 3 * np.arange(N).astype(f"timedelta64[{unit}]")
    seconds = 3 * np.arange(N) / {"ms": 10**3, "us": 10**6, "ns": 10**9}[unit]
    for t in (np.datetime64("2026-01-01", unit) + steps, steps):
        np.testing.assert_array_equal(Log("run", t, {"boom.q": ANGLE}).t, seconds)


def test_an_arrow_table_is_a_frame() -> None:
    made = pa.table({"t": pa.array(np.datetime64("2026-01-01", "ns") + 20_000_001 * np.arange(N)),
                     "boom.q": ANGLE})
    log = Log.from_frame(made, units={"boom.q": "rad"})
    np.testing.assert_array_equal(log.t, 20_000_001 * np.arange(N) / 10**9)
    np.testing.assert_array_equal(log.channels["boom.q"], ANGLE)


@pytest.mark.parametrize("given", [frame(), [frame()], None, {"t": T}, "log.csv"])
def test_a_problem_refuses_what_is_no_log(given) -> None:
    machine = load_machine("cat215b")
    for build in (identification_problem, hydraulic_problem):
        with pytest.raises(LogError, match=r"this is a \w+, not a log; read one by read_log"):
            build(machine, given)
    with pytest.raises(LogError, match=r"this is a \w+, not a table of poses; read one by read_poses"):
        calibration_problem(machine, given)
    with pytest.raises(LogError, match=r"there is no channel 'swing\.q'"):  # one log stands for a list of it
        identification_problem(machine, Log.from_frame(frame()))
