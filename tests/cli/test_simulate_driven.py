"""`hydroopt simulate --driven` says by how much, and why, it made a random motion smaller."""

from __future__ import annotations

from pathlib import Path

from typer.testing import CliRunner

from hydroopt.cli import app


def test_a_smaller_amplitude_is_stated_with_its_reason(tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["simulate", "cat215b", "--driven", "--duration", "6", "--seed", "1", "-o",
                                    str(tmp_path)], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    *_, log, exact, why = done.stdout.strip().splitlines()
    assert "log.csv" in log
    assert exact.startswith("Without errors, since the machine file states no accuracy")
    assert why.startswith("amplitude 0.5 of the random motion's, since of a larger one ")
