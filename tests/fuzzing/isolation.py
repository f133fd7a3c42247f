"""Work done in forked children of this process, so that crashes, hangs and want of memory are counted, not shared."""

from __future__ import annotations

import faulthandler
import os
import pickle
import resource
import select
import signal
import struct
import time
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

HANG = 60.0
"""Seconds of wall time after which a piece of work counts as hanging."""
MEMORY = 2 * 1000**3
"""Memory [bytes] that no piece of work may exceed."""


@dataclass(frozen=True)
class Done:
    """What became of one piece: its result, or how its process ended; seconds, and the process's memory [bytes]."""

    index: int
    result: Any
    fault: str
    seconds: float
    memory: int


def each(work: Callable[[int], Any], indices: list[int]) -> Iterator[Done]:
    """Do pieces one after the other in one child; after a crash or hang, go on in another with the next."""
    waiting = list(indices)
    while waiting:
        before = len(waiting)
        for done in _child(work, list(waiting)):
            waiting.pop(0)
            yield done
        assert len(waiting) < before


def _child(work: Callable[[int], Any], indices: list[int]) -> Iterator[Done]:
    read, write = os.pipe()
    pid = os.fork()
    if not pid:
        os.close(read)
        try:
            _work(work, indices, write)
        finally:
            os._exit(0)
    os.close(write)
    buffer, began, count = b"", time.monotonic(), 0
    try:
        while True:
            left = HANG - (time.monotonic() - began)
            if not select.select([read], [], [], max(left, 0.0))[0]:
                os.kill(pid, signal.SIGKILL)
                yield Done(indices[count], None, f"hangs (over {HANG:.0f} s)", HANG, 0)
                return
            chunk = os.read(read, 1 << 16)
            buffer += chunk
            while len(buffer) >= 4 and len(buffer) >= 4 + (size := struct.unpack("<I", buffer[:4])[0]):
                content, buffer = pickle.loads(buffer[4:4 + size]), buffer[4 + size:]
                yield Done(indices[count], *content)
                began, count = time.monotonic(), count + 1
            if not chunk:
                break
    finally:
        os.close(read)
        _, status = os.waitpid(pid, 0)
    if count < len(indices):
        name = signal.Signals(os.WTERMSIG(status)).name if os.WIFSIGNALED(status) else f"exit {status >> 8}"
        yield Done(indices[count], None, f"crash ({name})", time.monotonic() - began, 0)


def _work(work: Callable[[int], Any], indices: list[int], write: int) -> None:
    faulthandler.disable()  # a crash is counted, not printed
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_AS, (4 * MEMORY, 4 * MEMORY))
    for index in indices:
        began, result, fault = time.monotonic(), None, ""
        try:
            result = work(index)
        except BaseException as error:
            frames = [frame for frame in traceback.extract_tb(error.__traceback__) if "hydroopt/" in frame.filename]
            at = f" at {frames[-1].filename.rpartition('hydroopt/')[2]}:{frames[-1].lineno}" if frames else ""
            fault = f"{type(error).__name__}: {str(error)[:160]}{at}"
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
        if memory > MEMORY:
            fault = fault or f"takes {memory / 1e9:.1f} GB"
        content = pickle.dumps((result, fault, time.monotonic() - began, memory))
        os.write(write, struct.pack("<I", len(content)) + content)
        if memory > MEMORY:
            return
