"""Options take finite numbers that can be computed, and nothing that a file says drives the terminal."""

from __future__ import annotations

import sys

import pytest

from fixtures.bad_input_cases import DIGGER
from hydroopt import cli
from hydroopt.errors import LONGEST

NUMBERS = {"simulate": ("--duration", "--rate", "--seed"), "excite": ("--search-seconds", "--duration", "--period",
           "--blend", "--rate", "--harmonics", "--starts"), "control": ("--gain", "--sensitivity", "--rate"),
           "identify": ("--ridge", "--tolerance", "--bandwidth"), "compare": ("--level",),
           "plan-poses": ("--poses", "--candidates")}
OTHERS = {"excite": (), "simulate": (), "control": ("--motion", "none.csv"), "identify": ("none.csv",),
          "compare": ("none.csv", "none.csv"), "plan-poses": ("--poses", "2")}


def refusal(arguments, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["hydroopt", *arguments])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    caught = capsys.readouterr()
    assert (ended.value.code, caught.out) == (2, ""), caught
    return caught.err


@pytest.mark.parametrize("command", NUMBERS)
def test_numbers_that_are_not_finite_or_beyond_sense_are_refused(command, tmp_path, monkeypatch, capsys):
    for option in NUMBERS[command]:
        for value in ("inf", "nan", "-inf", "1e308", "9" * 30, "9" * 400):
            others = [word for word in OTHERS[command] if option != "--poses"]
            said = refusal([command, "patu655_lift", *others, option, value, "-o", str(tmp_path / "out")], monkeypatch,
                           capsys)
            assert option in said, (option, value)
            assert len(said) <= LONGEST + len("hydroopt: \n")
    assert not (tmp_path / "out").exists()


def test_a_grid_of_infinite_durations_is_refused(tmp_path, monkeypatch, capsys):
    said = refusal(["study", "montecarlo", "patu655_lift", "--vary", "duration=10,inf", "-o", str(tmp_path / "out")],
                   monkeypatch, capsys)
    assert "--vary duration" in said


def test_descriptions_do_not_drive_the_terminal(tmp_path, monkeypatch, capsys):
    file = tmp_path / "digger.toml"
    described = 'name = "digger"\ndescription = "a\\u001b[2Jb\\u202ec [red]"'
    file.write_text(DIGGER.replace('name = "digger"', described, 1), "utf-8")
    monkeypatch.setattr(sys, "argv", ["hydroopt", "show", str(file)])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    shown = capsys.readouterr().out
    assert ended.value.code == 0
    assert "a\\x1b[2Jb\\u202ec [red]" in shown
    assert "\x1b[2J" not in shown
    assert "\u202e" not in shown


@pytest.mark.parametrize("name", ["x" * 5000, "\x1b[2J", "a" * 300 + "/b"])
def test_arguments_are_quoted_short_and_visible(name, monkeypatch, capsys):
    for arguments in (["show", name], [name], ["show", "cat215b", f"--{name}"], ["codegen", name, "-o", name]):
        said = refusal(arguments, monkeypatch, capsys)
        assert len(said) <= LONGEST + len("hydroopt: \n")
        assert said.removesuffix("\n").isprintable()
