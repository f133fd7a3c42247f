"""Ctrl-C ends a search that would go on for long, and the best motion so far is written."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

if sys.platform == "win32":
    pytest.skip("no terminal to press Ctrl-C in", allow_module_level=True)

from fixtures.terminal import Terminal

LONG = ("--duration", "8", "--harmonics", "2", "--search-seconds", "600", "--starts", "2000")


@pytest.fixture
def terminal(tmp_path: Path) -> Iterator[Callable[[str, str], Terminal]]:
    opened: list[Terminal] = []

    def run(machine: str, processes: str) -> Terminal:
        opened.append(Terminal("excite", machine, *LONG, "--processes", processes, "-o", str(tmp_path / "out")))
        return opened[-1]

    yield run
    for each in opened:
        each.close()


def kept(output: Path, machine: str) -> None:
    """All files are there, of a motion that keeps its limits."""
    content = json.loads((output / "excitation.json").read_text("utf-8"))
    assert content["stopped"]
    assert all(limit["room"] >= 0 for limit in content["limits"])
    assert {file.name for file in output.iterdir()} == {
        "excitation.json", "report.html", "sheet.html", "trajectory.csv", "c"}
    assert (output / f"c/{machine}.c").exists()


@pytest.mark.slow
@pytest.mark.parametrize("processes", ["1", "2"])
def test_ctrl_c_keeps_the_best_motion_so_far(processes: str, terminal: Callable[[str, str], Terminal],
                                             tmp_path: Path) -> None:
    running = terminal("patu655_lift", processes)
    running.until(lambda: "best" in running.shown)
    running.press_ctrl_c()
    assert running.ended() == 0, running.last
    assert "Traceback" not in running.shown
    assert "a search cut short by Ctrl-C" in running.shown
    kept(tmp_path / "out", "patu655_lift")


@pytest.mark.slow
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
