"""A Monte Carlo study by one worker process and by two."""

import os
import resource
import tempfile
import time
from pathlib import Path

from hydroopt import load_machine
from hydroopt.study.montecarlo import montecarlo as study
from hydroopt.study.run import run
from studies.bench.goals import Row


def montecarlo(cells: int = 1000) -> list[Row]:
    """Identification of the CAT 215B, 1664 samples with intervals a cell; both runs must give the same bits."""
    work = study(load_machine("cat215b"), cells=cells)
    walls, tables, taken = {}, {}, {}
    print(f"{cells} cells, {len(os.sched_getaffinity(0))} cores, load before {os.getloadavg()[0]:.1f}")
    print(f"{'workers':>8} {'wall s':>8} {'s to the first cell':>20} {'s/cell after it':>16} {'load after':>11}")
    for workers in (1, 2):
        heard: list[float] = []
        with tempfile.TemporaryDirectory() as folder:
            began, before = time.perf_counter(), _cpu()
            run(work, folder, workers=workers, say=lambda *_, heard=heard: heard.append(time.perf_counter()))
            wall, taken[workers] = time.perf_counter() - began, (_cpu() - before) / cells
            tables[workers] = (Path(folder) / "results.csv").read_bytes()
        each = (heard[-1] - heard[1]) / (cells - 1)
        walls[workers] = wall, each
        print(f"{workers:8d} {wall:8.1f} {heard[1] - began:20.1f} {each:16.3f} {os.getloadavg()[0]:11.1f}")
    if tables[1] != tables[2]:
        raise SystemExit("the two runs differ")
    print(f"one worker : two workers {walls[1][0] / walls[2][0]:.2f}, without the beginning "
          f"{walls[1][1] / walls[2][1]:.2f}; target for 1000 cells: 1.7")
    return [Row("cell", taken[1], "of two workers", taken[2])]


def _cpu() -> float:
    """CPU time [s] of this process and of those that it started and that have ended."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(each.ru_utime + each.ru_stime for each in used)
