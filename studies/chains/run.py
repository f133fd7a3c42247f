"""Every job on every bundled machine through the command line, in an empty directory, unattended."""

import json
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from hydroopt.machine.machine_file import bundled
from studies.chains.jobs import Outcome, chain, outcomes
from studies.show import OUT, table

QUICK = ("patu655_lift", "scissor_lift", "ur10")
"""Machines of the quick variant: one with valves, one with loops, one with electric drives."""


def run() -> dict:
    return chains(bundled())


def quick() -> dict:
    """A few machines, in a minute."""
    return chains(QUICK)


def chains(machines: Sequence[str], seed: int = 1) -> dict:
    """What a machine's jobs gave but success, by machine; totals; and CPU seconds of the longest job."""
    found = {machine: _ended(machine, seed) for machine in machines}
    every = [each for ended in found.values() for each in ended]
    longest = max(every, key=lambda each: each.seconds)
    return {machine: summary(ended) for machine, ended in found.items()} | {
        "machines": len(found), "jobs": len(every), "tracebacks": sum(each.traceback for each in every),
        "seconds": round(sum(each.seconds for each in every)),
        "longest_job_seconds": longest.seconds, "longest_job": longest.job}


def summary(ended: Sequence[Outcome]) -> str:
    """``ok``, or the jobs that ended otherwise."""
    return ", ".join(f"{each.job} {each.word}" for each in ended if each.word != "ok") or "ok"


def _ended(machine: str, seed: int) -> list[Outcome]:
    """The outcomes of a machine's chain; written at once, so that an interrupted run leaves what it found."""
    with tempfile.TemporaryDirectory() as folder:
        ended = outcomes(chain(machine, seed), Path(folder))
    table(machine, ("job", "exit code", "verdict", "CPU seconds", "why"),
          [(each.job, each.exit_code, each.word, each.seconds, each.sentence) for each in ended])
    kept = OUT / "chains"
    kept.mkdir(parents=True, exist_ok=True)
    (kept / f"{machine}-{seed}.json").write_text(json.dumps([asdict(each) for each in ended], indent=1), "utf-8")
    sys.stdout.flush()
    return ended
