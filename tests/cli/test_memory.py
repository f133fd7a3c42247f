"""Commands with little memory, whatever takes it, answer or end in one sentence."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from studies.first_contact.memory import limited, written

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="limits of Linux")


@pytest.mark.parametrize("kind", ["csv", "mat", "xlsx"])
def test_four_gigabytes_are_enough_for_every_format(kind: str, tmp_path: Path) -> None:
    assert limited(4, ["map", written(kind, tmp_path / "log")[0], "patu655_lift"]) == "answer"


@pytest.mark.parametrize(("gb", "ends"), [(0.9, {"sentence"}), (1, {"sentence", "answer"})])
def test_a_limit_that_is_too_small_ends_in_a_sentence(gb: float, ends: set[str], tmp_path: Path) -> None:
    assert limited(gb, ["check", "patu655_lift", *written("parquet", tmp_path / "log")]) in ends


@pytest.mark.parametrize("error", ["MemoryError()", "OSError(12, 'Cannot allocate memory')"])
def test_want_of_memory_anywhere_in_a_command_is_a_sentence(error: str) -> None:
    program = ("import sys; from hydroopt import cli; sys.argv[1:] = ['models']\n"
               f"def app(*_, **__): raise {error}\n"
               "cli.app = app; cli.main()")
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (2, "hydroopt: memory: this takes more than there is memory; raise the "
                                                 "limit (ulimit -v), or give shorter logs.\n")
