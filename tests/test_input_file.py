"""Files from outside end in a value or in one short sentence, whatever they are."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest

from hydroopt.errors import LONGEST, HydrooptError, LogError, MachineError, ProblemError
from hydroopt.logs.column_headers import map_of_header, parts_of
from hydroopt.logs.column_map import ColumnMap, LogMap, read_map
from hydroopt.logs.log_files import read_log
from hydroopt.machine.machine_file import load_machine, read_machine
from hydroopt.results.answer import load
from hydroopt.support.input_file import read_bytes, read_json, read_text, similar, toml


@pytest.mark.parametrize("read", [
    lambda file: load_machine(file.with_suffix(".toml")), lambda file: load_machine(file.with_suffix(".urdf")),
    lambda file: read_map(file.with_suffix(".toml")), lambda file: read_log(file.with_suffix(".csv")),
    lambda file: read_log(file.with_suffix(".mat"), mapping=LogMap(columns={"t": ColumnMap(variable="t", unit="s")})),
    lambda file: read_log(file.with_suffix(".parquet"))],
    ids=["machine", "URDF", "map", "CSV", "MAT", "Parquet"])
def test_pipes_directories_and_impossible_paths_are_refused_at_once(tmp_path, read):
    for suffix in (".toml", ".urdf", ".csv", ".mat", ".parquet"):
        os.mkfifo(tmp_path / f"pipe{suffix}")
        (tmp_path / f"folder{suffix}").mkdir()
    began = time.process_time()
    for name in ("pipe", "folder", "none", "with\0nul", 3000 * "long"):
        with pytest.raises(HydrooptError) as caught:
            read(tmp_path / name)
        assert len(str(caught.value)) <= LONGEST
    assert time.process_time() - began < 2


def test_an_answer_that_is_a_pipe_is_refused(tmp_path):
    os.mkfifo(tmp_path / "estimate.json")
    with pytest.raises(ProblemError):
        load(tmp_path)


@pytest.mark.parametrize("text", [
    "a = " + "1" * 309, "a = " + "1" * 5000, "a = 0x" + "f" * 5000, "a = " + "[" * 5000, "a" + ".a" * 20000 + " = 1",
    "[" + "a." * 40 + "a]", "a = " + "{a=" * 500 + "1" + "}" * 500, "a" * 10**6, '"' + "a" * 10**6],
    ids=lambda text: f"{text[:12]} ({len(text)})")
def test_toml_beyond_sense_is_refused_at_once(tmp_path, text):
    began = time.process_time()
    with pytest.raises(MachineError) as caught:
        toml(text, MachineError, where="machine.toml")
    assert len(str(caught.value)) <= LONGEST
    assert time.process_time() - began < 2
    with pytest.raises(MachineError):
        read_machine(text)


@pytest.mark.parametrize("text", ["[" * 10**5, '{"a": ' * 200 + "1" + "}" * 200, '{"a": ' + "1" * 309 + "}", "[1]", "",
                                  '{"a": NaN}', '{"a": 1e999}', '{"a": 1e200}', "\ud800", r'{"a": "\ud800"}',
                                  r'{"\udfff": 1}'])
def test_json_beyond_sense_is_refused(tmp_path, text):
    (tmp_path / "truth.json").write_bytes(text.encode("utf-8", "surrogatepass"))
    with pytest.raises(ProblemError):
        read_json(tmp_path / "truth.json", ProblemError)


@pytest.mark.parametrize(("data", "expected"), [
    (b"\xef\xbb\xbfa = 1\r\n", "a = 1\n"), ("a = 1".encode("utf-16"), None), (b"\xed\xa0\x80", None), (b"a\0", None)])
def test_text_is_utf_8(tmp_path, data, expected):
    (tmp_path / "file").write_bytes(data)
    if expected is not None:
        assert read_text(tmp_path / "file", LogError, noun="map") == expected
        return
    with pytest.raises(LogError, match="not text"):
        read_text(tmp_path / "file", LogError, noun="map")


def test_a_file_beyond_its_limit_is_not_read(tmp_path):
    (tmp_path / "file").write_bytes(bytes(100))
    assert len(read_bytes(tmp_path / "file", LogError, most=100)) == 100
    with pytest.raises(LogError, match="more than"):
        read_bytes(tmp_path / "file", LogError, most=99)


@pytest.mark.parametrize("text", ["boom.q" + " " * 60_000 + "x", "boom.q" + "[" * 60_000, "boom.q [deg" + " ]" * 30_000,
                                  "boom.q" + " [" * 30_000])
def test_headers_take_no_time(text):
    began = time.process_time()
    with pytest.raises(HydrooptError) as caught:
        map_of_header(["t [s]", text], "log.csv")
    assert len(str(caught.value)) <= LONGEST
    assert time.process_time() - began < 0.5


@pytest.mark.parametrize(("text", "parts"), [
    (" boom.q [deg] ", ("boom.q", "deg")), ("boom.q", ("boom.q", None)), ("t[s]", ("t", "s")),
    ("a [b] [c]", ("a [b]", "c")), ("a [b", None), ("a] [b]", None), ("a [[b]]", None), ("[s]", ("", "s"))])
def test_headers_have_a_name_and_a_unit(text, parts):
    assert parts_of(text) == (parts or (text, None))


def test_similar_names_are_found_at_once():
    began = time.process_time()
    assert similar("ab" * 10**5, ["ba" * 10**5, "abab"]) == ["abab"]
    assert time.process_time() - began < 0.5


def test_sentences_are_short_and_on_one_line():
    error = LogError("there is no '" + "x\x1b[2J\n" * 5000 + "'", where="/home/me/" + "y" * 5000 + "/run.csv",
                     remedy="use " + ", ".join(["name"] * 500))
    assert len(str(error)) <= LONGEST
    assert str(error).isprintable()
    assert "run.csv: there is no" in str(error)
    assert str(error) == f"{error.where}: {error.what}; {error.remedy}."
    short = LogError("what", where=str(Path("/x") / ("a" * 150)), remedy="do")
    assert str(short) == f"/x/{'a' * 150}: what; do."
