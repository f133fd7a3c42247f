"""Run a study: cells in parallel, each stored when it is finished; a run that was stopped is resumed."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from contextlib import closing
from pathlib import Path

from hydroopt.errors import ProblemError, SolverError
from hydroopt.extras import needed
from hydroopt.files import claimed, write_files
from hydroopt.progress import Progress, silent
from hydroopt.study import processes
from hydroopt.study.directory import Directory
from hydroopt.study.study import Outcome, Study
from hydroopt.study.table import Table


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
        say: receives the cells, see `hydroopt.progress`.

    Raises:
        ProblemError: the directory holds another study or cannot be written, or another process writes there; the
            scheduler or its workers cannot be used.
        SolverError: no cell succeeded, or the scheduler was lost.
    """
    if not study.cells or workers < 1:
        raise ProblemError("a study needs at least one cell and one worker", where=f"study '{study.name}'",
                           remedy="increase --cells or --processes")
    with claimed(directory):
        return _run(study, directory, scheduler, workers, say)


def _run(study: Study, directory: str | Path, scheduler: str | None, workers: int,
         say: Progress) -> Table:
    place = Directory(directory, study)
    outcomes = place.read()
    missing = [k for k in range(len(study.cells)) if k not in outcomes]
    if missing:
        before = len(outcomes)
        say(f"{len(missing)} of {len(study.cells)} cells to compute, starting")
        with closing(_computed(study, missing, scheduler, workers, say)) as results:
            for index, outcome in results:
                outcomes[index] = place.write(index, outcome)
                say(f"{len(outcomes)} of {len(study.cells)} cells", (len(outcomes) - before) / len(missing))
    table = Table(study.cells, tuple(outcomes[k] for k in range(len(study.cells))))
    write_files(directory, {"results.csv": table.csv()})
    if not table.results:
        raise SolverError(f"no cell succeeded: {next(iter(table.failures)).rstrip('.').replace('; ', ', ')}",
                          where=str(directory), remedy="correct the cause and choose another directory with -o")
    return table


def _computed(study: Study, indices: Sequence[int], scheduler: str | None, workers: int,
              say: Progress) -> Generator[tuple[int, Outcome]]:
    """Outcomes of cells as they finish."""
    if scheduler is None:
        return processes.computed(study, indices, workers)
    needed("distributed", "cells are handed to a scheduler with Dask", where=f"--scheduler {scheduler}")
    from hydroopt.study.scheduler import computed  # noqa: PLC0415 (Dask takes a second to import)

    return computed(study, indices, scheduler, say)
