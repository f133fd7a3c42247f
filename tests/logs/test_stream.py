"""A log that is read in pieces against the same log in memory."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from hydroopt.errors import LogError, ProblemError
from hydroopt.logs import stream as streaming
from hydroopt.logs.column_map import LogMap
from hydroopt.logs.log import Log
from hydroopt.logs.log_files import read_log
from hydroopt.logs.stream import LogStream, open_log, stream

ROWS = 5000
RNG = np.random.default_rng(1)
T = 7.0 + np.arange(ROWS) / 50


def columns() -> dict[str, np.ndarray]:
    return {"t [s]": T.copy(), "boom.q [deg]": 40 * np.sin(0.7 * T) + 0.05 * RNG.standard_normal(ROWS),
            "boom_cylinder.p_head [bar]": 90 + 30 * np.cos(0.9 * T) + RNG.standard_normal(ROWS), "note": np.ones(ROWS)}


def write(path: Path, data: dict[str, np.ndarray], group: int | None = None) -> Path:
    parquet.write_table(pa.table(data), path, row_group_size=group)
    return path


@pytest.mark.parametrize("group", [700, None])
def test_ranges_hold_what_the_whole_log_holds(
        tmp_path: Path, group: int | None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hydroopt.logs.formats.parquet_file.BATCH", 300)
    path = write(tmp_path / "log.parquet", columns(), group)
    whole = read_log(path)
    ranges = [(1, 10), (5, 2000), (1990, 2001), (4000, 5000), (5000, 5000)]
    for (first, last), part in zip(ranges, stream(path).read(ranges), strict=True):
        np.testing.assert_array_equal(part.sample, np.arange(first, last + 1))
        np.testing.assert_array_equal(part.t, whole.t[first - 1 : last])
        for name, x in whole.channels.items():
            np.testing.assert_array_equal(part.channels[name], x[first - 1 : last])


def test_a_stream_knows_of_itself_what_a_log_does(tmp_path: Path) -> None:
    path = write(tmp_path / "log.parquet", columns())
    whole, pieces = read_log(path), stream(path, piece=800)
    for one, other in zip((whole, *whole.split(0.7)), (pieces, *pieces.split(0.7)), strict=True):
        assert (one.name, one.path, one.sha256, one.size, one.rows, dict(one.units)) == (
            other.name, other.path, other.sha256, other.size, other.rows, dict(other.units))
        assert other.duration == pytest.approx(one.duration)
    assert [f.text for f in pieces.findings] == ["columns that are not channels left out: note"]


def found(path: Path, **how: object) -> dict[tuple[str, str], tuple[int, int, int]]:
    """Rows (first, last, count) of what a log in pieces shows, by kind and channel."""
    log, rows = stream(path, piece=800, **how), {}  # type: ignore[arg-type]
    for samples, core in log.windows((60, 60)):
        for one in log.treated(samples, core).findings:
            a, b, count = rows.get((one.kind, one.channel), (one.first, one.last, 0))
            rows[one.kind, one.channel] = min(a, one.first), max(b, one.last), count + one.count
    return rows


def test_findings_carry_the_rows_of_the_file(tmp_path: Path) -> None:
    data = columns()
    for row in (800, 801, 2400, 4321):  # the first ones on both sides of a border
        data["boom_cylinder.p_head [bar]"][row - 1] += 60.0
    data["t [s]"][2999:] += 1.0
    data["boom.q [deg]"][3500:3600] = data["boom.q [deg]"][3500]
    path = write(tmp_path / "log.parquet", data)
    whole = {(f.kind, f.channel): (f.first, f.last, f.count) for f in read_log(path).findings if f.kind != "ignored"}
    assert set(whole) == {("spike", "boom_cylinder.p_head"), ("gap", "t"), ("stuck", "boom.q")}
    assert found(path) == whole


def test_what_rests_through_a_piece_is_not_stuck_if_it_moves_later(tmp_path: Path) -> None:
    data = columns()
    data["boom.q [deg]"] = np.where(T - T[0] < 40, 12.0, 12.0 + 8 * (1 - np.cos(0.3 * (T - T[0] - 40))))
    path = write(tmp_path / "log.parquet", data)
    assert found(path) == {} == {f.kind: f for f in read_log(path).findings if f.kind != "ignored"}


@pytest.mark.parametrize("row", [1, 1600, 1601, 2777, 5000])
def test_a_bad_row_is_named(tmp_path: Path, row: int) -> None:
    data = columns()
    data["boom.q [deg]"][row - 1] = np.nan
    path = write(tmp_path / "log.parquet", data)
    with pytest.raises(LogError, match=rf"boom\.q: sample {row} holds no finite number.*--treat nan=drop"):
        found(path, treatment={"nan": "error"})
    for treatment in ({}, {"nan": "drop"}):
        assert found(path, treatment=treatment)["nan", "boom.q"] == (row, row, 1)


def test_the_sample_follows_what_moves(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(streaming, "BLOCK", 50)
    monkeypatch.setattr(streaming, "BLOCKS", 4)
    data = columns()
    data["boom.q [deg]"] = np.interp(np.arange(ROWS), [2000, 2200], [3.0, 43.0])
    sample = stream(write(tmp_path / "log.parquet", data), piece=800).sample(["boom.q"])
    np.testing.assert_array_equal(sample.sample, np.arange(2001, 2201))


@pytest.mark.parametrize(("treatment", "word"), [({"nan": "interpolate"}, "nan"), ({"non-monotonic": "drop"}, "mono")])
def test_treatments_that_need_the_whole_are_refused(tmp_path: Path, treatment: dict[str, str], word: str) -> None:
    with pytest.raises(ProblemError, match=f"in pieces.*{word}"):
        stream(write(tmp_path / "log.parquet", columns()), treatment=treatment)


def test_text_beyond_memory_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "log.csv").write_text("t [s],boom.q [rad]\n" + "0,1\n" * 1000)
    monkeypatch.setattr("hydroopt.logs.table._memory", lambda: 30_000.0)
    with pytest.raises(LogError, match=r"takes about .* of memory.*convert it to Parquet, which is read in pieces"):
        read_log(tmp_path / "log.csv")


def test_only_long_parquet_files_are_read_in_pieces(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write(tmp_path / "log.parquet", columns())
    assert isinstance(open_log(path), Log)
    monkeypatch.setattr(streaming, "STREAMED", ROWS - 1)
    assert isinstance(open_log(path), LogStream)
    (tmp_path / "bad.parquet").write_bytes(b"PAR1 and nothing more")
    with pytest.raises(LogError, match="not a readable Parquet file"):
        open_log(tmp_path / "bad.parquet")


def test_a_survey_of_infinite_readings_warns_of_nothing(tmp_path):
    Log("made", np.arange(50.0), {"boom.q": np.full(50, np.inf)}).write(tmp_path / "log.parquet")
    assert stream(tmp_path / "log.parquet").survey.extremes["boom.q"] == (np.inf, np.inf)


@pytest.mark.parametrize("stamps", ["dates", "ns", "ms", "float s"])
def test_dates_and_epochs_are_read_in_pieces_as_in_memory(tmp_path: Path, stamps: str) -> None:
    ticks = np.int64(1_795_407_600_000_000_007) + 20_000_000 * np.arange(ROWS)
    column = {"dates": ticks.astype("M8[ns]"), "ns": ticks, "ms": ticks // 10**6, "float s": ticks / 1e9}[stamps]
    name = {"dates": "t", "ns": "t [ns]", "ms": "t [ms]", "float s": "t [s]"}[stamps]
    path = write(tmp_path / "log.parquet", {name: column} | {k: x for k, x in columns().items() if k != "t [s]"})
    whole, pieces = read_log(path), stream(path, piece=800)
    read = np.concatenate([samples.t for samples in pieces.read([(1, 800), (801, ROWS)])])
    assert read.tobytes() == whole.t.tobytes()
    after = pieces.split(0.5)[1]
    assert next(after.read([after.rows])).t.tobytes() == whole.split(0.5)[1].t.tobytes()
    assert pieces.origin is not None
    assert ("clock" in {one.kind for one in pieces.findings}) is ("clock" in {one.kind for one in whole.findings})


@pytest.mark.parametrize("column", ["numbers", "missing numbers", "no statistics", "differences", "whole numbers"])
def test_extremes_are_those_of_the_numbers_whether_the_file_states_them_or_not(tmp_path: Path, column: str) -> None:
    data, layout = columns(), None
    q = data["boom.q [deg]"]
    if column == "missing numbers":
        q[[3, 1500]] = np.nan
    if column == "whole numbers":
        data["boom.q [deg]"] = np.round(q).astype(np.int16)
    if column == "differences":
        layout = LogMap.model_validate({"columns": {
            "t": {"column": "t [s]", "unit": "s"},
            "boom_cylinder.force": {"column": "boom_cylinder.p_head [bar]", "minus": "note", "unit": "kN"}}})
    statistics = column != "no statistics"
    parquet.write_table(pa.table({name: pa.array(x, from_pandas=True) for name, x in data.items()}),
                        tmp_path / "log.parquet", row_group_size=700, write_statistics=statistics)
    log = stream(tmp_path / "log.parquet", mapping=layout, piece=800)
    assert bool(log._stated) == (statistics and column != "differences")
    for part in (log, log.slice(10, 3000), log.slice(700, 2100)):
        read = [samples.channels for samples in part.read([part.rows])]
        for name, x in read[0].items():
            assert part.survey.extremes[name] == (np.nanmin(x), np.nanmax(x))


def test_numbers_beyond_those_that_the_file_states_are_refused(tmp_path: Path) -> None:
    log = stream(write(tmp_path / "log.parquet", columns()), piece=800)
    low, high = log._stated["boom.q"]
    log.__dict__["_stated"] = {"boom.q": (low, high - 1e-9)}
    with pytest.raises(LogError, match=r"boom\.q has numbers beyond the least and the greatest that the file states"):
        [log.treated(samples, core) for samples, core in log.windows((60, 60))]
