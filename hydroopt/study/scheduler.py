"""Cells on the workers of a Dask scheduler.

No other module imports Dask, and this one is imported only if there are cells to compute.

Who can send work to the scheduler runs code on its workers, and they on it. With an address ``tls://host:8786`` all of
them, this client too, prove who they are by the certificates that Dask's configuration states (distributed.comm.tls).
"""

from __future__ import annotations

import asyncio
import logging
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from functools import partial
from queue import Empty, SimpleQueue
from typing import Any

import dask
from distributed import Client, Future, KilledWorker, Security, Worker, WorkerPlugin, get_worker, rpc

from hydroopt.errors import ProblemError, SolverError
from hydroopt.study.processes import PAUSE
from hydroopt.study.study import Compute, Outcome, Study, Values, outcome
from hydroopt.support.interrupt import deferred
from hydroopt.support.packages import versions
from hydroopt.support.progress import Progress

PATIENCE, JOINING = 5.0, 60.0
"""Time limits [s] for a scheduler to answer and for a worker to join."""
CONFIG = {"distributed.comm.timeouts.connect": f"{PATIENCE:g}s", "distributed.scheduler.worker-saturation": 1.0,
          "distributed.scheduler.allowed-failures": 1}
"""Workers do not queue cells, so that only the running cell is suspected when a worker dies; suspects are retried."""


class _Work(WorkerPlugin):  # type: ignore[misc]
    """Installs the study's function in every worker, also in those that join later or replace one that died."""

    def __init__(self, study: Study) -> None:
        self.name, self.function, self.versions = f"hydroopt-{study.digest}", study.function, versions()
        self.turn: threading.Lock | None = None

    def setup(self, worker: Worker) -> None:
        if versions() != self.versions:
            raise RuntimeError(f"the worker has {versions()} instead of {self.versions}")
        self.turn = threading.Lock()

    def cell(self, values: Values) -> Outcome:
        assert self.turn is not None
        with self.turn:  # one cell at a time: CasADi's symbols and the limit of threads are shared by all threads
            return outcome(self.function, values)


def _cell(name: str, values: Values) -> Outcome:
    work: Any = get_worker().plugins[name]
    found: Outcome = work.cell(values)
    return found


@contextmanager
def computing(study: Study, scheduler: str, say: Progress) -> Iterator[Compute]:
    """What computes cells on the workers of a scheduler.

    Raises:
        ProblemError: there is no scheduler at the address, or its workers cannot be used.
        SolverError: the scheduler was lost.
    """
    with _client(scheduler) as client:
        work = _Work(study)
        _hand_out(client, work, scheduler, say)
        try:
            yield partial(_finished, client, study, work.name, say=say)
        finally:
            if client.status == "running":
                with suppress(OSError):  # the connection has just been lost
                    client.unregister_worker_plugin(work.name)


@contextmanager
def _client(scheduler: str) -> Iterator[Client]:
    with _silent(), dask.config.set(CONFIG):
        security = _security(scheduler)
        try:
            asyncio.run(asyncio.wait_for(_answer(scheduler, security), PATIENCE))
            client = Client(scheduler, timeout=PATIENCE, set_as_default=False, security=security)
        except (OSError, ValueError) as error:
            raise ProblemError(f"no Dask scheduler answers at this address ({_short(error)})", where=f"--scheduler "
                               f"{scheduler}", remedy="start one with 'dask scheduler' and give the address that it "
                               "prints, such as tcp://host:8786 or tls://host:8786") from None
        with client:
            yield client


@contextmanager
def _silent() -> Iterator[None]:
    """Messages of Dask's loggers are left out: the study itself reports lost processes and connections."""
    loggers = [logging.getLogger(name) for name in [*logging.root.manager.loggerDict, "asyncio"]
               if name.partition(".")[0] in ("distributed", "tornado", "asyncio")]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)


def _security(scheduler: str) -> Security:
    """The certificates that Dask's configuration states, which an address tls://... needs."""
    security = Security()
    try:
        if scheduler.startswith("tls://") and security.get_connection_args("client").get("ssl_context") is None:
            raise ValueError("it states none")
    except (OSError, ValueError) as error:
        raise ProblemError(
            f"the certificates in Dask's configuration cannot be used ({_short(error)})",
            where=f"--scheduler {scheduler}", remedy="set DASK_DISTRIBUTED__COMM__TLS__CA_FILE, "
            "DASK_DISTRIBUTED__COMM__TLS__CLIENT__CERT and DASK_DISTRIBUTED__COMM__TLS__CLIENT__KEY") from None
    return security


async def _answer(address: str, security: Security) -> None:
    """Check that a scheduler listens: a client would wait forever for another kind of server."""
    async with rpc(address, connection_args=security.get_connection_args("client")) as remote:
        kind = (await remote.identity())["type"]
    if kind != "Scheduler":
        raise ValueError(f"this is a {kind.lower()}")


def _hand_out(client: Client, work: _Work, scheduler: str, say: Progress) -> None:
    try:
        if not client.scheduler_info()["workers"]:
            say("waiting for workers")
        client.wait_for_workers(1, timeout=JOINING)
    except TimeoutError:
        raise ProblemError(f"no worker has joined within {JOINING:.0f} s", where=f"--scheduler {scheduler}",
                           remedy="start some with 'dask worker'") from None
    try:
        client.register_plugin(work, name=work.name)
    except Exception as error:
        raise ProblemError(f"a worker cannot run the study ({_short(error)})", where=f"--scheduler {scheduler}",
                           remedy="install the same hydroopt and the same packages for the workers") from error


def _finished(client: Client, study: Study, name: str, indices: Sequence[int],
              say: Progress) -> Iterator[tuple[int, Outcome | None]]:
    """Indices of cells with their outcomes, None if the process that computed the cell died too often."""
    queue: SimpleQueue[Future] = SimpleQueue()
    keys = {f"{name}-{index}": index for index in indices}
    futures = client.map(_cell, [name] * len(indices), [study.cells[index] for index in indices], key=list(keys),
                         pure=False)
    waiting = dict(zip(keys, futures, strict=True))
    for future in futures:
        future.add_done_callback(queue.put)
    del futures
    with deferred() as interrupted:
        while waiting:
            if interrupted():
                raise KeyboardInterrupt
            try:
                future = queue.get(timeout=PAUSE)
            except Empty:
                if client.status != "running":
                    raise _lost() from None
                if not client.scheduler_info()["workers"]:
                    say("waiting for workers")
                continue
            status = future.status
            if status in ("pending", "lost"):  # the worker died before the outcome was fetched: retry
                future.add_done_callback(queue.put)
                continue
            if status == "cancelled":
                raise _lost()
            try:
                found = future.result()
            except KilledWorker:
                found = None
            except CancelledError:
                raise _lost() from None
            del waiting[future.key]
            yield keys[future.key], found


def _lost() -> SolverError:
    return SolverError("the connection to the scheduler was lost; finished cells are kept", where="scheduler",
                       remedy="check that it runs and repeat the same command")


def _short(error: BaseException) -> str:
    said = " ".join(str(error).split()).replace(";", ",")[:200]
    return said or ("no answer in time" if isinstance(error, TimeoutError) else type(error).__name__)
