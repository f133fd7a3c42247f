"""The command that gives an answer: where it is saved, and how to run it again with more options."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class CommandLine:
    """What was typed, from which next steps are made that can be copied.

    Attributes:
        words: of the command, without the program's name; empty where no command was typed, as in Python.
        directory: that receives the answer; ``DIR`` where no command says so.

    >>> typed = CommandLine(("identify", "cat215b", "my log.csv", "-o", "out"), "out")
    >>> typed.again("--holdout", "0.3")
    "hydroopt identify cat215b 'my log.csv' -o out --holdout 0.3"
    >>> typed.path("poses.csv"), CommandLine().path(), CommandLine().again("--holdout", "0.3")
    ('out/poses.csv', 'DIR', '')
    """

    words: tuple[str, ...] = ()
    directory: str = "DIR"

    def again(self, *more: str) -> str:
        """The same command with more options; empty where none was typed."""
        return shlex.join(("hydroopt", *self.words, *more)) if self.words else ""

    def given(self, *options: str) -> bool:
        """Whether one of the options was typed."""
        return any(word.partition("=")[0] in options for word in self.words)

    def path(self, *parts: str) -> str:
        """A file of the answer, or its directory, quoted for a shell."""
        return shlex.quote(str(Path(self.directory, *parts)))
