"""Progress on a terminal: percentage and time left after two seconds, units in brackets stay, nothing elsewhere."""

from __future__ import annotations

import io
import re

import pytest
from rich.console import Console
from rich.progress import Task

from hydroopt.cli.progress_line import Left, progress_line
from hydroopt.cli.terminal import print_table


class Clock:
    """A time that is set by hand."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def task() -> tuple[Task, Clock]:
    clock = Clock()
    made = Task(id=0, description="", total=1.0, completed=0.0, _get_time=clock)  # type: ignore[arg-type]
    made.start_time = clock.now
    return made, clock


def test_percentage_and_time_left(task: tuple[Task, Clock]) -> None:
    each, clock = task
    shown = Left()
    for at, part, text in ((1.0, 0.5, ""), (3.0, 0.0, "3 s"), (10.0, 0.25, "25 %, 30 s left"),
                           (20.0, 0.25, "25 %, 20 s left"), (60.0, 0.25, "25 %"), (60.0, 0.5, "50 %, 60 s left")):
        clock.now, each.completed = 100.0 + at, part
        assert shown.render(each).plain == text


def test_a_terminal_shows_units_in_brackets() -> None:
    file = io.StringIO()
    with progress_line(Console(file=file, force_terminal=True, width=80)) as line:
        line.add_task("reading t [s] and boom.q [deg]", total=1.0)
        line.refresh()
    plain = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", file.getvalue())
    assert "reading t [s] and boom.q [deg]" in plain


def test_tables_keep_units_in_brackets(capsys: pytest.CaptureFixture[str]) -> None:
    print_table("Speeds", [{"time [s]": 1.5, "what": "boom.qd [rad/s]"}])
    shown = capsys.readouterr().out
    assert "time [s]" in shown
    assert "boom.qd [rad/s]" in shown


def test_nothing_is_shown_where_there_is_no_terminal() -> None:
    file = io.StringIO()
    with progress_line(Console(file=file, width=80)) as line:
        line.add_task("reading", total=1.0)
    assert file.getvalue() == ""
