"""The line that shows on a terminal how far a job is."""

from __future__ import annotations

from rich.console import Console
from rich.progress import Progress, ProgressColumn, SpinnerColumn, Task, TextColumn
from rich.text import Text

SHORT = 2.0
"""Seconds up to which a job shows neither percentage nor time."""
LONG = 5400
"""Seconds from which on time is stated in hours."""


class Left(ProgressColumn):
    """Percentage and time left once a part of the job is done, until then the time it has taken."""

    def __init__(self) -> None:
        super().__init__()
        self._said: tuple[float, float] = (0.0, 0.0)

    def render(self, task: Task) -> Text:
        """The text of this moment."""
        elapsed = task.elapsed or 0.0
        if elapsed < SHORT:
            return Text("")
        if not 0 < task.completed < 1:
            return Text(spoken(elapsed))
        if task.completed != self._said[0]:
            self._said = (task.completed, elapsed)
        part, at = self._said
        left = max(at * (1 - part) / part - (elapsed - at), 0.0)
        return Text(f"{100 * part:.0f} %, {spoken(left)} left" if left >= 1 else f"{100 * part:.0f} %")


def spoken(seconds: float) -> str:
    """A duration in words.

    >>> spoken(8.4), spoken(200), spoken(7200)
    ('8 s', '3 min 20 s', '2.0 h')
    """
    whole = round(seconds)
    if whole >= LONG:
        return f"{whole / 3600:.1f} h"
    return f"{whole} s" if whole < 120 else f"{whole // 60} min {whole % 60} s"


def progress_line(console: Console) -> Progress:
    """A line on a terminal that goes when the job ends; nothing elsewhere. Brackets in its text stay as they are."""
    return Progress(SpinnerColumn(), TextColumn("{task.description}", markup=False), Left(), console=console,
                    transient=True, disable=not console.is_terminal)
