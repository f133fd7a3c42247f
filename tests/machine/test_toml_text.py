"""Text of tables against tomlkit's, and read back by Python's own reader."""

import tomllib

import tomlkit

from hydroopt.machine.machine_file import load_machine, machine_file_tables
from hydroopt.machine.toml_text import toml_text


def test_machine_files_are_those_of_tomlkit() -> None:
    for name in ("cat215b", "excavator_bucket", "ur10"):
        tables = machine_file_tables(load_machine(name))
        assert toml_text(tables) == tomlkit.dumps(tables)


def test_any_text_key_and_nesting_reads_back() -> None:
    tables = {"a": 'q"\\\x00\x7f\t\n é \u2028', "b c": {"d.e": 1, "x": [[1, 2.5], [{"y": 1}]], "e": {}, "l": []},
              "n": float("inf"), "m": 1e-5, "k": 10**20, "t": True, "p": {"q": {"r": {"s": -1}}},
              "rows": [{"at": [{"z": 1}, {}]}, {"only": {"inner": "x"}}]}
    assert tomllib.loads(toml_text(tables)) == tables
