"""Whatever is wrong with the input: exit code 2, one sentence with place and remedy, and nothing like a result."""

import re
import subprocess
import sys

import pytest

from fixtures import (
    bad_actuator_cases,
    bad_compare_cases,
    bad_control_cases,
    bad_excite_cases,
    bad_hydraulics_cases,
    bad_input_cases,
    bad_study_cases,
)
from fixtures.bad_input_cases import DIGGER, GOOD_LOG, identify, show
from fixtures.tiers import tiered
from hydroopt import cli

CASES = (bad_input_cases.CASES | bad_excite_cases.CASES | bad_compare_cases.CASES | bad_study_cases.CASES
         | bad_hydraulics_cases.CASES | bad_actuator_cases.CASES | bad_control_cases.CASES)
JARGON = re.compile(r"pydantic|pint|numpy|casadi|typer|click|validation error|dtype|ndarray|tuple|\w+Error\b|Traceback"
                    r"|<class|object at 0x|Input should be a valid tuple", re.IGNORECASE)


def check(code, out, err, case, folder):
    sentence = err.removesuffix("\n").replace(str(folder), "")
    assert code == 2, (code, out, err)
    assert out == ""
    assert "\n" not in sentence
    assert sentence.startswith("hydroopt: ")
    assert re.search(r"; [^;]{6,}\.$", sentence), sentence
    assert re.search(case.place, sentence), sentence
    assert not JARGON.search(sentence), sentence
    assert len(sentence) < 700
    output = folder / "out"
    assert not output.is_dir() or not [p for p in output.rglob("*") if p.is_file()]


@pytest.mark.parametrize("name", tiered(CASES, lambda name: name not in (
    "Parquet that declares 11 GB", "study: scheduler that is not there", "control: unstable loop", "MATLAB cut short",
    "MATLAB that declares 20 GB", "fixed against a constraint", "contradictory constraints",
    "compare: the same log twice among three", "compare: the log of the estimate again", "compare: no joint moves",
    "total mass for a method without constraints", "compare: the same log before and after", "arm that never moves")))
def test_bad_input_is_refused_in_one_sentence(name, tmp_path, monkeypatch, capsys):
    case = CASES[name]
    monkeypatch.setattr(sys, "argv", ["hydroopt", *case.spoil(tmp_path)])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    caught = capsys.readouterr()
    check(ended.value.code, caught.out, caught.err, case, tmp_path)


@pytest.mark.parametrize("name", tiered(["machine: binary", "machine: pin of two numbers",
                                         "NaN that is not allowed", "unknown option",
                                         "output is a file"], lambda name: name == "machine: binary"))
def test_the_command_itself_refuses_bad_input(name, tmp_path):
    case = CASES[name]
    done = subprocess.run([sys.executable, "-m", "hydroopt", *case.spoil(tmp_path)], capture_output=True, text=True,
                          timeout=60, check=False)
    check(done.returncode, done.stdout, done.stderr, case, tmp_path)


@pytest.mark.parametrize("arguments", [["--help"], ["identify", "--help"]])
def test_help_is_no_mistake(arguments, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["hydroopt", *arguments])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 0
    assert "Usage: hydroopt" in capsys.readouterr().out


def test_no_arguments_show_the_help(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["hydroopt"])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 2
    assert capsys.readouterr().out.count("Usage: hydroopt") == 1


def test_an_interrupt_says_so(monkeypatch, capsys):
    def interrupted(*_, **__):
        raise KeyboardInterrupt
    monkeypatch.setattr("hydroopt.machine.machine_file.load_machine", interrupted)
    monkeypatch.setattr(sys, "argv", ["hydroopt", "show", "cat215b"])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 130
    assert "interrupted" in capsys.readouterr().err


def test_the_inputs_that_are_spoilt_are_good(tmp_path, monkeypatch, capsys):
    for arguments in (show(tmp_path, DIGGER), identify(tmp_path, GOOD_LOG, "--method", "wls")):
        monkeypatch.setattr(sys, "argv", ["hydroopt", *arguments])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        assert ended.value.code == 0, capsys.readouterr().err


def test_there_are_enough_kinds():
    assert len(CASES) >= 100
