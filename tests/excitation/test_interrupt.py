"""Ctrl-C ends a search that would go on for long, and the best motion so far is written."""

from __future__ import annotations

import json
import os
import re
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

if sys.platform == "win32":
    pytest.skip("no terminal to press Ctrl-C in", allow_module_level=True)

import pty

LONG = ("--duration", "8", "--harmonics", "2", "--seconds", "600", "--starts", "2000")
PATIENCE = 60.0
"""Time [s] that nothing here takes."""


class Terminal:
    """A terminal in which the command runs, as the only thing in its session."""

    def __init__(self, output: Path, machine: str, processes: str) -> None:
        self._ours, theirs = pty.openpty()
        self._began, self.shown = time.monotonic(), ""
        self.command = subprocess.Popen(
            [sys.executable, "-m", "hydroopt", "excite", machine, *LONG, "--processes", processes, "-o",
             str(output)], stdin=theirs,
            stdout=theirs, stderr=theirs, start_new_session=True,
            env=os.environ | {"TERM": "xterm", "COLUMNS": "200", "OMP_NUM_THREADS": "1"})
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
        """How many processes the command has begun to search in."""
        return sum(_searches(process, self.command.pid) for process in Path("/proc").glob("[0-9]*"))

    def close(self) -> None:
        """End whatever still runs."""
        if self.command.poll() is None:
            os.killpg(self.command.pid, signal.SIGKILL)
            self.command.wait()
        os.close(self._ours)


def _searches(process: Path, group: int) -> bool:
    try:
        return b"spawn_main" in (process / "cmdline").read_bytes() and os.getpgid(int(process.name)) == group
    except OSError:  # it has just ended
        return False


@pytest.fixture
def terminal(tmp_path: Path) -> Iterator[Callable[[str, str], Terminal]]:
    opened: list[Terminal] = []

    def run(machine: str, processes: str) -> Terminal:
        opened.append(Terminal(tmp_path / "out", machine, processes))
        return opened[-1]

    yield run
    for each in opened:
        each.close()


def kept(output: Path, machine: str) -> None:
    """All files are there, of a motion that keeps its limits."""
    content = json.loads((output / "excitation.json").read_text("utf-8"))
    assert content["stopped"]
    assert all(limit["room"] >= 0 for limit in content["limits"])
    assert {file.name for file in output.iterdir()} == {"excitation.json", "report.html", "trajectory.csv", "c"}
    assert (output / f"c/{machine}.c").exists()


@pytest.mark.parametrize("processes", ["1", "2"])
def test_ctrl_c_keeps_the_best_motion_so_far(processes: str, terminal: Callable[[str, str], Terminal],
                                             tmp_path: Path) -> None:
    running = terminal("patu655_lift", processes)
    running.until(lambda: "best" in running.shown)
    running.press_ctrl_c()
    assert running.ended() == 0, running.last
    assert "Traceback" not in running.shown
    assert "The search was interrupted" in running.shown
    kept(tmp_path / "out", "patu655_lift")


def test_ctrl_c_while_processes_begin_ends_the_search_too(terminal: Callable[[str, str], Terminal],
                                                              tmp_path: Path) -> None:
    """There may be no motion yet that could be kept; but it ends, and says so."""
    if not Path("/proc/self/cmdline").exists():
        pytest.skip("cannot see processes begin here")
    running = terminal("cat215b", "2")
    running.until(lambda: running.workers() > 0)
    running.press_ctrl_c()
    code = running.ended()
    assert "Traceback" not in running.shown
    assert code in (0, 130), running.last
    if code == 0:
        kept(tmp_path / "out", "cat215b")
    else:
        assert "interrupted" in running.last
        assert not (tmp_path / "out").exists()
