"""Those who compute the cells of a study: processes of this computer here, workers of Dask in `study.scheduler`."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, contextmanager
from typing import NamedTuple

from hydroopt.errors import ProblemError
from hydroopt.study.study import Outcome, Study, Values, outcome
from hydroopt.support.interrupt import deferred
from hydroopt.support.processes import pool

PAUSE = 0.2
"""Interval [s] between looks at Ctrl-C."""


class Crew(NamedTuple):
    """What computes cells: `submit` hands one out, and `result` is its outcome, None where its process died."""

    submit: Callable[[Values], Future[Outcome]]
    result: Callable[[Future[Outcome]], Outcome | None]
    most: int
    """Cells that are handed out at a time."""


def computed(study: Study, indices: Sequence[int],
             crew: Callable[[], AbstractContextManager[Crew]]) -> Generator[tuple[int, Outcome | None]]:
    """Outcomes of some cells, in the order in which they finish; None where a process died while it was computed."""
    waiting = list(reversed(indices))
    with deferred() as interrupted:
        while waiting:
            running: dict[Future[Outcome], int] = {}
            try:
                with crew() as hands:
                    while waiting or running:
                        while waiting and len(running) < hands.most:  # what waits in a pool is not suspected
                            begun = hands.submit(study.cells[waiting[-1]])
                            running[begun] = waiting.pop()
                        if interrupted():
                            raise KeyboardInterrupt
                        for done in wait(running, PAUSE, FIRST_COMPLETED).done:
                            found = hands.result(done)
                            yield running.pop(done), found
            except BrokenProcessPool:  # a new one computes the others
                yield from ((index, None) for index in running.values())


@contextmanager
def processes(study: Study, workers: int) -> Iterator[Crew]:
    """Processes of this computer.

    Raises:
        ProblemError: they cannot start.
    """
    with pool(workers, _Cells.begin, study.function) as crew:
        try:
            crew.submit(bool).result()
        except BrokenProcessPool:
            raise ProblemError("a process for its cells ended before it could start", where=f"study '{study.name}'",
                               remedy="in a script, run it below 'if __name__ == \"__main__\":'; use fewer --processes "
                               "if memory is short") from None
        yield Crew(lambda values: crew.submit(_Cells.outcome, values), Future.result, workers)


class _Cells:
    """What a process keeps: the study's function, which may cache what all of its cells share."""

    function: Callable[..., Values]

    @classmethod
    def begin(cls, function: Callable[..., Values]) -> None:
        cls.function = function

    @classmethod
    def outcome(cls, values: Values) -> Outcome:
        return outcome(cls.function, values)
