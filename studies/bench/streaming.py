"""Time and peak memory of `hydroopt identify` with logs that are read in pieces, and whether both keep their slope."""

import json
import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa
from pyarrow import parquet

from hydroopt import Log, Model, load_machine, random_trajectory, random_truth, simulate
from studies.bench.goals import Row
from studies.bench.process import HYDROOPT, measured

SIZES = (10_000, 100_000, 1_000_000, 10_000_000)
"""Samples of the logs."""
PERIOD, RATE = 2000.0, 50.0
"""Of the motion [s], [Hz]."""
READ = """
import sys
from pyarrow import parquet
for piece in parquet.ParquetFile(sys.argv[1]).iter_batches():
    [column.to_numpy(zero_copy_only=False) for column in piece.columns]
"""
"""Reads all columns of a Parquet file and drops them."""


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


def streaming() -> list[Row]:
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
            if samples == SIZES[-1]:
                reading = measured([sys.executable, "-c", READ, str(log)])
            log.unlink()
        (few, wall, cpu, _), (many, longer, more, peak) = runs[0], runs[-1]
        (fewer, _, less, _) = runs[-2]
        print(f"each further sample: {1e6 * (more - cpu) / (many - few):.2f} us of processor, "
              f"{1e6 * (longer - wall) / (many - few):.2f} us of wall time; a sample of {many} costs "
              f"{more / many / (cpu / few):.2f} times one of {few}")
        fit = json.loads(Path(folder, "out", "estimate.json").read_text())["fit"]["train"]
        print("relative error of the fit:", *(f"{name} {one['relative']:.4f}" for name, one in fit.items()))
    alone = "pyarrow reads it alone,"
    return [Row("long", more, alone, reading.cpu), Row("long memory", peak, alone, reading.peak),
            Row("long growth", math.log(more / less) / math.log(many / fewer))]


if __name__ == "__main__":
    write(Path(sys.argv[1]), int(sys.argv[2]))
