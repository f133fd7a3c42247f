"""Limits of this process's memory: those that are set, those that a process takes upon itself, and their excess."""

from __future__ import annotations

import errno
import os

try:
    import resource
except ImportError:  # there is none on Windows
    resource = None  # type: ignore[assignment]

LEAST = 10**9
"""Memory [bytes] below which numerical libraries end the process, or wait forever."""


def limit() -> float:
    """Memory [bytes] that this process may use, as `ulimit -v` sets it; without limit, infinity."""
    soft = resource.getrlimit(resource.RLIMIT_AS)[0] if resource else -1
    return float("inf") if soft < 0 else soft


def available() -> float:
    """Memory [bytes] of this computer, or what this process may use of it; infinite if neither is known."""
    try:
        return min(limit(), float(os.sysconf("SC_PAGE_SIZE")) * os.sysconf("SC_PHYS_PAGES"))
    except (AttributeError, ValueError, OSError):  # Windows
        return limit()


def restrict(memory: int, seconds: int) -> None:
    """Lower this process's limits to some memory [bytes] and processor time [s], and keep it from dumping its memory.

    A limit that is lower already stays, since no process may raise it.
    """
    if resource:
        for kind, wanted in ((resource.RLIMIT_AS, memory), (resource.RLIMIT_CPU, seconds), (resource.RLIMIT_CORE, 0)):
            hard = resource.getrlimit(kind)[1]
            most = wanted if hard < 0 else min(wanted, hard)
            resource.setrlimit(kind, (most, most))


def few_threads() -> None:
    """Under a limit, let linear algebra use one thread, since each thread reserves memory beforehand."""
    if limit() < float("inf"):
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def exceeded(error: BaseException) -> bool:
    """Whether an error, or what it came from, is that there is no more memory.

    >>> exceeded(MemoryError()), exceeded(OSError(errno.ENOMEM, "")), exceeded(OSError(errno.ENOENT, ""))
    (True, True, False)
    """
    if isinstance(error, MemoryError) or (isinstance(error, OSError) and error.errno == errno.ENOMEM):
        return True
    # the loader of libraries and the start of a thread have no errors of their own
    if limit() < float("inf") and isinstance(error, ImportError | RuntimeError | OSError) and any(
            part in str(error) for part in ("failed to map", "cannot allocate", "Cannot allocate", "start new thread")):
        return True
    return error.__cause__ is not None and exceeded(error.__cause__)
