"""CPU time of starting: the interpreter, the package, help."""

import os
import statistics
import sys

from hydroopt.cli import COMMANDS

RUNS = 5
CASES = {"python -c pass": ["-c", "pass"], "import hydroopt": ["-c", "import hydroopt"],
         "hydroopt --help": ["-m", "hydroopt", "--help"]} | {
         f"hydroopt {name} --help": ["-m", "hydroopt", name, "--help"] for name in COMMANDS}


def start() -> None:
    """CPU seconds, user and system, median of five processes each; at most 0.3 for import and --help."""
    print(f"{'':32} {'CPU s':>6}")
    for name, arguments in CASES.items():
        print(f"{name:32} {statistics.median(cpu(arguments) for _ in range(RUNS)):6.3f}")


def cpu(arguments: list[str]) -> float:
    """CPU time [s] of one run of the interpreter, whose output is dropped."""
    silence = [(os.POSIX_SPAWN_OPEN, 1, os.devnull, os.O_WRONLY, 0)]
    pid = os.posix_spawn(sys.executable, [sys.executable, *arguments], os.environ, file_actions=silence)
    _, status, usage = os.wait4(pid, 0)
    if status:
        raise SystemExit(f"failed: {' '.join(arguments)}")
    return usage.ru_utime + usage.ru_stime
