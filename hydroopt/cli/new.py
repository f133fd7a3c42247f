"""`hydroopt new`: a machine file from questions, with a drawing after every answer."""

from __future__ import annotations

import math
import os
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hydroopt.cli.terminal import echo
from hydroopt.errors import HydrooptError, ProblemError, StoppedError

if TYPE_CHECKING:
    from hydroopt.guided.question import Question


def new(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="The machine file to write, such as crane.toml.")],
    kind: Annotated[str | None, typer.Option(help=(
        "Kind of machine: excavator, loader, crane, arm or empty; asked if not given."))] = None,
    answers: Annotated[Path | None, typer.Option("--answers", metavar="FILE", help=(
        "TOML file of answers by key, as this command keeps them; what it leaves out is taken as typical."))] = None,
) -> None:
    """Describe your own machine: answer questions with a tape, and see it drawn after every answer.

    Lengths run from pin centre to pin centre. An empty answer takes what is typical, marked as assumed in the file;
    '?' explains, 'back' takes back the last answer. Ctrl-C loses nothing: the same command goes on.

    Example: hydroopt new my_excavator.toml --kind excavator
    """
    if file.suffix != ".toml":
        raise ProblemError("a machine file ends in .toml", where=str(file), remedy=f"write {file.stem}.toml")
    if os.path.exists(file):
        raise ProblemError("there is such a file already", where=str(file), remedy="name another one, or remove it")
    Dialogue(file, kind, answers).run()


class Dialogue:
    """Questions on the terminal, or answers from a file.

    Attributes:
        file: machine file that is written in the end; answers are kept beside it.
        journal: where answers are kept, the one that `--answers` takes.
        given: answers from a file instead of the terminal, None without.
    """

    def __init__(self, file: Path, kind: str | None, answers: Path | None) -> None:
        from hydroopt.guided.kinds import KINDS
        from hydroopt.guided.sketch import Sketch

        self.file, self.journal = file, file.with_suffix(".answers.toml")
        self.given = None if answers is None else _read(answers)
        self.where = str(answers or self.journal)
        kept = _read(self.journal) if answers is None and self.journal.exists() else {}
        named = kind or (self.given or kept).get("kind") or ("" if self.given is not None else self._ask_kind(KINDS))
        if named not in KINDS:
            raise ProblemError(f"'{named}' is not a kind of machine", where="--kind",
                               remedy=f"use one of {', '.join(KINDS)}")
        if kept and kept.get("kind") != named:
            raise ProblemError(f"the answers kept there are those of another kind, {kept.get('kind', 'unknown')}",
                               where=str(self.journal), remedy="leave out --kind, name another file, or remove it")
        self.sketch = Sketch(KINDS[named], {key: text for key, text in kept.items() if key != "kind"})
        if self.sketch.answers:
            echo(f"{len(self.sketch.answers)} answers are taken from {self.journal}.")
        self.shown = ""

    @staticmethod
    def _ask_kind(kinds: Mapping[str, object]) -> str:
        while True:
            text = _ask(f"What kind of machine is it? ({', '.join(kinds)})").strip().lower()
            found = [name for name in kinds if text and name.startswith(text)]
            if len(found) == 1:
                return found[0]
            echo(f"  Write one of {', '.join(kinds)}.")

    def run(self) -> None:
        """Ask until the machine is complete, and write it."""
        try:
            if self.given is not None:
                self._take(self.given)
            while True:
                question = self.sketch.open
                if question is not None:
                    self._ask_one(question)
                elif self._written():
                    return
        except (EOFError, KeyboardInterrupt):
            raise StoppedError(f"{len(self.sketch.answers)} answers are kept", where=str(self.journal),
                               remedy="the same command goes on from there") from None

    def _take(self, given: Mapping[str, str]) -> None:
        """Take all answers of a file.

        Raises:
            ProblemError: one of them cannot be taken, or belongs to no question.
        """
        from hydroopt.guided.question import TYPICAL, AnswerError
        from hydroopt.support.input_file import similar

        while (question := self.sketch.open) is not None:
            try:
                self.sketch = self.sketch.answered(question, given.get(question.key, TYPICAL))
            except AnswerError as error:
                raise ProblemError(str(error), where=f"{self.where}: {question.key}",
                                   remedy="correct this answer, or one before it") from None
        known = {"kind", *(question.key for question in self.sketch.questions)}
        for key in given:
            if key not in known:
                close = " or ".join(similar(key, known)) or "one of those that 'hydroopt new' keeps"
                raise ProblemError("no question has this key", where=f"{self.where}: {key}", remedy=f"use {close}")

    def _ask_one(self, question: Question) -> None:
        from hydroopt.guided.question import AnswerError

        self._draw()
        keys = [each.key for each in self.sketch.questions]
        number = f"{keys.index(question.key) + 1}/{len(keys)}"
        text = _ask(f"[{number}] {question.text} [{question.shown}]")
        if text.strip() == "?":
            choices = f"One of {', '.join(question.choices)}. " if question.choices else ""
            echo(f"  {choices}{question.hint[:1].upper()}{question.hint[1:]}{'. ' if question.hint else ''}"
                 f"Enter takes {question.shown}, typical of {self.sketch.kind.typical}; 'back' returns.")
        elif text.strip().lower() == "back":
            self._back()
        else:
            try:
                self.sketch = self.sketch.answered(question, text)
            except AnswerError as error:
                echo(f"  {str(error)[:1].upper()}{str(error)[1:]}.")
                return
            self._keep()
            self._say_range(question)

    def _back(self) -> None:
        from hydroopt.guided.sketch import Sketch

        answered = [each.key for each in self.sketch.questions if each.key in self.sketch.answers]
        if not answered:
            echo("  This is the first question.")
            return
        kept = {key: text for key, text in self.sketch.answers.items() if key != answered[-1]}
        self.sketch = Sketch(self.sketch.kind, kept)
        self._keep()

    def _say_range(self, question: Question) -> None:
        """Say how far a joint turns, once its stroke is known."""
        from hydroopt.guided.plane import OpenError

        for k, member in enumerate(self.sketch.members):
            if question.key == f"{member.name}_stroke.extended":
                try:
                    low, high = (math.degrees(limit) for limit in self.sketch.limits(k))
                    echo(f"  It closes: the {member.name} turns from {low:.0f} to {high:.0f} deg; typical is "
                         f"{member.range[0]:.0f} to {member.range[1]:.0f} deg.")
                except OpenError as error:
                    echo(f"  It does not close: {error}. Write 'back' to correct a length.")

    def _draw(self) -> None:
        from hydroopt.guided.drawing import terminal

        drawn = terminal(self.sketch)
        if drawn != self.shown:
            echo(f"\n{drawn}\n")
            self.shown = drawn

    def _keep(self) -> None:
        """Keep the answers and draw the page."""
        from hydroopt.guided.drawing import page
        from hydroopt.support.files import write_file

        lines = [f'kind = "{self.sketch.kind.name}"', *(f'"{key}" = "{text}"'
                                                        for key, text in self.sketch.answers.items())]
        write_file(self.journal, ("\n".join(lines) + "\n").encode())
        write_file(self.file.with_suffix(".html"), page(self.sketch).encode())

    def _written(self) -> bool:
        """Write the machine file if a machine can be like that; else say why not, and ask again."""
        from hydroopt.guided.drawing import page
        from hydroopt.guided.machine_text import machine_text
        from hydroopt.guided.plane import OpenError
        from hydroopt.machine.machine_file import read_machine
        from hydroopt.support.files import write_file

        try:
            text = machine_text(self.sketch)
            machine = read_machine(text, where=str(self.file))
        except (OpenError, HydrooptError) as error:
            if self.given is not None:
                raise ProblemError(str(error).removeprefix(f"{self.file}: ").rstrip("."), where=self.where,
                                   remedy="correct the lengths of this part") from None
            echo(f"  No machine can be like that yet: {error}\n  The last answer is asked again; write 'back' for "
                 "those before.")
            self._back()
            return False
        self._draw()
        self._keep()
        write_file(self.file, text.encode())
        write_file(self.file.with_suffix(".html"), page(self.sketch, finished=True).encode())
        measured = sum(bool(answer) for answer in self.sketch.answers.values())
        echo(f"{self.file}: {machine!r}, {measured} answers, {len(self.sketch.answers) - measured} typical numbers "
             f"marked as assumed.\nSide view: {self.file.with_suffix('.html')}. Answers: {self.journal}.\n"
             f"Next: hydroopt show {shlex.quote(str(self.file))}")
        return True


def _ask(text: str) -> str:
    """A line from the terminal or standard input."""
    echo(f"{text} ")
    return input("> ")


def _read(file: Path) -> dict[str, str]:
    """Answers by key.

    Raises:
        ProblemError: the file is not a table of texts.
    """
    from hydroopt.support.input_file import read_text, toml

    content = toml(read_text(file, ProblemError, noun="file of answers"), ProblemError, where=str(file))
    wrong = [key for key, value in content.items() if not isinstance(value, str)]
    if wrong:
        raise ProblemError(f"the answer to '{wrong[0]}' is not a text", where=str(file),
                           remedy="write it in quotes, such as \"2.5 m\"")
    return {str(key): str(value) for key, value in content.items()}
