"""`hydroopt new`: from answers in a file, at a terminal, interrupted and resumed; errors say which answer."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from fixtures.terminal import Terminal
from hydroopt.cli import app
from hydroopt.errors import ProblemError, StoppedError
from hydroopt.guided.kinds import KINDS
from hydroopt.guided.sketch import Sketch
from hydroopt.machine.machine_file import load_machine

PROMPT = "\n> "


def run(*arguments: str, lines: list[str] | None = None) -> Result:
    typed = None if lines is None else "".join(f"{line}\n" for line in lines)
    return CliRunner().invoke(app, ["new", *arguments], input=typed, catch_exceptions=True)


@pytest.mark.parametrize("kind", KINDS)
def test_answers_from_a_file_make_a_machine_that_show_accepts(kind: str, tmp_path: Path) -> None:
    answers, file = tmp_path / "answers.toml", tmp_path / "mine.toml"
    answers.write_text(f'kind = "{kind}"\nname = "mine"\n')
    done = run(str(file), "--answers", str(answers))
    assert done.exit_code == 0, done.output
    assert f"Next: hydroopt show {file}" in done.stdout
    assert load_machine(file).name == "mine"
    shown = CliRunner().invoke(app, ["show", str(file)], catch_exceptions=False)
    assert shown.exit_code == 0
    assert "refresh" not in file.with_suffix(".html").read_text()


def test_a_dialogue_that_ends_goes_on_where_it_was(tmp_path: Path) -> None:
    file = tmp_path / "crane.toml"
    first = run(str(file), lines=["cr", "my_crane", "?", "1.4 m", "5200", "back", "1.5 m"])
    assert isinstance(first.exception, StoppedError)
    assert "2 answers are kept" in str(first.exception)
    assert "Vertically" in first.stdout  # what '?' explains
    assert "has no unit" in first.stdout
    assert not file.exists()
    again = run(str(file), lines=[""] * (len(Sketch(KINDS["crane"], {}).questions) - 2))
    assert again.exit_code == 0, again.output
    assert "2 answers are taken from" in again.stdout
    assert "It closes: the main_boom turns from" in again.stdout
    machine = load_machine(file)
    assert (machine.name, machine.links[0].joint.d) == ("my_crane", 1.5)


@pytest.mark.parametrize(("text", "said"), [
    ('kind = "boat"\n', "'boat' is not a kind of machine"),
    ('kind = "crane"\n"slew.height" = "2"\n', "answers.toml: slew.height: '2' has no unit"),
    ('kind = "crane"\n"slew.hight" = "2 m"\n', "slew.hight: no question has this key; use slew.height"),
    ('kind = "crane"\n"slew.height" = 2\n', "the answer to 'slew.height' is not a text"),
    ('kind = "crane"\n"main_boom_stroke.extended" = "9 m"\n', "main_boom_stroke.extended: 9 m is outside"),
])
def test_a_wrong_answer_in_a_file_is_named(text: str, said: str, tmp_path: Path) -> None:
    answers, file = tmp_path / "answers.toml", tmp_path / "crane.toml"
    answers.write_text(text)
    done = run(str(file), "--answers", str(answers))
    assert isinstance(done.exception, ProblemError)
    assert said in str(done.exception)
    assert not file.exists()


def test_answers_of_another_kind_are_not_lost(tmp_path: Path) -> None:
    file = tmp_path / "crane.toml"
    run(str(file), "--kind", "crane", lines=["my_crane"])
    kept = file.with_suffix(".answers.toml").read_text()
    done = run(str(file), "--kind", "loader", lines=["my_loader"])
    assert "those of another kind, crane" in str(done.exception)
    assert file.with_suffix(".answers.toml").read_text() == kept


def test_a_file_that_exists_is_kept(tmp_path: Path) -> None:
    file = tmp_path / "crane.toml"
    file.write_text("mine")
    done = run(str(file), "--kind", "crane", lines=[])
    assert isinstance(done.exception, ProblemError)
    assert file.read_text() == "mine"


@pytest.mark.slow
@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "excavator"])
def test_typical_answers_at_a_terminal_make_a_machine(kind: str, tmp_path: Path) -> None:
    """In a terminal of its own, question by question; the README's tutorial does so for the excavator."""
    file = tmp_path / "mine.toml"
    terminal = Terminal("new", str(file), "--kind", kind)
    try:
        asked = 0
        while not file.exists():
            terminal.until(lambda before=asked: terminal.shown.count(PROMPT) > before
                           or terminal.command.poll() is not None)
            if terminal.command.poll() is not None:
                break
            asked += 1
            terminal.type("\n")
        assert terminal.ended() == 0, terminal.last
    finally:
        terminal.close()
    assert asked >= 8
    assert load_machine(file).name == f"my_{kind}"
