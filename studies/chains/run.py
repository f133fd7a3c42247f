"""Every job on every bundled machine through the command line, in an empty directory, unattended.

What a machine's jobs gave is kept with a digest of the code and the machine, and not run again as long as both stay: an
interrupted run goes on with the machines that are left.
"""

import hashlib
import json
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict
from functools import cache
from pathlib import Path

from hydroopt.machine.machine_file import bundled, dump_machine, load_machine
from studies.chains.jobs import ROOT, Outcome, chain, outcomes
from studies.show import OUT, table

QUICK = ("patu655_lift", "scissor_lift", "ur10")
"""Machines of the quick variant: one with valves, one with loops, one with electric drives."""


def run(*machines: str) -> dict:
    """All bundled machines, or those named."""
    return chains(machines or bundled())


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
    """The outcomes of a machine's chain: kept ones of the same code, else run and kept at once."""
    kept = OUT / "chains" / f"{machine}-{seed}.json"
    before = json.loads(kept.read_text("utf-8")) if kept.is_file() else {}
    if before.get("digest") == (digest := _digest(machine)):
        ended = [Outcome(**each) for each in before["jobs"]]
    else:
        with tempfile.TemporaryDirectory() as folder:
            ended = outcomes(chain(machine, seed), Path(folder))
        kept.parent.mkdir(parents=True, exist_ok=True)
        kept.write_text(json.dumps({"digest": digest, "jobs": [asdict(each) for each in ended]}, indent=1), "utf-8")
    table(machine, ("job", "exit code", "verdict", "CPU seconds", "why"),
          [(each.job, each.exit_code, each.word, each.seconds, each.sentence) for each in ended])
    sys.stdout.flush()
    return ended


def _digest(machine: str) -> str:
    """Of all that decides what the jobs give: the machine, and the code."""
    return hashlib.sha256(_code() + dump_machine(load_machine(machine)).encode()).hexdigest()


@cache
def _code() -> bytes:
    files = (path for folder in ("hydroopt", "studies/chains") for path in sorted((ROOT / folder).rglob("*")))
    return b"".join(path.read_bytes() for path in files
                    if path.is_file() and path.suffix not in (".pyc", ".md", ".json"))
