"""Time and peak memory of `hydroopt identify` and `codegen`, and how they grow."""

import statistics
import subprocess
import tempfile
import time
from collections.abc import Callable

from hydroopt import IdentificationProblem, identification_problem, load_machine, read_log, solve
from studies.bench.goals import Row
from studies.bench.process import HYDROOPT, libraries, measured

SIZES = {1664: 3, 10_000: 1, 100_000: 1}
"""Samples of the log, and how many runs are taken."""
ITS_LIBRARIES = "its libraries load in"


def identify() -> list[Row]:
    """The command as a whole, in processes of its own; in a warm process beside cvxpy on the same program."""
    with tempfile.TemporaryDirectory() as folder:
        base = None
        print(f"{'samples':>8} {'wall s':>8} {'peak MB':>8} {'s beyond the shortest':>22} {'per 1000 samples':>17}")
        for samples, runs in SIZES.items():
            log = f"{folder}/{samples}"
            subprocess.run([HYDROOPT, "simulate", "cat215b", "-o", log, "--duration", str(samples / 50), "--parquet",
                            "--truth", "random", "--seed", "1", "--quiet"], check=True)
            command = [HYDROOPT, "identify", "cat215b", f"{log}/log.parquet", "-o", f"{log}/out", "--quiet"]
            walls, cpus, peaks = zip(*[measured(command) for _ in range(runs)], strict=True)
            wall = statistics.median(walls)
            base = base or (samples, wall)
            more, longer = samples - base[0], wall - base[1]
            beyond = f"{longer:22.2f} {1000 * longer / more:17.4f}" if more > 0 else ""
            print(f"{samples:8d} {wall:8.2f} {max(peaks):8.0f} {beyond}")
            if base[0] == samples:
                whole, path = min(cpus), f"{log}/log.parquet"
                warm, weighted, modelled = (in_process(path, once) for once in (
                    lambda problem: solve(problem).diagnostics, lambda problem: solve(problem, "wls"),
                    lambda problem: problem.cvxpy().problem.solve()))
        print(f"in a warm process {warm:.3f} s; weighted least squares alone {weighted:.3f} s, cvxpy alone "
              f"{modelled:.3f} s")
    return [Row("identify", whole, ITS_LIBRARIES, libraries()),
            Row("warm", warm, "cvxpy's estimate alone, without intervals and checks,", modelled)]


def in_process(path: str, once: Callable[[IdentificationProblem], object]) -> float:
    """CPU time [s] of reading a log and using it in a process that has done so before, the least of three."""
    def timed() -> float:
        began = time.process_time()
        once(identification_problem(load_machine("cat215b"), [read_log(path)]))
        return time.process_time() - began

    timed()
    return min(timed() for _ in range(3))


def codegen() -> list[Row]:
    """CPU time of `hydroopt codegen`, with and without sizes."""
    with tempfile.TemporaryDirectory() as folder:
        command = [HYDROOPT, "codegen", "cat215b", "-o", folder, "--quiet"]
        plain = min(measured(command).cpu for _ in range(3))
        print(f"CAT 215B: {plain:.2f} s of CPU; with --sizes {measured([*command, '--sizes']).cpu:.2f} s")
    return [Row("codegen", plain, ITS_LIBRARIES, libraries())]
