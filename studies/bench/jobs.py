"""Time and peak memory of `hydroopt identify` and `codegen`, and how they grow."""

import math
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from hydroopt import identification_problem, load_machine, read_log, solve
from hydroopt.codegen.folder import Code
from hydroopt.codegen.parameter_source import Origin
from hydroopt.machine.machine import BASE, Machine

HYDROOPT = str(Path(sys.executable).with_name("hydroopt"))
SIZES = {1664: 3, 10_000: 1, 100_000: 1}
"""Samples of the log, and how many runs are taken."""
LIBRARIES = ("numpy", "casadi", "clarabel", "pydantic", "jinja2", "typer", "pyarrow.parquet")
"""What an identification cannot do without."""
CHAINS = (3, 6, 12, 24)
"""Joints of chains for which C is generated."""


def as_installed(folder: str) -> dict[str, str]:
    """The environment of a process that keeps Python's bytecode in a folder, as an installed package keeps its own."""
    return {key: value for key, value in os.environ.items() if key != "PYTHONDONTWRITEBYTECODE"} | {
        "PYTHONPYCACHEPREFIX": f"{folder}/bytecode"}


def measured(command: list[str]) -> tuple[float, float, float]:
    """Wall time [s], CPU time [s] and peak memory [MB] of one run of a command, its import of everything included."""
    began = time.perf_counter()
    pid = os.posix_spawn(command[0], command, os.environ)
    _, status, usage = os.wait4(pid, 0)
    wall = time.perf_counter() - began
    if status:
        raise SystemExit(f"failed: {' '.join(command)}")
    return wall, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024


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
            walls, cpus, peaks = zip(*[measured(command) for _ in range(runs)], strict=True)
            wall = statistics.median(walls)
            base = base or (samples, wall)
            more, longer = samples - base[0], wall - base[1]
            beyond = f"{longer:22.2f} {1000 * longer / more:17.4f}" if more > 0 else ""
            print(f"{samples:8d} {wall:8.2f} {max(peaks):8.0f} {beyond}")
            if base[0] == samples:
                whole = min(cpus)
                loaded = min(measured([sys.executable, "-c", "import " + ", ".join(LIBRARIES)])[1] for _ in range(runs))
                warm, weighted = in_process(f"{log}/log.parquet")
        print(f"CPU of {base[0]} samples: {whole:.2f} s with the page, target 1.2; its libraries alone {loaded:.2f} s, "
              f"ratio {whole / loaded:.2f}; in a warm process without page {warm:.3f} s, target 0.25; weighted least "
              f"squares alone {weighted:.3f} s, ratio {warm / weighted:.1f}")
    print(f"target for 1664 samples: 600 MB; this process itself: "
          f"{resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB")


def in_process(path: str) -> tuple[float, float]:
    """CPU time [s] of reading and identifying by two methods in a process that has done so before, the least of
    three."""
    def once(method: str) -> float:
        began = time.process_time()
        problem = identification_problem(load_machine("cat215b"), [read_log(path)])
        estimate = solve(problem, method)
        _ = estimate.diagnostics if method == "sdp" else None
        return time.process_time() - began

    first, second = (min(once(method) for _ in range(4)) for method in ("sdp", "wls"))
    return first, second


def codegen() -> None:
    """CPU time of `hydroopt codegen`, with and without sizes, and of the code of chains of revolute joints."""
    with tempfile.TemporaryDirectory() as folder:
        command = [HYDROOPT, "codegen", "cat215b", "-o", folder, "--quiet"]
        began = children()
        subprocess.run(command, check=True)
        plain, began = children() - began, children()
        subprocess.run([*command, "--sizes"], check=True)
        print(f"CAT 215B: {plain:.2f} s of CPU, target 2; with --sizes {children() - began:.2f} s")
    print(f"{'joints':>7} {'CPU s':>8} {'operations of the regressor':>28}")
    taken = []
    for joints in CHAINS:
        began = time.process_time()
        made = Code(chain(joints), Origin(f"a chain of {joints} joints", "0" * 64),
                    routines=["inverse_dynamics", "regressor"])
        made.files()
        taken.append(time.process_time() - began)
        count = sum(made.programs_of_routines["regressor"].operations.values())
        print(f"{joints:7d} {taken[-1]:8.2f} {count:28d}")
    began = time.process_time()
    Code(chain(CHAINS[-1]), Origin(f"a chain of {CHAINS[-1]} joints", "0" * 64)).files()
    every, exponent = time.process_time() - began, math.log(taken[-1] / taken[-2]) / math.log(CHAINS[-1] / CHAINS[-2])
    print(f"exponent from {CHAINS[-2]} to {CHAINS[-1]} joints {exponent:.2f}; all routines of {CHAINS[-1]} joints "
          f"{every:.1f} s, target 30")


def children() -> float:
    """CPU time [s] of all processes that were started here and have ended, and of theirs."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def chain(joints: int) -> Machine:
    """So many links, each turned by a drive about an axis across the one before."""
    body = {"m": 10.0, "com": (0.2, 0.01, 0.02), "inertia_com": (0.1, 0.0, 0.0, 0.2, 0.0, 0.2)}
    links = [{"name": f"link{k}", "parent": f"link{k - 1}" if k else BASE, "body": body, "joint": {
        "type": "revolute", "a": 0.4, "alpha": math.pi / 2 * (-1) ** k, "lower": -2.0, "upper": 2.0}}
             for k in range(joints)]
    drives = [{"name": f"drive{k}", "joint": f"link{k}"} for k in range(joints)]
    return Machine.model_validate({"name": f"chain{joints}", "links": links, "drives": drives})
