"""A run of a command: the options that several commands share, and the steps: read, solve, save and print."""

from __future__ import annotations

import inspect
import json
import os
import shutil
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from hydroopt.cli import options
from hydroopt.cli.terminal import WORDS, echo
from hydroopt.errors import ProblemError, SolverError
from hydroopt.support.progress import Progress, silent

if TYPE_CHECKING:
    from hydroopt.limits.reserves import Reserves
    from hydroopt.logs.log import Log
    from hydroopt.logs.smoothing import Smoothing
    from hydroopt.machine.machine import Machine
    from hydroopt.parameters.parameter_set import ParameterSet
    from hydroopt.results.answer import Answer
    from hydroopt.results.json_file import Job

SomeAnswer = TypeVar("SomeAnswer", bound="Answer")
SHARED: dict[str, Any] = {
    "output": options.Directory, "map_file": options.MapFile, "treat": options.Treat,
    "smoothing_text": options.SmoothingText, "bandwidth": options.Bandwidth, "fix": options.Fixed,
    "reserve": options.Reserve, "seed": options.Seed, "parameter_set": options.ParameterSetName,
    "force": options.Force, "quiet": options.Quiet, "as_json": options.AsJson}
"""The options that several commands share, by the attribute of `Run` that holds their value."""
ANSWER = ("output", "force", "quiet", "as_json")
"""Options of every command that saves an answer."""
LOGS = ("map_file", "treat", "parameter_set")
"""Options of every command that reads logs."""
SMOOTHING = ("smoothing_text", "bandwidth")
"""Options of every command that smooths logs."""


@dataclass
class Run:
    """The machine and the shared options of one run of a command; an option that the command lacks has its default.

    Attributes:
        named: name, file or folder of the machine.
        began: when the run began [s], by `time.perf_counter`.
    """

    named: str
    output: Path = Path()
    map_file: Path | None = None
    treat: list[str] | None = None
    smoothing_text: str = "spline"
    bandwidth: float | None = None
    fix: list[str] | None = None
    reserve: list[str] | None = None
    seed: int = 0
    parameter_set: str | None = None
    force: bool = False
    quiet: bool = False
    as_json: bool = False
    began: float = field(default_factory=time.perf_counter)

    @cached_property
    def machine(self) -> Machine:
        """The machine that was named.

        Raises:
            SolverError: its numbers are those of a suspect answer.
        """
        from hydroopt.machine.machine_file import load_machine

        return self.trusted(load_machine(self.named, parameter_set=self.parameter_set))

    def trusted(self, machine: Machine) -> Machine:
        """The same machine, where its numbers are not those of a suspect answer, or that is accepted.

        Raises:
            SolverError: they are.
        """
        if machine.suspect and not self.force:
            raise SolverError(f"its numbers are those of a suspect answer: {machine.suspect.rstrip('.')}",
                              where=self.named, remedy="correct what that says, or accept it with --force")
        return machine

    @property
    def smoothing(self) -> Smoothing:
        """How logs are smoothed."""
        return options.smoothing_of(self.smoothing_text, self.bandwidth, self.machine)

    @property
    def reserves(self) -> Reserves:
        """The part of each limit that is kept unused."""
        return options.reserves_of(self.machine, self.reserve or ())

    def fixed(self, parameters: ParameterSet) -> dict[str, float]:
        """Values [SI] of the parameters that `--fix` holds, by name."""
        return options.parameter_values(self.fix or (), parameters)

    def read(self, paths: Sequence[Path] | None) -> list[Log]:
        """The logs in these files, all read with the same map, treatment and pressure limits."""
        from hydroopt.logs.log_files import read_log

        treatment, limits = options.treatment_of(self.treat), options.reliefs(self.machine)
        return [read_log(path, mapping=self.map_file, treatment=treatment, limits=limits) for path in paths or ()]

    def parted(self, train: Sequence[Path], validation: Sequence[Path] | None,
               holdout: float) -> tuple[list[Log], list[Log]]:
        """Training logs, and validation logs: given ones, and the last part `holdout` of each training log."""
        logs, others = self.read(train), self.read(validation)
        if not holdout:
            return logs, others
        pairs = [log.split(1 - holdout) for log in logs]
        return [pair[0] for pair in pairs], [*others, *(pair[1] for pair in pairs)]

    def session(self, paths: Sequence[Path], option: str) -> list[Log] | Path:
        """The logs of a session, or the one directory that `hydroopt identify` wrote from them.

        Raises:
            ProblemError: there is a directory beside other paths.
            LogError: a log cannot be read.
        """
        if not any(os.path.isdir(path) for path in paths):
            return self.read(paths)
        if len(paths) > 1:
            raise ProblemError("a directory stands for a whole session", where=option,
                               remedy="give one directory, or logs only")
        return paths[0]

    @contextmanager
    def progress(self, what: str) -> Iterator[Progress]:
        """Show the current step, the part that is done and the time left, if the error stream is a terminal."""
        if self.quiet or not sys.stderr.isatty():  # rich takes longer to load than many a job
            yield silent
            return
        from rich.console import Console

        from hydroopt.cli.progress_line import progress_line

        with progress_line(Console(stderr=True)) as shown:
            task = shown.add_task(what, total=1.0)
            yield lambda text, part=None: shown.update(task, description=text, completed=part)

    @contextmanager
    def failure_saved(self, job: Job, method: str,
                      inputs: Callable[[], Sequence[Mapping[str, Any]]] = tuple) -> Iterator[None]:
        """If the solver fails, save the reason in the JSON file of the job before the error is raised again."""
        from hydroopt.results import json_file

        try:
            yield
        except SolverError as error:
            json_file.write_failure(self.output, job, json_file.MachineId.of(self.machine), method, inputs(), error)
            raise

    def saved(self, answer: SomeAnswer, say: Progress = silent, files: Mapping[str, str | bytes | None] | None = None,
              **how: Any) -> SomeAnswer:
        """Save an answer with its page and other files; the answer returned has next steps that repeat this command."""
        from hydroopt.results.answer import CommandLine
        from hydroopt.viewing import page_of

        made = answer.typed(CommandLine(WORDS.get(), str(self.output)))
        say("writing the report", 0.8)
        made.save(self.output, pages={"report.html": page_of(made), **(files or {})},
                  wall_s=time.perf_counter() - self.began, **how)
        return made

    def show(self, answer: Answer, text: str = "") -> None:
        """Print an answer that was saved: its JSON file, or verdict, text, diagnostics and the name of its page.

        Args:
            answer: what was saved.
            text: printed instead of `str(answer)`.

        Raises:
            SolverError: the answer is suspect.
        """
        from hydroopt.results import json_file

        if self.as_json:
            echo(json.dumps(json_file.read(self.output), indent=1))
        elif not self.quiet:
            print_answer(answer, text)
            if (self.output / "report.html").is_file():
                echo(f"{self.output / 'report.html'}")
        if not self.force:
            refuse_suspect(answer, str(self.output))


def print_answer(answer: Answer, text: str = "") -> None:
    """Print the verdict of an answer, its text (or another one), and as many diagnostics as a terminal has room for."""
    from hydroopt.results.verdict import WIDTH, noted

    columns, rows = shutil.get_terminal_size(fallback=(WIDTH, 24))
    printed = f"{answer.verdict.card(columns)}\n\n{text or answer}"
    notes = noted(answer.diagnostics, answer.verdict.cause, columns, rows - len(printed.splitlines()) - 2)
    echo("\n".join([printed, *notes]))


def refuse_suspect(answer: Answer, where: str) -> None:
    """Refuse an answer that was saved and printed, if it is suspect: the exit code is 3.

    Raises:
        SolverError: it is.
    """
    from hydroopt.results.status import Status

    if answer.status is not Status.OK:
        found = "the logs contradict the machine file" if answer.refuted else "something contradicts it"
        raise SolverError(f"{found}, so that this answer cannot be trusted", where=where,
                          remedy="correct what the diagnostics name, or accept it with --force")


def command(*shared: str, machine: Any = options.MachineName) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Make a command of a function whose first argument is a `Run`; the function states the command's own options.

    Args:
        shared: names in `SHARED` of the shared options that the command takes.
        machine: type of the argument that names the machine.
    """
    def decorated(function: Callable[..., None]) -> Callable[..., None]:
        defaults = {each.name: each.default for each in inspect.signature(Run).parameters.values()}
        defaults["output"] = inspect.Parameter.empty
        _, *own = inspect.signature(function, eval_str=True).parameters.values()
        given = [inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=defaults[name], annotation=kind)
                 for name, kind in SHARED.items() if name in shared]

        def run(**values: Any) -> None:
            function(Run(values.pop("machine"), **{name: values.pop(name) for name in shared}), **values)

        first = [inspect.Parameter("machine", inspect.Parameter.KEYWORD_ONLY, annotation=machine)]
        first += [each for each in given if each.name == "output"]
        parameters = [*first, *(each.replace(kind=inspect.Parameter.KEYWORD_ONLY) for each in own),
                      *(each for each in given if each.name != "output")]
        run.__name__, run.__doc__ = function.__name__, function.__doc__
        run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        run.__annotations__ = {each.name: each.annotation for each in parameters}
        return run

    return decorated
