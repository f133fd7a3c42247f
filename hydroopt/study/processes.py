"""Cells in processes of this computer."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool

from hydroopt.errors import ProblemError
from hydroopt.study.study import Outcome, Study, Values, outcome
from hydroopt.support.interrupt import deferred
from hydroopt.support.processes import pool

PAUSE = 0.2
"""Interval [s] between looks at Ctrl-C."""


def computed(study: Study, indices: Sequence[int], workers: int) -> Generator[tuple[int, Outcome | None]]:
    """Outcomes of some cells, in the order in which they finish; None where a process died while it was computed.

    Raises:
        ProblemError: the processes cannot start.
    """
    waiting = list(reversed(indices))
    with deferred() as interrupted:
        while waiting:
            running: dict[Future[Outcome], int] = {}
            try:
                with pool(min(workers, len(waiting)), _Cells.begin, study.function) as crew:
                    _start(study, crew.submit(bool))
                    while waiting or running:
                        while waiting and len(running) < workers:  # what waits in the pool is not suspected
                            begun = crew.submit(_Cells.outcome, study.cells[waiting[-1]])
                            running[begun] = waiting.pop()
                        if interrupted():
                            raise KeyboardInterrupt
                        for done in wait(running, PAUSE, FIRST_COMPLETED).done:
                            found = done.result()
                            yield running.pop(done), found
            except BrokenProcessPool:
                yield from ((index, None) for index in running.values())


def _start(study: Study, ready: Future[bool]) -> None:
    """Wait for the first process."""
    try:
        ready.result()
    except BrokenProcessPool:
        raise ProblemError("a process for its cells ended before it could start", where=f"study '{study.name}'",
                           remedy="in a script, run it below 'if __name__ == \"__main__\":'; use fewer --processes if "
                           "memory is short") from None


class _Cells:
    """What a process keeps: the study's function, which may cache what all of its cells share."""

    function: Callable[..., Values]

    @classmethod
    def begin(cls, function: Callable[..., Values]) -> None:
        cls.function = function

    @classmethod
    def outcome(cls, values: Values) -> Outcome:
        return outcome(cls.function, values)
