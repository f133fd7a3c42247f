"""Cells on the workers of a Dask scheduler.

No other module imports Dask, and this one is imported only if there are cells to compute.

Who can send work to the scheduler runs code on its workers, and they on it. With an address ``tls://host:8786`` all of
them, this client too, prove who they are by the certificates that Dask's configuration states (distributed.comm.tls).
"""

from __future__ import annotations

import asyncio
import logging
import threading
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import CancelledError, Future
from contextlib import contextmanager

import dask
from distributed import Client, KilledWorker, Security, rpc

from hydroopt.errors import ProblemError, SolverError
from hydroopt.study.processes import Crew
from hydroopt.study.study import Outcome, Study, Values, outcome
from hydroopt.support.packages import versions
from hydroopt.support.progress import Progress

PATIENCE, JOINING = 5.0, 60.0
"""Time limits [s] for a scheduler to answer and for a worker to join."""
CONFIG = {"distributed.comm.timeouts.connect": f"{PATIENCE:g}s", "distributed.scheduler.worker-saturation": 1.0,
          "distributed.scheduler.allowed-failures": 1}
"""Workers do not queue cells, so that only the running cell is suspected when a worker dies; suspects are retried."""
_turn = threading.Lock()
"""One cell at a time in a worker: CasADi's symbols and the limit of threads are shared by all of its threads."""


def _cell(function: Callable[..., Values], values: Values, expected: Mapping[str, str]) -> Outcome:
    if versions() != expected:
        raise RuntimeError(f"the worker has {versions()} instead of {expected}")
    with _turn:
        return outcome(function, values)


def _itself(function: Callable[..., Values]) -> Callable[..., Values]:
    return function


@contextmanager
def computing(study: Study, scheduler: str, say: Progress) -> Iterator[Crew]:
    """The workers of a scheduler.

    Raises:
        ProblemError: there is no scheduler at the address, or its workers cannot be used.
        SolverError: the scheduler was lost.
    """
    where = f"--scheduler {scheduler}"

    def result(done: Future[Outcome]) -> Outcome | None:
        try:
            return done.result()
        except KilledWorker:
            return None
        except CancelledError:
            raise SolverError("the connection to the scheduler was lost; finished cells are kept", where="scheduler",
                              remedy="check that it runs and repeat the same command") from None
        except Exception as error:
            raise ProblemError(f"a worker cannot run the study ({_short(error)})", where=where,
                               remedy="install the same hydroopt and the same packages for the workers") from error

    with _client(scheduler, where) as client:
        try:
            if not client.scheduler_info()["workers"]:
                say("waiting for workers")
            client.wait_for_workers(1, timeout=JOINING)
        except TimeoutError:
            raise ProblemError(f"no worker has joined within {JOINING:.0f} s", where=where,
                               remedy="start some with 'dask worker'") from None
        # what a task returns is sent to each worker once, and computed again if its worker dies
        function, executor = client.submit(_itself, study.function, pure=False), client.get_executor(pure=False)
        yield Crew(lambda values: executor.submit(_cell, function, values, versions()), result, len(study.cells))


@contextmanager
def _client(scheduler: str, where: str) -> Iterator[Client]:
    before = logging.root.manager.disable
    logging.disable()  # the study itself reports lost processes and connections
    try:
        with dask.config.set(CONFIG):
            security = _security(scheduler, where)
            try:
                asyncio.run(asyncio.wait_for(_answer(scheduler, security), PATIENCE))
                client = Client(scheduler, timeout=PATIENCE, set_as_default=False, security=security)
            except (OSError, ValueError) as error:
                raise ProblemError(f"no Dask scheduler answers at this address ({_short(error)})", where=where,
                                   remedy="start one with 'dask scheduler' and give the address that it prints, such "
                                   "as tcp://host:8786 or tls://host:8786") from None
            with client:
                yield client
    finally:
        logging.disable(before)


def _security(scheduler: str, where: str) -> Security:
    """The certificates that Dask's configuration states, which an address tls://... needs."""
    security = Security()
    try:
        if scheduler.startswith("tls://") and security.get_connection_args("client").get("ssl_context") is None:
            raise ValueError("it states none")
    except (OSError, ValueError) as error:
        raise ProblemError(f"the certificates in Dask's configuration cannot be used ({_short(error)})", where=where,
                           remedy="set DASK_DISTRIBUTED__COMM__TLS__CA_FILE, DASK_DISTRIBUTED__COMM__TLS__CLIENT__CERT "
                           "and DASK_DISTRIBUTED__COMM__TLS__CLIENT__KEY") from None
    return security


async def _answer(address: str, security: Security) -> None:
    """Check that a scheduler listens: a client would wait forever for another kind of server."""
    async with rpc(address, connection_args=security.get_connection_args("client")) as remote:
        kind = (await remote.identity())["type"]
    if kind != "Scheduler":
        raise ValueError(f"this is a {kind.lower()}")


def _short(error: BaseException) -> str:
    said = " ".join(str(error).split()).replace(";", ",")[:200]
    return said or ("no answer in time" if isinstance(error, TimeoutError) else type(error).__name__)
