"""Time and peak memory of `hydroopt identify`, and how they grow."""

import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

HYDROOPT = str(Path(sys.executable).with_name("hydroopt"))
SIZES = {1664: 3, 10_000: 1, 100_000: 1}
"""Samples of the log, and how many runs are taken."""


def measured(command: list[str]) -> tuple[float, float]:
    """Wall time [s] and peak memory [MB] of one run of a command, its import of everything included."""
    began = time.perf_counter()
    pid = os.posix_spawn(command[0], command, os.environ)
    _, status, usage = os.wait4(pid, 0)
    wall = time.perf_counter() - began
    if status:
        raise SystemExit(f"failed: {' '.join(command)}")
    return wall, usage.ru_maxrss / 1024


def identify() -> None:
    """The command as a whole, in processes of its own."""
    with tempfile.TemporaryDirectory() as folder:
        base = None
        print(f"{'samples':>8} {'wall s':>8} {'peak MB':>8} {'s beyond the shortest':>22} {'per 1000 samples':>17}")
        for samples, runs in SIZES.items():
            log = f"{folder}/{samples}"
            subprocess.run([HYDROOPT, "simulate", "cat215b", "-o", log, "--duration", str(samples / 50), "--parquet",
                            "--truth", "random", "--seed", "1", "--quiet"], check=True)
            command = [HYDROOPT, "identify", "cat215b", f"{log}/log.parquet", "-o", f"{log}/out", "--quiet"]
            walls, peaks = zip(*[measured(command) for _ in range(runs)], strict=True)
            wall = statistics.median(walls)
            base = base or (samples, wall)
            more, longer = samples - base[0], wall - base[1]
            beyond = f"{longer:22.2f} {1000 * longer / more:17.4f}" if more > 0 else ""
            print(f"{samples:8d} {wall:8.2f} {max(peaks):8.0f} {beyond}")
    print(f"target for 1664 samples: 4 s, 600 MB; this process itself: "
          f"{resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB")
