"""Commands print an answer, and save why there is none."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from hydroopt.cli.terminal import echo
from hydroopt.cli.typed import WORDS
from hydroopt.errors import SolverError

if TYPE_CHECKING:
    from hydroopt.machine.machine import Machine
    from hydroopt.results.answer import Answer
    from hydroopt.results.json_file import Job


SomeAnswer = TypeVar("SomeAnswer", bound="Answer")


def continued(answer: SomeAnswer, directory: Path) -> SomeAnswer:
    """The answer of this command, which is saved in a directory, with next steps that can be copied."""
    from hydroopt.results.command_line import CommandLine

    return answer.typed(CommandLine(WORDS.get(), str(directory)))


@contextmanager
def failure_saved(directory: Path, job: Job, machine: Machine, method: str,
                  inputs: Callable[[], Sequence[Mapping[str, Any]]] = tuple) -> Iterator[None]:
    """Save why a solver gave no trustworthy answer, and raise its error again."""
    from hydroopt.results import json_file

    try:
        yield
    except SolverError as error:
        json_file.write_failure(directory, job, json_file.MachineId.of(machine), method, inputs(), error)
        raise


def refuse_refuted(answer: Answer, directory: Path) -> None:
    """End a command whose answer was saved and printed, but rests on logs that contradict the machine file.

    Raises:
        SolverError: a log is misread.
    """
    if answer.refuted:
        raise SolverError("the logs contradict the machine file, so that this answer cannot be trusted",
                          where=str(directory), remedy="correct what the diagnostics name")


def print_answer(answer: Answer, directory: Path, text: str = "", *, quiet: bool, as_json: bool) -> None:
    """Print an answer that was saved: as its JSON file, or its verdict, a text, diagnostics and the report.

    Args:
        answer: what was saved.
        directory: where.
        text: instead of the answer's own.
        quiet: print nothing, unless as JSON.
        as_json: print the JSON file.
    """
    from hydroopt.results import json_file
    from hydroopt.results.diagnostic import summary
    from hydroopt.results.verdict import WIDTH

    if as_json:
        echo(json.dumps(json_file.read(directory), indent=1))
    elif not quiet:
        width = shutil.get_terminal_size(fallback=(WIDTH, 24)).columns
        echo(f"{answer.verdict.card(width)}\n")
        echo(text or str(answer))
        for heading, sentences in summary(answer.diagnostics).items():
            echo(f"{heading}:")
            for sentence in sentences:
                echo(f"  ! {sentence}")
        if (directory / "report.html").is_file():
            echo(f"{directory / 'report.html'}")
