"""A short run of the fuzz suite; `make fuzz` runs it in full."""

from __future__ import annotations

import sys

import pytest

from fuzzing import commands, kinds
from fuzzing.isolation import each

COUNTS = {"machine file": 40, "MATLAB content": 40, "MATLAB file": 2, "estimate folder": 25, "truth": 25}
"""How many inputs of a kind; 60 of all others."""


@pytest.mark.skipif(sys.platform == "win32", reason="forks")
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
@pytest.mark.parametrize("kind", kinds.KINDS)
def test_spoilt_inputs_end_in_a_value_or_a_sentence(kind: str) -> None:
    kinds.prepare()
    done = list(each(lambda seed: kinds.parse(kind, seed), list(range(COUNTS.get(kind, 60)))))
    contained = [one for one in done if one.fault.startswith("crash") and kind == kinds.CONTAINED]
    assert not [one for one in done if one.fault and one not in contained]
    assert len(done) == COUNTS.get(kind, 60)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(30))
def test_spoilt_commands_end_in_an_answer_or_a_sentence(seed: int) -> None:
    assert [one.fault for one in each(commands.run, [seed])] == [""]


def test_what_is_no_sentence_is_found() -> None:
    with pytest.raises(AssertionError):
        kinds.judged("log.csv: " + "x" * 300)
    with pytest.raises(AssertionError):
        kinds.judged("log.csv: \x1b[2J; correct it.")
    assert [one.fault[:5] for one in each(lambda seed: [][seed], [0])] == ["Index"]


def test_a_crash_and_what_follows_are_told_apart() -> None:
    def work(index: int) -> int:
        if index == 1:
            import os
            import signal
            os.kill(os.getpid(), signal.SIGSEGV)
        return index

    assert [(one.result, one.fault) for one in each(work, [0, 1, 2])] == [(0, ""), (None, "crash (SIGSEGV)"), (2, "")]
