"""A terminal to press Ctrl-C in."""

from __future__ import annotations

import os
import pty
import re
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

PATIENCE = 60.0
"""Time [s] that nothing here takes."""


class Terminal:
    """A terminal in which the command runs, as the only thing in its session."""

    def __init__(self, *arguments: str) -> None:
        self._ours, theirs = pty.openpty()
        self._began, self.shown = time.monotonic(), ""
        self.command = subprocess.Popen(
            [sys.executable, "-m", "hydroopt", *arguments], stdin=theirs, stdout=theirs, stderr=theirs,
            start_new_session=True, env=os.environ | {"TERM": "xterm", "COLUMNS": "200", "OMP_NUM_THREADS": "1"})
        os.close(theirs)

    def until(self, happened: Callable[[], bool]) -> None:
        """Read what is shown until something happens."""
        while not happened():
            assert time.monotonic() - self._began < PATIENCE, f"nothing happens: {self.last}"
            if select.select([self._ours], [], [], 0.02)[0]:
                try:
                    self.shown += os.read(self._ours, 1 << 16).decode(errors="replace")
                except OSError:  # the other end is closed
                    time.sleep(0.02)

    @property
    def last(self) -> str:
        """The end of what is shown, without what acts on the terminal."""
        return re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", self.shown)[-600:]

    def press_ctrl_c(self) -> None:
        """As a terminal does: every process in the foreground gets the signal."""
        os.killpg(self.command.pid, signal.SIGINT)

    def ended(self) -> int:
        """The exit code."""
        self.until(lambda: self.command.poll() is not None)
        return self.command.returncode

    def workers(self) -> int:
        """How many processes the command has begun."""
        return sum(_works(process, self.command.pid) for process in Path("/proc").glob("[0-9]*"))

    def close(self) -> None:
        """End whatever still runs."""
        if self.command.poll() is None:
            os.killpg(self.command.pid, signal.SIGKILL)
            self.command.wait()
        os.close(self._ours)


def _works(process: Path, group: int) -> bool:
    try:
        return b"spawn_main" in (process / "cmdline").read_bytes() and os.getpgid(int(process.name)) == group
    except OSError:  # it has just ended
        return False
