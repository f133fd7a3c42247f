"""Processes of this computer that compute for this one.

They take work through pipes from this process alone: nothing listens anywhere, so that no other user can reach them.
"""

from __future__ import annotations

import os
import pickle
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import connection, get_context, parent_process
from typing import Any, ParamSpec, TypeVar

from hydroopt.support.interrupt import blocked, ignore

P = ParamSpec("P")
T = TypeVar("T")


class Pool(ProcessPoolExecutor):
    """Processes that never receive Ctrl-C: their parent ends them."""

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """Hand out some work, as every `Executor` does; processes are started here."""
        with blocked():
            return super().submit(fn, *args, **kwargs)


@contextmanager
def pool(count: int, begin: Callable[..., object], *given: Any, shared: tuple[Any, ...] = ()) -> Iterator[Pool]:
    """So many processes at most, which end with this one, however it ends, and at once where the block raises.

    Args:
        count: of the processes.
        begin: what each does first, such as keeping what all of its work needs.
        given: its first arguments: what these import is imported when this process is watched already.
        shared: its other arguments, such as queues, which only `multiprocessing` can hand over.

    Raises:
        BrokenProcessPool: a process ended by itself: what the others computed is lost, too.
    """
    context = get_context("spawn")
    ours, theirs = context.Pipe()
    with theirs, Pool(count, context, _begin, (pickle.dumps((begin, given)), theirs, *shared)) as made:
        try:
            yield made
        except BaseException:
            ours.close()
            raise
    ours.close()


def _begin(work: bytes, line: connection.Connection, *shared: Any) -> None:
    """Begin a process, which ends when its parent is gone, as after `kill -9`, or has closed its end of the line."""
    parent = parent_process()
    assert parent is not None

    def watch() -> None:
        connection.wait([parent.sentinel, line])
        os._exit(1)

    threading.Thread(target=watch, name="watch parent", daemon=True).start()
    ignore()
    begin, given = pickle.loads(work)
    begin(*given, *shared)
