"""Time and peak memory of `hydroopt identify` with logs that are read in pieces, and whether both keep their slope."""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa
from pyarrow import parquet

from hydroopt import Log, Model, load_machine, random_trajectory, random_truth, simulate

HYDROOPT = str(Path(sys.executable).with_name("hydroopt"))
SIZES = (10_000, 100_000, 1_000_000, 10_000_000)
"""Samples of the logs."""
PERIOD, RATE = 2000.0, 50.0
"""Of the motion [s], [Hz]."""


def pieces(samples: int, seed: int) -> Iterator[Log]:
    """A periodic motion of the CAT 215B period by period, each with noise of its own; commands and speeds beside it."""
    model = Model(load_machine("cat215b"))
    motion = random_trajectory(model, duration=PERIOD, rate=RATE, seed=seed)
    truth, length = random_truth(model, seed=seed), len(motion.t)
    for start in range(0, samples, length):
        log = simulate(model, motion, truth, seed=seed + 1 + start)
        rng = np.random.default_rng(start)
        more = {f"{joint}.qd": motion.qd[:, k] + 0.01 * rng.standard_normal(length)
                for k, joint in enumerate(model.machine.joints)}
        more["swing_valve.u"] = np.tanh(5 * motion.qd[:, 0])
        t = (start + np.arange(length)) / RATE
        yield Log(log.name, t, {**log.channels, **more}).slice(0, min(length, samples - start))


def write(path: Path, samples: int, seed: int = 1) -> None:
    """A Parquet file of so many samples in 16 columns, never more than a period of it in memory."""
    writer = None
    for log in pieces(samples, seed):
        table = pa.table({"t [s]": log.t, **{f"{name} [{log.units[name]}]": x for name, x in log.channels.items()}})
        writer = writer or parquet.ParquetWriter(path, table.schema)
        writer.write_table(table)
    if writer:
        writer.close()


def measured(command: list[str]) -> tuple[float, float, float]:
    """Wall time [s], processor time [s] and peak memory [MB] of a command, which has no processes of its own."""
    began = time.perf_counter()
    pid = os.posix_spawn(command[0], command, os.environ)
    _, status, usage = os.wait4(pid, 0)
    wall = time.perf_counter() - began
    if status:
        raise SystemExit(f"failed: {' '.join(command)}")
    return wall, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024


def streaming() -> None:
    """The command as a whole with logs in pieces, all of a log's 16 columns checked."""
    with tempfile.TemporaryDirectory() as folder:
        print(f"{'samples':>10} {'file MB':>8} {'wall s':>8} {'CPU s':>8} {'peak MB':>8} {'us/sample':>10} {'load':>6}")
        runs = []
        for samples in SIZES:
            log = Path(folder) / f"{samples}.parquet"
            # by a process of its own: what this one has ever held would count as the peak of those that it starts
            subprocess.run([sys.executable, "-m", "studies.bench.streaming", str(log), str(samples)], check=True)
            wall, cpu, peak = measured([HYDROOPT, "identify", "cat215b", str(log), "-o", f"{folder}/out", "--quiet"])
            runs.append((samples, wall, cpu, peak))
            print(f"{samples:10d} {log.stat().st_size / 1e6:8.0f} {wall:8.1f} {cpu:8.1f} {peak:8.0f} "
                  f"{1e6 * cpu / samples:10.2f} {os.getloadavg()[0]:6.2f}")
            log.unlink()
        (few, wall, cpu, _), (many, longer, more, peak) = runs[0], runs[-1]
        print(f"each further sample: {1e6 * (more - cpu) / (many - few):.2f} us of processor, "
              f"{1e6 * (longer - wall) / (many - few):.2f} us of wall time; a sample of {many} costs "
              f"{more / many / (cpu / few):.2f} times one of {few}")
        print("targets for 10,000,000 samples on an idle core: 18 s of CPU, 600 MB")
        fit = json.loads(Path(folder, "out", "estimate.json").read_text())["fit"]["train"]
        print("relative error of the fit:", *(f"{name} {one['relative']:.4f}" for name, one in fit.items()))


if __name__ == "__main__":
    write(Path(sys.argv[1]), int(sys.argv[2]))
