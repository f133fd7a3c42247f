"""Commands that are killed at random moments: a few of the kills that `make kills` counts."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.slow
def test_killed_commands_leave_the_old_result_the_new_one_or_none(tmp_path: Path) -> None:
    done = subprocess.run([sys.executable, "-m", "studies.kills", "24", "-o", str(tmp_path / "kills.json")], cwd=ROOT,
                          capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert json.loads((tmp_path / "kills.json").read_text())["total"]["kills"] == 24
