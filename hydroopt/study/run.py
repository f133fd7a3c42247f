"""Run a study: cells in parallel, each stored when it is finished; a run that was stopped is resumed."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import AbstractContextManager, closing
from functools import partial
from pathlib import Path
from typing import Any

from hydroopt.errors import ProblemError, SolverError
from hydroopt.study.processes import Crew, computed, processes
from hydroopt.study.study import Outcome, Study, Value
from hydroopt.study.table import Table
from hydroopt.support.files import claimed, write_files
from hydroopt.support.input_file import read_json
from hydroopt.support.packages import needed
from hydroopt.support.progress import Progress, silent

IDENTITY = "study.json"


def run(study: Study, directory: str | Path, *, scheduler: str | None = None, workers: int = 2,
        say: Progress = silent) -> Table:
    """Compute the cells of a study that its directory does not hold yet.

    A cell that fails is stored with its error, and so is one whose process dies repeatedly. However a run ends, the
    finished cells are kept and the next run resumes from them. The final table is the same bit for bit on computers of
    one kind.

    Args:
        study: what to compute.
        directory: gets ``study.json``, ``cells/INDEX.json`` and, at the end, ``results.csv``.
        scheduler: address of a Dask scheduler whose workers compute the cells, such as ``tcp://host:8786``; they need
            this hydroopt, but no access to the directory. ``tls://host:8786`` uses the certificates of Dask's
            configuration. By default processes of this computer; then a script needs the usual
            ``if __name__ == "__main__"``.
        workers: number of processes, if there is no scheduler.
        say: receives the cells, see `hydroopt.support.progress`.

    Raises:
        ProblemError: the directory holds another study or cannot be written, or another process writes there; the
            scheduler or its workers cannot be used.
        SolverError: no cell succeeded, or the scheduler was lost.
    """
    if not study.cells or workers < 1:
        raise ProblemError("a study needs at least one cell and one worker", where=f"study '{study.name}'",
                           remedy="increase --cells or --processes")
    with claimed(directory):
        place = Directory(directory, study)
        outcomes = place.read()
        missing, before = [k for k in range(len(study.cells)) if k not in outcomes], len(outcomes)
        if missing:
            say(f"{len(missing)} of {len(study.cells)} cells to compute, starting")
            crew = _crew(study, scheduler, min(workers, len(missing)), say)
            with closing(_finished(study, missing, crew)) as results:
                for index, outcome in results:
                    outcomes[index] = place.write(index, outcome)
                    say(f"{len(outcomes)} of {len(study.cells)} cells", (len(outcomes) - before) / len(missing))
        table = Table(study.cells, tuple(outcomes[k] for k in range(len(study.cells))))
        write_files(directory, {"results.csv": table.csv()})
    if not table.results:
        raise SolverError(f"no cell succeeded: {next(iter(table.failures)).rstrip('.').replace('; ', ', ')}",
                          where=str(directory), remedy="correct the cause and choose another directory with -o")
    return table


def _crew(study: Study, scheduler: str | None, workers: int,
          say: Progress) -> Callable[[], AbstractContextManager[Crew]]:
    """What computes cells: processes of this computer, or the workers of a Dask scheduler."""
    if scheduler is None:
        return partial(processes, study, workers)
    needed("distributed", "cells are handed to a scheduler with Dask", where=f"--scheduler {scheduler}")
    from hydroopt.study.scheduler import computing  # noqa: PLC0415 (Dask takes a second to import)

    return partial(computing, study, scheduler, say)


def _finished(study: Study, indices: Sequence[int],
              crew: Callable[[], AbstractContextManager[Crew]]) -> Generator[tuple[int, Outcome]]:
    """Outcomes of cells as they finish."""
    suspects = []
    for index, found in computed(study, indices, crew):
        if found is None:
            suspects.append(index)
        else:
            yield index, found
    for suspect in suspects:  # one by one: a crash costs no other cell, and the memory may suffice for one
        for index, found in computed(study, [suspect], crew):
            yield index, found or {"error": f"cell {index}: the process that computed it died repeatedly; check "
                                   "whether the memory suffices."}


class Directory:
    """``study.json`` with the identity of the study, and ``cells/INDEX.json``; each file appears whole or not."""

    def __init__(self, path: str | Path, study: Study) -> None:
        """Open or create a study's directory.

        Raises:
            ProblemError: it holds the cells of another study, or cannot be written.
        """
        self.path, self.study = Path(path), study
        refuse(self.path, study)
        write_files(self.path, {IDENTITY: json.dumps(study.identity, indent=1)})

    def read(self) -> dict[int, Outcome]:
        """Outcomes of the finished cells, by index; a cell that cannot be read counts as unfinished."""
        found: dict[int, Outcome] = {}
        for index, cell in enumerate(self.study.cells):
            try:
                content = read_json(self.path / f"cells/{index}.json", ProblemError)
                kept = {key: value for key, value in content.items() if key in ("result", "error")}
                if content["cell"] == cell and len(kept) == 1 and isinstance(kept.get("result", {}), dict):
                    found[index] = kept
            except (ProblemError, TypeError, KeyError):
                continue
        return found

    def write(self, index: int, outcome: Outcome) -> Outcome:
        """Store a cell's outcome.

        Returns:
            The outcome as `read` will return it.
        """
        if "result" in outcome:
            outcome = {"result": {key: _value(value) for key, value in outcome["result"].items()}}
        write_files(self.path, {f"cells/{index}.json": json.dumps({"cell": self.study.cells[index], **outcome},
                                                                  allow_nan=False)})
        return outcome


def refuse(directory: Path, study: Study) -> None:
    """Refuse a directory that holds another study.

    Raises:
        ProblemError: the directory holds another study; the message names the first setting that differs.
    """
    where, remedy = str(directory), "choose another directory with -o"
    if directory.exists() and not directory.is_dir():
        raise ProblemError("this is a file", where=where, remedy=remedy)
    if not (directory / IDENTITY).exists():
        if (directory / "cells").exists():
            raise ProblemError(f"there are cells but no {IDENTITY}, so that their study is unknown", where=where,
                               remedy=remedy)
        return
    try:
        there = read_json(directory / IDENTITY, ProblemError)
    except ProblemError:
        raise ProblemError("the file cannot be read, so that the study of these cells is unknown",
                           where=str(directory / IDENTITY), remedy=remedy) from None
    different = _difference(there, study.identity)
    if different:
        raise ProblemError(f"this directory holds another study: {different}", where=where,
                           remedy=f"repeat the settings in its {IDENTITY}, or {remedy}")


def _difference(there: Mapping[str, Any], here: Mapping[str, Any], within: str = "") -> str:
    """The first setting that differs, in words; "" if none does."""
    for key in dict.fromkeys([*here, *there]):
        old, new = there.get(key), here.get(key)
        if isinstance(old, dict) and isinstance(new, dict):
            if inner := _difference(old, new, f"{within}{key} "):
                return inner
        elif old != new:
            return f"{within}{key} is {_short(old)} there and {_short(new)} here"
    return ""


def _short(value: object) -> str:
    text = "absent" if value is None else json.dumps(value)
    return text if len(text) <= 60 else f"{text[:28]}...{text[-28:]}"


def _value(value: Any) -> Value:
    """A number or a word as JSON stores it, without loss; None for NaN and infinity."""
    if value is None or isinstance(value, str):
        return value
    if isinstance(value, int):
        return int(value)
    return float(value) if math.isfinite(value) else None
