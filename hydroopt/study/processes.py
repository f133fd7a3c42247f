"""Cells in processes of this computer, which take work from this process alone: through pipes that it hands to them.

Nothing listens anywhere, so that no other user of the computer can reach them.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from itertools import repeat
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait

from hydroopt.errors import ProblemError
from hydroopt.interrupt import blocked, deferred, end_with_parent
from hydroopt.study.cell import outcome
from hydroopt.study.study import Outcome, Study, Values

PAUSE = 0.2
"""Interval [s] between looks at Ctrl-C."""
_CONTEXT = get_context("spawn")


def computed(study: Study, indices: Sequence[int], workers: int) -> Generator[tuple[int, Outcome]]:
    """Outcomes of some cells, in the order in which they finish.

    Raises:
        ProblemError: the processes cannot start.
    """
    suspects = []
    for index, found in _finished(study, indices, min(workers, len(indices))):
        if found is None:
            suspects.append(index)
        else:
            yield index, found
    for index in suspects:  # one by one: the memory may suffice for one
        for _, found in _finished(study, [index], 1):
            yield index, found or {"error": f"cell {index}: the process that computed it died repeatedly; check "
                                   "whether the memory suffices."}


class _Worker:
    """A process that computes one cell at a time; `index` is that cell's, once the process is ready."""

    def __init__(self, function: Callable[..., Values]) -> None:
        self.index: int | None = None
        self.line, end = _CONTEXT.Pipe()
        self.process = _CONTEXT.Process(target=end_with_parent, args=(pickle.dumps((_serve, (function,))), end),
                                        daemon=True)
        self.process.start()
        end.close()  # so that the line breaks when the process ends

    def compute(self, index: int, values: Values) -> None:
        self.index = index
        with suppress(OSError):  # if it has died, the answer is missing
            self.line.send(values)

    def end(self) -> None:
        self.line.close()
        self.process.kill()
        self.process.join()


def _serve(function: Callable[..., Values], line: Connection) -> None:
    """Compute the cells that come through the line, until it breaks."""
    with suppress(EOFError, OSError):
        line.send({})  # ready
        while True:
            line.send(outcome(function, line.recv()))


def _finished(study: Study, indices: Sequence[int], workers: int) -> Iterator[tuple[int, Outcome | None]]:
    """Indices of cells with their outcomes, None if the process that computed the cell died."""
    waiting = list(reversed(indices))
    crew: dict[Connection, _Worker] = {}
    try:
        with deferred() as interrupted:
            crew.update(_started(study, workers))
            while crew:
                if interrupted():
                    raise KeyboardInterrupt
                for line in wait(list(crew), PAUSE):
                    assert isinstance(line, Connection)
                    index, found = crew[line].index, _received(line)
                    if found is None:  # the process has died
                        crew.pop(line).end()
                        if index is None:
                            raise ProblemError(
                                "a process for its cells ended before it could start", where=f"study '{study.name}'",
                                remedy="in a script, run it below 'if __name__ == \"__main__\":'; use fewer "
                                "--processes if memory is short")
                        if waiting:
                            crew.update(_started(study, 1))
                    elif waiting:
                        crew[line].compute(following := waiting.pop(), study.cells[following])
                    else:
                        crew.pop(line).end()
                    if index is not None:
                        yield index, found
    finally:
        for worker in crew.values():
            worker.end()


def _started(study: Study, count: int) -> dict[Connection, _Worker]:
    """New workers by their lines. A start takes until the process has read the study's function."""
    with blocked(), ThreadPoolExecutor(count) as pool:  # only this process receives Ctrl-C
        return {worker.line: worker for worker in pool.map(_Worker, repeat(study.function, count))}


def _received(line: Connection) -> Outcome | None:
    """An outcome, or nothing but that the worker is ready; None if it has died."""
    try:
        found: Outcome = line.recv()
    except (EOFError, OSError):
        return None
    return found
