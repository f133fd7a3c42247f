"""Options that take files take all that a shell's pattern stands for."""

from pathlib import Path

import pytest

from hydroopt.cli import Deferred


def parsed(command: str, *arguments: str) -> dict:
    return Deferred(command).make_context(command, list(arguments)).params


@pytest.mark.parametrize("command", ["calibrate", "identify", "identify-valves"])
def test_validation_files_never_become_training_data(command: str) -> None:
    found = parsed(command, "crane", "a", "b", "--validate", "c", "d", "e", "--validate", "f", "-o", "out", "--quiet")
    assert found["tables" if command == "calibrate" else "logs"] == [Path("a"), Path("b")]
    assert found["validate"] == [Path(name) for name in "cdef"]
    assert found["output"] == Path("out")


def test_sessions_are_positional() -> None:
    found = parsed("compare", "crane", "a", "b", "c", "-o", "out")
    assert found["sessions"] == [Path("a"), Path("b"), Path("c")]


def test_logs_of_instruments_are_files_as_well() -> None:
    found = parsed("identify", "crane", "a", "--instruments", "b", "c", "-o", "out")
    assert (found["logs"], found["instruments"]) == ([Path("a")], [Path("b"), Path("c")])


def test_other_options_take_one_word() -> None:
    found = parsed("identify", "crane", "--treat", "nan=drop", "a", "-o", "out", "b")
    assert found["logs"] == [Path("a"), Path("b")]
    assert found["treat"] == ["nan=drop"]
