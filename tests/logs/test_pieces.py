"""Logs that are read, treated and kept in pieces against the same logs at once."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from hydroopt.errors import LogError
from hydroopt.logs import log as logs
from hydroopt.logs import mapped
from hydroopt.logs.column_map import LogMap
from hydroopt.logs.log import Log
from hydroopt.logs.log_files import read_log

ROWS = 5000
RNG = np.random.default_rng(1)
T = 7.0 + np.arange(ROWS) / 50


def columns() -> dict[str, np.ndarray]:
    return {"t [s]": T.copy(), "boom.q [deg]": 40 * np.sin(0.7 * T) + 0.05 * RNG.standard_normal(ROWS),
            "boom_cylinder.p_head [bar]": 90 + 30 * np.cos(0.9 * T) + RNG.standard_normal(ROWS), "note": np.ones(ROWS)}


def write(path: Path, data: dict[str, np.ndarray], group: int | None = None) -> Path:
    parquet.write_table(pa.table(data), path, row_group_size=group)
    return path


def same(one: Log, other: Log) -> None:
    assert (one.name, one.path, one.sha256, one.rows, dict(one.units), one.findings) == (
        other.name, other.path, other.sha256, other.rows, dict(other.units), other.findings)
    assert list(one.channels) == list(other.channels)
    for x, y in zip((one.t, one.sample, one.segment, *one.channels.values()),
                    (other.t, other.sample, other.segment, *other.channels.values()), strict=True):
        assert x.dtype == y.dtype
        np.testing.assert_array_equal(x, y)


@pytest.mark.parametrize("group", [700, None])
@pytest.mark.parametrize("rows", [None, (1, 10), (690, 2801)])
def test_batches_hold_what_the_file_holds(tmp_path: Path, group: int | None, rows: tuple[int, int] | None,
                                          monkeypatch: pytest.MonkeyPatch) -> None:
    data = columns()
    path = write(tmp_path / "log.parquet", data, group)
    layout = LogMap.model_validate({"columns": {"t": {"column": "t [s]", "unit": "s"},
                                                "boom.q": {"column": "boom.q [deg]", "unit": "rad"}}, "rows": rows})
    monkeypatch.setattr("hydroopt.logs.formats.parquet_file.BATCH", 300)
    log, span = read_log(path, mapping=layout), slice(*((rows[0] - 1, rows[1]) if rows else (0, ROWS)))
    np.testing.assert_array_equal(log.t, data["t [s]"][span])
    np.testing.assert_array_equal(log.channels["boom.q"], data["boom.q [deg]"][span])
    np.testing.assert_array_equal(log.sample, np.arange(1, ROWS + 1)[span])


@pytest.mark.parametrize("lost", [False, True])
def test_long_arrays_lie_in_files(tmp_path: Path, lost: bool, monkeypatch: pytest.MonkeyPatch,
                                  in_pieces: Callable[[int], None]) -> None:
    data = columns()
    if lost:
        data["boom.q [deg]"][[17, 3333]] = np.nan
        data["boom_cylinder.p_head [bar]"][2222] = np.nan
    path = write(tmp_path / "log.parquet", data)
    short = read_log(path)
    in_pieces(800)
    monkeypatch.setattr(mapped, "MAPPED", 1000)
    long = read_log(path)
    assert all(mapped.stored(x) is x for x in (long.t, long.sample, long.segment, *long.channels.values()))
    same(*(Log(log.name, log.t, log.channels, log.sample, log.segment, units=log.units) for log in (short, long)))
    assert found(short) == found(long)


def test_no_room_for_a_file_is_a_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.posix_fallocate", full)
    with pytest.raises(LogError, match=r"0\.08 GB of a long log do not fit \(No space left on device\).*TMPDIR"):
        mapped.empty(10**7)


def found(log: Log) -> dict[tuple[str, str], tuple[int, int, int]]:
    """Rows (first, last, count) of what a log shows, by kind and channel."""
    return {(f.kind, f.channel): (f.first, f.last, f.count) for f in log.findings if f.kind != "ignored"}


def test_findings_carry_the_rows_of_the_file(tmp_path: Path, in_pieces: Callable[[int], None]) -> None:
    data = columns()
    for row in (800, 801, 2400, 4321):  # the first ones on both sides of a border
        data["boom_cylinder.p_head [bar]"][row - 1] += 60.0
    data["t [s]"][2999:] += 1.0
    data["boom.q [deg]"][3500:3600] = data["boom.q [deg]"][3500]
    path = write(tmp_path / "log.parquet", data)
    whole = read_log(path)
    assert set(found(whole)) == {("spike", "boom_cylinder.p_head"), ("gap", "t"), ("stuck", "boom.q")}
    in_pieces(800)
    pieces = read_log(path)
    assert found(pieces) == found(whole)
    np.testing.assert_array_equal(pieces.segment, whole.segment)


def test_what_rests_through_a_piece_is_not_stuck_if_it_moves_later(
        tmp_path: Path, in_pieces: Callable[[int], None]) -> None:
    data = columns()
    data["boom.q [deg]"] = np.where(T - T[0] < 40, 12.0, 12.0 + 8 * (1 - np.cos(0.3 * (T - T[0] - 40))))
    in_pieces(800)
    assert found(read_log(write(tmp_path / "log.parquet", data))) == {}


@pytest.mark.parametrize("row", [1, 1600, 1601, 2777, 5000])
def test_a_bad_row_is_named(tmp_path: Path, row: int, in_pieces: Callable[[int], None]) -> None:
    data = columns()
    data["boom.q [deg]"][row - 1] = np.nan
    path = write(tmp_path / "log.parquet", data)
    in_pieces(800)
    with pytest.raises(LogError, match=rf"boom\.q: sample {row} holds no finite number.*--treat nan=drop"):
        read_log(path, treatment={"nan": "error"})
    for treatment in ({}, {"nan": "drop"}):
        assert found(read_log(path, treatment=treatment))["nan", "boom.q"] == (row, row, 1)


def test_treatments_of_all_samples_at_once_are_those_of_a_short_log(
        tmp_path: Path, in_pieces: Callable[[int], None]) -> None:
    data = columns()
    data["boom.q [deg]"][1000] = np.nan
    path = write(tmp_path / "log.parquet", data)
    whole = read_log(path, treatment={"nan": "interpolate"})
    in_pieces(800)
    same(read_log(path, treatment={"nan": "interpolate"}), whole)


def test_the_sample_follows_what_moves(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(logs, "BLOCK", 50)
    monkeypatch.setattr(logs, "SAMPLE", 200)
    log = Log("run", T, {"boom.q": np.interp(np.arange(ROWS), [2000, 2200], [3.0, 43.0])})
    np.testing.assert_array_equal(log.sampled(["boom.q"]).sample, np.arange(2001, 2201))


def test_pieces_reach_into_their_own_stretches_alone(in_pieces: Callable[[int], None]) -> None:
    in_pieces(1000)
    log = Log("run", np.arange(ROWS) + 9 * (np.arange(ROWS) >= 1990), {"boom.q": T})
    rows = [(piece.rows, (own.start, own.stop), (inner.start, inner.stop)) for piece, own, inner in log.pieces(50.0)]
    assert rows == [((1, 1050), (0, 1000), (0, 1000)), ((951, 2050), (1000, 2000), (50, 1050)),
                    ((1991, 3050), (2000, 3000), (10, 1010)), ((2951, 4050), (3000, 4000), (50, 1050)),
                    ((3951, 5000), (4000, 5000), (50, 1050))]
    assert [own for _, own, _ in log.pieces(np.inf)] == [slice(0, ROWS)]


@pytest.mark.parametrize("stamps", ["dates", "ns", "ms", "float s", "ns with a null"])
def test_dates_and_epochs_are_read_in_batches(tmp_path: Path, stamps: str, monkeypatch: pytest.MonkeyPatch) -> None:
    ticks = np.int64(1_795_407_600_000_000_007) + 20_000_000 * np.arange(ROWS)
    column = {"dates": ticks.astype("M8[ns]"), "ms": ticks // 10**6, "float s": ticks / 1e9}.get(stamps, ticks)
    name = {"dates": "t", "ms": "t [ms]", "float s": "t [s]"}.get(stamps, "t [ns]")
    other = {k: x for k, x in columns().items() if k != "t [s]"}
    lost = np.arange(ROWS) == (4000 if "null" in stamps else -1)
    parquet.write_table(pa.table({name: pa.array(column, mask=lost), **other}), tmp_path / "log.parquet")
    whole = read_log(tmp_path / "log.parquet")
    monkeypatch.setattr("hydroopt.logs.formats.parquet_file.BATCH", 300)
    same(read_log(tmp_path / "log.parquet"), whole)
    assert whole.size == ROWS - np.count_nonzero(lost)
