"""A command as a process of its own: its time and memory."""

import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

HYDROOPT = str(Path(sys.executable).with_name("hydroopt"))
LIBRARIES = ("numpy", "casadi", "clarabel", "pydantic", "jinja2", "typer", "pyarrow.parquet")
"""What an identification cannot do without."""


class Cost(NamedTuple):
    """Wall time [s], CPU time [s] and peak memory [MB] of a process and those that it waited for."""

    wall: float
    cpu: float
    peak: float


def measured(command: Sequence[str], **variables: str) -> Cost:
    """One run of a command, its start and its import of everything included; what it prints is dropped.

    Python may keep bytecode, as an installed package does: without its own, `identify` compiles 266 modules each time,
    which takes a third of it. Environment variables beside the present ones may be given.
    """
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"} | variables
    silence = [(os.POSIX_SPAWN_OPEN, 1, os.devnull, os.O_WRONLY, 0)]
    began = time.perf_counter()
    pid = os.posix_spawn(command[0], command, environment, file_actions=silence)
    _, status, usage = os.wait4(pid, 0)
    wall = time.perf_counter() - began
    if status:
        raise SystemExit(f"failed: {' '.join(command)}")
    return Cost(wall, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024)


def libraries() -> float:
    """CPU time [s] of a process that loads `LIBRARIES` and nothing else, the least of three."""
    return min(measured([sys.executable, "-c", "import " + ", ".join(LIBRARIES)]).cpu for _ in range(3))
