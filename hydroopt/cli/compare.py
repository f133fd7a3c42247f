"""`hydroopt compare`: which parameters changed between two sessions, or over several in time order."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hydroopt.cli.run import ANSWER, LOGS, SMOOTHING, Run, command
from hydroopt.errors import ProblemError


@command(*ANSWER, *LOGS, *SMOOTHING, "seed")
def compare(
    run: Run,
    sessions: Annotated[list[Path], typer.Argument(metavar="LOG|DIR...", help=(
        "Sessions in time order: a log each, or the directory that identify wrote from the logs of a session."))],
    parts: Annotated[str | None, typer.Option(help=(
        "What may have changed: friction, offset, parts and parameters, separated by commas; by default friction and "
        "offsets."))] = None,
    level: Annotated[float, typer.Option(help="Probability of a false alarm.")] = 0.05,
) -> None:
    """Test which parameters changed over sessions, and at which: DIR gets comparison.json, report.html and tables.

    Example: hydroopt compare cat215b monday.csv friday.csv -o out/change
    """
    from hydroopt.estimation.dynamic import session_comparison
    from hydroopt.results.json_file import Job

    if len(sessions) < 2:
        raise ProblemError("one session has nothing to be compared with", where="compare",
                           remedy="give two or more logs or directories in time order")
    smoothing = run.smoothing
    names = None if parts is None else [part.strip() for part in parts.split(",")]
    with run.progress(f"comparing {len(sessions)} sessions of {run.machine.name}") as say:
        read = [run.session([path], "compare") for path in sessions]
        with run.failure_saved(Job.CHANGE, session_comparison.METHOD):
            answer = session_comparison.compare(run.machine, read, parts=names, level=level, smoothing=smoothing,
                                                seed=run.seed, progress=say)
        answer = run.saved(answer, say)
    beside = [finding.text for finding in answer.findings[1:]] or [f"By a {answer.method}, false alarms at {level:g}."]
    run.show(answer, "\n".join(beside))
