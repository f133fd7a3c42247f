"""The jobs of a chain as commands in one directory, each with the files that it needs from those before it."""

import json
import os
import resource
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
LIMIT = 3600
"""Seconds after which a job counts as one that does not end."""
POSES = 20
"""Poses of each stage of the calibration."""


@dataclass(frozen=True)
class Job:
    """A command line, the files without which it cannot begin, and the answer that states its verdict, if any."""

    name: str
    command: tuple[str, ...]
    needs: tuple[str, ...] = ()
    answer: str = ""


@dataclass(frozen=True)
class Outcome:
    """How a job ended: exit code, status of its answer, CPU seconds [s], the first line of its error or cause."""

    job: str
    exit_code: int
    status: str
    seconds: float
    sentence: str
    traceback: bool = False

    @property
    def word(self) -> str:
        """What the table says: the answer's status, or how the job ended without one."""
        if self.traceback:
            return "traceback"
        return {0: self.status or "ok", 2: "refused"}.get(self.exit_code, self.status or f"exit {self.exit_code}")


def chain(machine: str, seed: int) -> tuple[Job, ...]:
    """All jobs of a machine: a motion is designed, driven and identified; code, control; poses, geometry.

    Two logs are simulated with one truth, drawn from the file's confidences, and with noise of their own.
    """
    motion, log, again, poses = "drive/trajectory.csv", "first/log.csv", "second/log.csv", "measured/poses.csv"
    drawn = ("--truth", "random", "--truth-seed", str(seed))

    def cli(*words: str) -> tuple[str, ...]:
        return (sys.executable, "-m", "hydroopt", *words)

    def simulated(output: str, noise: int) -> tuple[str, ...]:
        return cli("simulate", machine, "--motion", motion, *drawn, "--seed", str(noise), "-o", output, "--quiet")

    return (
        Job("show", cli("show", machine, "-o", "machine")),
        Job("excite", cli("excite", machine, "--starts", "2", "--processes", "1", "--seed", str(seed), "-o", "drive",
                          "--quiet"), (), "drive/excitation.json"),
        Job("check motion", cli("check", machine, motion, "-o", "limits", "--quiet"), (motion,), "limits/check.json"),
        Job("simulate", simulated("first", 2 * seed), (motion,)),
        Job("simulate again", simulated("second", 2 * seed + 1), (motion,)),
        Job("check", cli("check", machine, log, "-o", "checked", "--quiet"), (log,), "checked/check.json"),
        Job("identify", cli("identify", machine, log, "-o", "estimate", "--quiet"), (log,), "estimate/estimate.json"),
        Job("compare", cli("compare", machine, log, again, "-o", "change", "--quiet"), (log, again),
            "change/comparison.json"),
        Job("codegen", cli("codegen", "estimate", "-o", "c", "--quiet"), ("estimate/estimate.json",)),
        Job("make check", ("make", "-C", "c", "check"), ("c/Makefile",)),
        Job("control", cli("control", "estimate", "--motion", motion, "--truth", "first/truth.json", "-o", "control",
                           "--quiet"), ("estimate/estimate.json", motion), "control/control.json"),
        Job("plan-poses", cli("plan-poses", machine, "-n", str(POSES), "-o", "plan", "--quiet")),
        Job("simulate poses", cli("simulate", machine, "--postures", "plan/postures.csv", *drawn, "-o", "measured",
                                  "--quiet"), ("plan/postures.csv",)),
        Job("calibrate", cli("calibrate", machine, poses, "-o", "geometry", "--quiet"), (poses,),
            "geometry/estimate.json"),
        Job("show calibrated", cli("show", "geometry", "-o", "calibrated"), ("geometry/estimate.json",)),
    )


def outcomes(jobs: Sequence[Job], folder: Path) -> list[Outcome]:
    """Run what can be run of some jobs in a directory, in their order."""
    return [_outcome(job, folder) for job in jobs if all((folder / need).is_file() for need in job.needs)]


def _outcome(job: Job, folder: Path) -> Outcome:
    environment = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    try:
        done = subprocess.run(job.command, cwd=folder, env=environment, stdin=subprocess.DEVNULL, capture_output=True,
                              text=True, timeout=LIMIT, check=False)
        code, said = done.returncode, done.stderr
    except subprocess.TimeoutExpired:
        code, said = 124, f"did not end within {LIMIT} s"
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    status, cause = "", said.strip().partition("\n")[0] if code else ""
    if job.answer and (folder / job.answer).is_file():
        answer = json.loads((folder / job.answer).read_text("utf-8"))
        status = answer["status"]
        cause = answer["verdict"]["cause"] or cause
    return Outcome(job.name, code, status,
                   round(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, 2), cause,
                   "Traceback (most recent call last)" in said)
